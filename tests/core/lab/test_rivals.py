"""The other methods: views of a membrane with closed-form shapes, one camera alone, and mechanics."""

from dataclasses import replace

import numpy as np
import pytest

from tactune.core.errors import FrameError, TactuneError
from tactune.core.lab import mechanics as module
from tactune.core.lab.bench import synthetic_scene
from tactune.core.lab.mechanics import MembraneMechanics
from tactune.core.lab.methods import make_method
from tactune.core.lab.single_camera import MembraneView, proximity_only, tactile_only
from tactune.core.model.clouds import deproject
from tactune.core.model.metrics import pixel_scores
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset

BASELINE_M, RIM_M = 0.02, 0.25


def inside(truth_depth, pixels=6):
    """Pixels that see the membrane, and so do all within some pixels."""
    import cv2

    seen = np.isfinite(truth_depth).astype(np.uint8)
    return cv2.erode(seen, np.ones((2 * pixels + 1,) * 2, np.uint8)).astype(bool)


def test_depth_is_that_of_the_membrane_on_each_proximity_ray(bulged):
    frame = bulged.frame(0.4 * bulged.radius_m)
    found = MembraneView(Preset().alignment, bulged.rig).depth_m(frame.tactile_depth)
    sure = inside(frame.truth.depth_m)
    assert sure.sum() > 20_000
    assert np.isfinite(found[sure]).all()
    assert np.abs(found - frame.truth.depth_m)[sure].max() < 4e-4
    assert np.sqrt(np.mean((found - frame.truth.depth_m)[sure] ** 2)) < 1e-4
    far = ~np.isfinite(frame.truth.depth_m)
    assert np.isnan(found[~far]).mean() < 0.003
    assert np.isfinite(found[far]).sum() < 0.02 * far.sum()


def test_a_plate_through_the_untouched_frame_is_contact(bulged):
    untouched, frame = bulged.frame(0.0), bulged.frame(0.5 * bulged.radius_m)
    patch = proximity_only(Preset(), bulged.rig, untouched)(frame)
    depth = frame.proximity_depth * bulged.rig.proximity.depth_unit_m
    in_front = depth < untouched.truth.depth_m - 0.002
    assert in_front.sum() > 5000
    assert pixel_scores(patch.mask, in_front).iou > 0.98
    np.testing.assert_array_equal(
        patch.points, deproject(frame.proximity_depth, bulged.rig.proximity, np.flatnonzero(patch.mask))
    )


def test_nothing_behind_the_untouched_frame_and_without_depth_is_contact(bulged):
    find = proximity_only(Preset(), bulged.rig, bulged.frame(0.0))
    assert len(find(bulged.frame(0.5 * bulged.radius_m, gap_m=0.002)).points) == 0
    frame = bulged.frame(0.5 * bulged.radius_m)
    assert not find(replace(frame, proximity_depth=np.zeros_like(frame.proximity_depth))).mask.any()
    with pytest.raises(FrameError, match="640 x 480"):
        find(synthetic_scene(100).frame)


def test_points_and_mask_lie_on_the_dent(bulged):
    frame = bulged.frame(0.5 * bulged.radius_m)
    patch = tactile_only(Preset(), bulged.rig, bulged.frame(0.0))(frame)
    x, y, z = patch.points.astype(float).T
    r = np.hypot(x - BASELINE_M, y)
    np.testing.assert_allclose(z, RIM_M + bulged.height(r, 0.5 * bulged.radius_m), atol=1e-4)
    scores = pixel_scores(patch.mask, frame.truth.contact)
    assert scores.precision > 0.95  # the most deformed are in the middle of the plate
    assert 0.5 < scores.recall < 0.8


def test_what_a_method_lacks_is_said(cup_frames):
    rig, preset = cup_frames[0], load_preset("simulator")
    with pytest.raises(TactuneError, match="untouched"):
        make_method("proximity-only", preset, rig)
    with pytest.raises(TactuneError, match="no method 'magic'"):
        make_method("magic", preset, rig)


WITHIN = 0.02  # 2 %


@pytest.fixture
def housing(monkeypatch):
    monkeypatch.setattr(module, "HOUSING_M3", 0.002)


def test_contact_radius_under_a_flat_plate(shallow, monkeypatch, housing):
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


def test_nothing_presses_on_the_untouched_membrane(bulged, housing):
    patch = mechanics(bulged).find(bulged.frame(0.0, noise_m=0.0003, seed=5))
    assert len(patch.points) == 0
    assert not patch.mask.any()


def test_failures_are_told_and_do_not_spoil_the_next_frame(bulged, housing):
    method, frame = mechanics(bulged), bulged.frame(0.5 * bulged.radius_m)
    before = method.find(frame).points
    half = frame.tactile_depth.copy()
    half[:, :160] = 0
    for counts in (np.zeros_like(half), half):
        with pytest.raises(TactuneError, match="nodes"):
            method.find(replace(frame, tactile_depth=counts))
    np.testing.assert_array_equal(method.find(frame).points, before)


def mechanics(membrane, nodes=440):
    return MembraneMechanics(Preset(), membrane.rig, membrane.frame(0.0), nodes)
