from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from tactune.core.errors import FrameError, TactuneError
from tactune.core.lab import mechanics as module
from tactune.core.lab.mechanics import (
    MembraneMechanics,
    MembraneMesh,
    stiffness_and_areas,
)
from tactune.core.model.metrics import pixel_scores
from tactune.core.preset import Preset

WITHIN = 0.02  # 2 %


@pytest.fixture(autouse=True)
def housing(monkeypatch):
    monkeypatch.setattr(module, "HOUSING_M3", 0.002)


def disc(radius, rings, height):
    """A disc of rings of 6, 12, 18... nodes, lifted by a function of the radius."""
    from scipy.spatial import Delaunay

    rims = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        angle = np.arange(6 * ring) / (6 * ring) * 2 * np.pi
        rims.append(radius * ring / rings * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    flat = np.concatenate(rims)
    triangles = Delaunay(flat).simplices
    a, b, c = np.moveaxis(flat[triangles], 1, 0)
    turned = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    triangles[turned] = triangles[turned][:, ::-1]
    r = np.linalg.norm(flat, axis=1)
    positions = np.column_stack([flat, 0.3 + height(r)])
    step = 1e-6
    slope = (height(r + step) - height(r - step)) / (2 * step)
    normals = np.column_stack([-slope[:, None] * flat / np.maximum(r, 1e-12)[:, None], np.ones(len(r))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return MembraneMesh(flat, positions, normals, triangles, r > radius * 0.999, np.ones((1, 1), bool), 1.0)


def test_a_flat_membrane_bulges_by_p_a2_minus_r2_over_4t():
    radius, tension, pressure = 0.1, 80.0, 900.0
    mesh = disc(radius, 11, lambda r: 0.0 * r)
    stiffness, areas = stiffness_and_areas(mesh.positions, mesh.triangles)
    inner = ~mesh.rim
    w = spsolve((tension * stiffness[inner][:, inner]).tocsc(), pressure * areas[inner])
    r = np.linalg.norm(mesh.positions[inner, :2], axis=1)
    exact = pressure * (radius**2 - r**2) / (4 * tension)
    assert 350 < len(mesh.pixels) < 480
    assert areas.sum() == pytest.approx(np.pi * radius**2, rel=WITHIN)
    np.testing.assert_allclose(w, exact, atol=WITHIN * exact.max())
    assert w.max() == pytest.approx(exact.max(), rel=WITHIN)


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
