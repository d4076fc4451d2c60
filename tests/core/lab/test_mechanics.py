from dataclasses import replace

import numpy as np
import pytest

from tactune.core.errors import FrameError, TactuneError
from tactune.core.lab import mechanics as module
from tactune.core.lab.mechanics import (
    MembraneMechanics,
)
from tactune.core.model.metrics import pixel_scores
from tactune.core.preset import Preset

WITHIN = 0.02  # 2 %


@pytest.fixture(autouse=True)
def housing(monkeypatch):
    monkeypatch.setattr(module, "HOUSING_M3", 0.002)


def test_contact_radius_under_a_flat_plate(shallow, monkeypatch):
    monkeypatch.setattr(module, "REGULARISATION", 1e-3)
    method = mechanics(shallow)
    contact_radius = 0.3 * shallow.radius_m
    frame = shallow.frame(contact_radius)
    problem = method.problem
    x = problem.solve(method.way_m(frame.tactile_depth))
    force = float(problem.contact_pressure(x) @ problem.areas_m2) / problem.air_pressure(x)
    assert problem.air_pressure(x) == pytest.approx(shallow.pressure(contact_radius), rel=WITHIN)
    assert np.sqrt(force / np.pi) == pytest.approx(contact_radius, rel=WITHIN)

    patch = method.find(frame)
    points = patch.points.astype(float)
    camera = shallow.rig.tactile.intrinsics
    area = np.sum(points[:, 2] ** 2) / (camera.fx * camera.fy)
    assert np.sqrt(area / np.pi) == pytest.approx(contact_radius, rel=WITHIN)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    np.testing.assert_allclose(middle[:2], (0.02, 0.0), atol=0.002)
    assert pixel_scores(patch.mask, frame.truth.contact).iou > 0.93


def test_nothing_presses_on_the_untouched_membrane(bulged):
    patch = mechanics(bulged).find(bulged.frame(0.0, noise_m=0.0003, seed=5))
    assert len(patch.points) == 0
    assert not patch.mask.any()


def test_failures_are_told_and_do_not_spoil_the_next_frame(bulged):
    method, frame = mechanics(bulged), bulged.frame(0.5 * bulged.radius_m)
    before = method.find(frame).points
    half = frame.tactile_depth.copy()
    half[:, :160] = 0
    for counts in (np.zeros_like(half), half):
        with pytest.raises(TactuneError, match="nodes"):
            method.find(with_tactile(frame, counts))
    np.testing.assert_array_equal(method.find(frame).points, before)


def test_untouched_frames_that_show_no_membrane_are_refused(bulged, cup_frames):
    frame = bulged.frame(0.0)
    with pytest.raises(TactuneError, match="take a new untouched frame"):
        MembraneMechanics(Preset(), bulged.rig, with_tactile(frame, np.zeros_like(frame.tactile_depth)))
    with pytest.raises(TactuneError, match="not bulge"):
        flat = np.where(frame.tactile_depth > 0, 25_000, 0).astype(np.uint16)
        MembraneMechanics(Preset(), bulged.rig, with_tactile(frame, flat))
    with pytest.raises(FrameError):
        MembraneMechanics(Preset(), bulged.rig, cup_frames[1])


def mechanics(membrane, nodes=440):
    return MembraneMechanics(Preset(), membrane.rig, membrane.frame(0.0), nodes)


def with_tactile(frame, counts):
    return replace(frame, tactile_depth=counts)
