"""The obstacle problem of the membrane test: against other solvers and analytic solutions, and what always holds."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from rigs import one_place_rig
from tactune.core.contact.kernels import equilibrium as kernels
from tactune.core.contact.membrane.equilibrium import Cells, measured_curvature_per_m, over_window, settle
from tactune.core.contact.membrane.frame_bias import FrameBias
from tactune.core.contact.membrane.section import MembraneSection
from tactune.core.contact.membrane.steps import boundary_of, with_missed_parts
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset

SIDE_M, COUNT = 0.001, 61
MEMBRANE = Preset().with_values({"contact_test": "membrane", "membrane.bias": False})
#: Depth of the untouched membrane's plane and of what is behind, metres.
PLANE_M, BEHIND_M, UNIT_M = 0.3, 0.6, 1e-5


def random_cells(seed, size=16):
    rng = np.random.default_rng(seed)
    known = np.zeros((size, size), bool)
    known[1:-1, 1:-1] = rng.random((size - 2, size - 2)) > 0.1
    measured = rng.normal(0.0006, 0.0012, (size, size)).astype(np.float32)
    share = np.where(known, rng.choice([0.3, 0.7, 1.0], (size, size)), 0).astype(np.float32)
    sides = rng.uniform(0.0008, 0.0015, (2, size, size)).astype(np.float32)
    push = rng.uniform(5, 300, (size, size)).astype(np.float32)
    facing = rng.uniform(0.6, 1.0, (size, size)).astype(np.float32)
    unseen = np.zeros_like(share)
    return Cells(measured, share, unseen, share, over_window(share, 3), known, known, push, sides, facing, 3), rng


def equations(cells, inside, trust_m, bias_m=0.0):
    """Return the equations of some cells, and their loads."""
    size = int(inside.sum())
    places, links = np.empty(size, np.int32), np.empty((6, size), np.float32)
    floors, loads = np.empty((2, size), np.float32)
    measured = (cells.difference_m - np.float32(bias_m)) * cells.facing
    push = cells.push_per_m
    even = kernels.link_cells(inside, cells, measured, push, np.float32(trust_m), places, links, floors, loads)
    return (places, links, floors, even), loads


def square_cells(difference_m, push):
    known, one, sides = np.zeros(push.shape, bool), np.ones_like(push), np.full((2, *push.shape), SIDE_M, np.float32)
    known[1:-1, 1:-1] = True
    share = known.astype(np.float32)
    return Cells(difference_m * one, share, 0 * one, share, over_window(share, 3), known, known, push, sides, one, 3)


def test_a_hollow_that_is_hardly_pressed_makes_the_boundary_less_certain():
    flat, hollow = np.full((2, COUNT, COUNT), 10.0, np.float32)
    hollow[:, 25:36] = -10.0
    rig = SimpleNamespace(pixel_sigma_m=0.001)
    measured = SimpleNamespace(known=rig, bias=SimpleNamespace(sigma_m=0.0003), free_per_m=10.0)
    errors_m = []
    for push in (flat, hollow):
        cells = square_cells(-0.001, push)
        errors_m.append(boundary_of(cells, settle(cells, 0.0, 0.016), 5e-5, measured).error_m)
    assert errors_m[1] > errors_m[0] + 0.002


@pytest.mark.parametrize(
    ("pressed_m", "side", "measured", "added"),
    [
        (-0.001, 14, True, True),
        (-0.001, 14, False, False),
        (-0.001, 6, True, False),
        (0.004, 14, True, True),
        (0.004, 9, True, False),  # where nothing else touches
    ],
)
def test_a_dented_part_that_only_a_larger_bias_shows_is_added(pressed_m, side, measured, added):
    difference_m = np.full((COUNT, COUNT), 0.004, np.float32)
    centre = 20 + side // 2, 40 + side // 2
    difference_m[20:40, 8:24], difference_m[20 : 20 + side, 40 : 40 + side] = pressed_m, 0.0004
    cells = square_cells(difference_m, np.full((COUNT, COUNT), 10.0, np.float32))
    known = SimpleNamespace(measured=measured, length_m=lambda usual_m: 0.001)
    bias = FrameBias(sigma_m=0.0004)
    found = settle(cells, 0.0, 0.001)
    measured = SimpleNamespace(known=known, bias=bias)
    solution = with_missed_parts(found, cells, measured, MembraneSection(), lambda part: part[centre])
    assert (solution.gap_m[centre] <= 5e-5) == added and found.gap_m[centre] > 2e-4
    assert (solution.gap_m[:, :30] == found.gap_m[:, :30]).all()


@pytest.mark.parametrize("seed", range(4))
def test_the_gap_is_that_of_a_bounded_least_squares_solver(seed):
    cells, rng = random_cells(seed)
    size = len(cells.known)
    inside = cells.known & (rng.random((size, size)) > 0.1)
    cells = cells._replace(facing=np.ones_like(cells.facing))
    found, loads = equations(cells, inside, 0.004)
    places, links, floors, even = found
    assert (floors == 0).all()
    assert sorted(places) == sorted(np.flatnonzero(inside))
    assert ((places[:even] // size + places[:even] % size) % 2).max() == 0
    gaps = rng.uniform(0, 0.003, (size, size)).astype(np.float32)
    measured = cells.difference_m.reshape(-1)[places]
    area = cells.sides_m.prod(axis=0).reshape(-1)[places]
    expected_loads = links[4] * measured - area * cells.push_per_m.reshape(-1)[places]
    np.testing.assert_allclose(loads, expected_loads, rtol=1e-4, atol=1e-9)
    index = {int(place): i for i, place in enumerate(places)}
    matrix, right = np.diag(links[:5].sum(axis=0)).astype(np.float64), loads.astype(np.float64)
    for i, place in enumerate(places):
        for link, step in zip(links[:4, i], (-1, 1, -size, size), strict=True):
            if (neighbour := index.get(int(place) + step)) is None:
                right[i] += link * gaps.reshape(-1)[place + step]
            else:
                matrix[i, neighbour] -= link
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-6)
    root = np.linalg.cholesky(matrix).T
    expected = lsq_linear(root, np.linalg.solve(root.T, right), (0, np.inf), tol=1e-14).x
    kernels.settle(gaps.reshape(-1), size, found, loads, np.float32(1.5), np.float32(1e-8), 5000)
    assert 0 < (expected > 1e-6).sum() < len(expected)
    np.testing.assert_allclose(gaps.reshape(-1)[places], expected, atol=2e-6)


# Images of a bubble with an exact shape


@pytest.fixture(scope="module")
def rig():
    """Two cameras in one place, so that pixels compare one by one."""
    return one_place_rig(320, 240, 300.0, UNIT_M, UNIT_M)


def counts(depth_m):
    return np.rint(depth_m / UNIT_M).astype(np.uint16)


def pressed_bubble(rig, contact_m, ball_m, pull_per_m=7.0):
    """Return images of a bubble into which a ball presses, and the tangent of the ray at the edge of contact.

    Young-Laplace for a surface of revolution, with the slope angle psi: d(r sin psi) / dr = r p / T, so
    sin psi = r p / (2 T) + c / r, where c makes bubble and ball tangent at the edge. No slope needs to be small.
    """
    r = np.linspace(contact_m, 0.25, 40_000)
    at_edge = -contact_m / ball_m if np.isfinite(ball_m) else 0.0
    sine = pull_per_m * r / 2 + contact_m * (at_edge - pull_per_m * contact_m / 2) / r
    keep = sine < 0.97
    r, sine = r[keep], sine[keep]
    slope = -sine / np.sqrt(1 - sine**2)  # depth falls outwards
    outside = PLANE_M + np.concatenate([[0.0], np.cumsum((slope[1:] + slope[:-1]) / 2 * np.diff(r))])
    inner = np.linspace(0, contact_m, 2000)[:-1]

    def ball(x):
        if not np.isfinite(ball_m):
            return np.full_like(x, PLANE_M)
        return PLANE_M + np.sqrt(ball_m**2 - contact_m**2) - np.sqrt(ball_m**2 - x**2)

    radii, membrane = np.concatenate([inner, r]), np.concatenate([ball(inner), outside])
    tangent = np.hypot(*np.moveaxis(rig.tactile.intrinsics.rays().astype(float), 2, 0))
    tactile = np.interp(tangent, radii / membrane, membrane)
    on_ball = np.linspace(0, 0.999 * min(ball_m, 0.08), 4000)
    surface = ball(on_ball)
    proximity = np.interp(tangent, on_ball / surface, surface, right=BEHIND_M)
    color = np.zeros((*tangent.shape, 3), np.uint8)
    return SensorFrame(0, counts(proximity), counts(tactile), color), contact_m / PLANE_M


@pytest.mark.parametrize("ball_m", [0.05, 0.1])
@pytest.mark.parametrize("contact_m", [0.015, 0.03])
def test_a_ball_in_a_bubble_touches_within_its_radius(rig, contact_m, ball_m):
    frame, edge = pressed_bubble(rig, contact_m, ball_m)
    patch = ContactPipeline(MEMBRANE, rig).process(frame)
    tangent = np.hypot(*np.moveaxis(rig.tactile.intrinsics.rays().astype(float), 2, 0))
    expected = tangent < edge
    found_px = np.sqrt(np.count_nonzero(patch.mask) / np.pi)
    expected_px = np.sqrt(np.count_nonzero(expected) / np.pi)
    push = 7.0 + 2 / ball_m
    reach_px = np.sqrt(2 * MEMBRANE.membrane.gap_m / push) * 300 / PLANE_M
    assert found_px == pytest.approx(expected_px + reach_px / 2, abs=1.5 + reach_px / 2)
    assert np.count_nonzero(expected & ~patch.mask) < 0.1 * np.count_nonzero(expected)


def sphere_from_inside(rig, ball_m, centre_m):
    """Depth of a sphere's far side along each pixel's ray."""
    rays = np.dstack([rig.tactile.intrinsics.rays(), np.ones(rig.tactile.intrinsics.shape)]).astype(float)
    centre = np.array(centre_m)
    along, square = rays @ centre, (rays**2).sum(axis=2)
    return (along + np.sqrt(along**2 - square * (centre @ centre - ball_m**2))) / square


@pytest.mark.parametrize(("ball_m", "centre_m"), [(0.30, (0.0, 0.0, 0.0)), (0.25, (0.02, -0.03, 0.05))])
@pytest.mark.parametrize(("scale", "offset_m"), [(1.0, 0.0), (1.02, 0.004)])
@pytest.mark.parametrize("noise_m", [0.0, 0.0003])
def test_a_free_sphere_bulges_by_two_over_its_radius(rig, ball_m, centre_m, scale, offset_m, noise_m):
    depth = (sphere_from_inside(rig, ball_m, centre_m) - offset_m) / scale
    depth = depth + np.random.default_rng(0).normal(0, noise_m, depth.shape)
    frame = SensorFrame(0, counts(depth), counts(depth), np.zeros((*depth.shape, 3), np.uint8))
    preset = MEMBRANE.with_values({"alignment.depth_scale": scale, "alignment.depth_offset_m": offset_m})
    assert measured_curvature_per_m(frame, preset.alignment, rig) == pytest.approx(2 / ball_m, rel=0.1)
