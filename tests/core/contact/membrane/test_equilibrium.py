"""The obstacle problem of the membrane test: against other solvers and analytic solutions, and what always holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, lsq_linear

from tactune.core.contact.kernels import equilibrium as kernels
from tactune.core.contact.kernels.membrane import RayWindow
from tactune.core.contact.membrane.equilibrium import Cells, Equilibrium, over_window, settle
from tactune.core.contact.membrane.tension import free_curvature_per_m
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.model.frames import DepthCamera, Rig, SensorFrame
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.preset import Preset

SIDE_M, COUNT = 0.001, 61
MEMBRANE = Preset().with_values({"contact_test": "membrane", "membrane.bias": False})
#: Depth of the untouched membrane's plane and of what is behind, metres.
PLANE_M, BEHIND_M, UNIT_M = 0.3, 0.6, 1e-5


def cells_of_gap(gap_m: np.ndarray, push_per_m: float | np.ndarray, known: np.ndarray | None = None) -> Cells:
    """Return cells of 1 mm that face the camera, with an unknown frame."""
    gap_m = np.asarray(gap_m, np.float32)
    everywhere = np.zeros(gap_m.shape, bool)
    everywhere[1:-1, 1:-1] = True
    share = everywhere.astype(np.float32)
    return Cells(
        difference_m=gap_m,
        share=share,
        near_share=over_window(share, 3),
        known=everywhere if known is None else everywhere & known,
        push_per_m=np.full_like(gap_m, 1.0) * np.asarray(push_per_m, np.float32),
        sides_m=np.full((2, *gap_m.shape), SIDE_M, np.float32),
        facing=np.ones_like(gap_m),
        size_px=3,
    )


def radius_m(touching: np.ndarray, side_m: float = SIDE_M) -> float:
    return float(np.sqrt(np.count_nonzero(touching) / np.pi)) * side_m


def gap_at(r: np.ndarray | float, contact_m: float, push_per_m: float) -> np.ndarray:
    """The solution of g'' + g' / r = f with g = g' = 0 at the edge of contact: f / 4 (r^2 - a^2 - 2 a^2 ln(r / a))."""
    r = np.maximum(r, contact_m)
    return push_per_m / 4 * (r**2 - contact_m**2 - 2 * contact_m**2 * np.log(r / contact_m))


def pressed_paraboloid(depth_m: float, curvature_per_m: float, pull_per_m: float, rim_m: float) -> float:
    """Return the radius of contact of a paraboloid that is pressed into a flat membrane, clamped on a circle.

    The membrane with p / T = pull bulges away from the camera, the paraboloid of curvature 1 / R towards it, so
    laplacian(g) = p / T + 2 / R, and at the rim the gap is that of the paraboloid above the plane.
    """
    push = pull_per_m + 2 * curvature_per_m
    at_rim = curvature_per_m * rim_m**2 / 2 - depth_m
    return float(brentq(lambda a: float(gap_at(rim_m, a, push)) - at_rim, 1e-5, rim_m * 0.999))


@pytest.mark.parametrize(
    ("depth_m", "curvature_per_m", "pull_per_m"), [(0.0005, 20.0, 5.0), (0.001, 20.0, 10.0), (0.0005, 10.0, 3.0)]
)
@pytest.mark.parametrize("noise_m", [0.0, 0.0005])
def test_a_paraboloid_pressed_through_a_flat_membrane_touches_within_its_radius(
    depth_m, curvature_per_m, pull_per_m, noise_m
):
    """Inside the rim the measured gap has no weight: what is solved for follows from mechanics and the rim alone."""
    rim_m = 0.026
    contact_m = pressed_paraboloid(depth_m, curvature_per_m, pull_per_m, rim_m)
    v, u = np.indices((COUNT, COUNT)) - COUNT // 2
    r = np.hypot(u, v) * SIDE_M
    push = pull_per_m + 2 * curvature_per_m
    gap = gap_at(r, contact_m, push)
    noise = np.random.default_rng(0).normal(0, noise_m, gap.shape) if noise_m else 0.0
    clamped = r > rim_m
    cells = cells_of_gap(np.where(clamped, 0.006 + 0 * gap, gap + noise), push)
    inner = replace(cells, share=np.where(clamped, 0, cells.share).astype(np.float32))
    trust_m = 0.2 if noise_m == 0 else 0.05
    # the rim's own gaps are held: the solver keeps the gap of cells that it does not solve for
    solution = settled_with_rim(inner, gap, clamped, trust_m)
    assert contact_m > 3 * SIDE_M
    assert radius_m(solution <= 1e-7) == pytest.approx(contact_m, abs=0.6 * SIDE_M)
    if noise_m == 0:
        np.testing.assert_allclose(solution[~clamped], gap[~clamped], atol=2e-5)


def settled_with_rim(cells: Cells, gap_m: np.ndarray, held: np.ndarray, trust_m: float) -> np.ndarray:
    """Solve with the kernels for the cells that are not held; the held ones keep ``gap_m``."""
    inside = cells.known & ~held
    size = int(inside.sum())
    places, links = np.empty(size, np.int32), np.empty((7, size), np.float32)
    even = kernels.link_cells(inside, cells.known, cells.sides_m, cells.share, np.float32(trust_m), places, links)
    loads = links[4] * cells.difference_m.reshape(-1)[places] - links[5] * cells.push_per_m.reshape(-1)[places]
    gaps = np.where(held, gap_m, np.maximum(cells.difference_m, 0)).astype(np.float32)
    relaxation = kernels.Relaxation(np.float32(1.8), np.float32(1e-8), 5000)
    kernels.settle(gaps.reshape(-1), gaps.shape[1], kernels.Equations(places, links, even), loads, relaxation)
    return gaps


@pytest.mark.parametrize("push_per_m", [20.0, 60.0, 150.0])
@pytest.mark.parametrize("contact_m", [0.005, 0.010])
@pytest.mark.parametrize("trust_m", [0.008, 0.016, 0.03])
def test_the_shipped_iteration_finds_the_disc(push_per_m, contact_m, trust_m):
    v, u = np.indices((COUNT, COUNT)) - COUNT // 2
    gap = gap_at(np.hypot(u, v) * SIDE_M, contact_m, push_per_m)
    solution = settle(cells_of_gap(gap, push_per_m), 0.0, trust_m)
    near_m = MEMBRANE.membrane.gap_m
    reach_m = np.sqrt(2 * near_m / push_per_m)  # as far beyond contact the gap is the largest one that counts
    assert radius_m(solution.gap_m <= near_m) == pytest.approx(contact_m + reach_m, abs=SIDE_M)


def random_cells(seed: int, size: int = 16) -> tuple[Cells, np.ndarray]:
    rng = np.random.default_rng(seed)
    known = np.zeros((size, size), bool)
    known[1:-1, 1:-1] = rng.random((size - 2, size - 2)) > 0.1
    measured = rng.normal(0.0006, 0.0012, (size, size)).astype(np.float32)
    share = np.where(known, rng.choice([0.3, 0.7, 1.0], (size, size)), 0).astype(np.float32)
    sides = rng.uniform(0.0008, 0.0015, (2, size, size)).astype(np.float32)
    push = rng.uniform(5, 300, (size, size)).astype(np.float32)
    facing = rng.uniform(0.6, 1.0, (size, size)).astype(np.float32)
    return Cells(measured, share, over_window(share, 3), known, push, sides, facing, 3), rng


def equations(cells: Cells, inside: np.ndarray, trust_m: float) -> tuple[np.ndarray, np.ndarray, int]:
    size = int(inside.sum())
    places, links = np.empty(size, np.int32), np.empty((7, size), np.float32)
    even = kernels.link_cells(inside, cells.known, cells.sides_m, cells.share, np.float32(trust_m), places, links)
    return places, links, even


@pytest.mark.parametrize("seed", range(4))
def test_the_gap_is_that_of_a_bounded_least_squares_solver(seed):
    cells, rng = random_cells(seed)
    size = len(cells.known)
    inside = cells.known & (rng.random((size, size)) > 0.1)
    places, links, even = equations(cells, inside, 0.004)
    assert sorted(places) == sorted(np.flatnonzero(inside))
    assert ((places[:even] // size + places[:even] % size) % 2).max() == 0
    gaps = rng.uniform(0, 0.003, (size, size)).astype(np.float32)
    measured = cells.difference_m.reshape(-1)[places]
    loads = (links[4] * measured - links[5] * cells.push_per_m.reshape(-1)[places]).astype(np.float32)
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
    relaxation = kernels.Relaxation(np.float32(1.5), np.float32(1e-8), 5000)
    kernels.settle(gaps.reshape(-1), size, kernels.Equations(places, links, even), loads, relaxation)
    assert 0 < (expected > 1e-6).sum() < len(expected)
    np.testing.assert_allclose(gaps.reshape(-1)[places], expected, atol=2e-6)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), bias_m=st.floats(-0.002, 0.002), trust_m=st.sampled_from([0.004, 0.016, 0.05]))
def test_no_gap_is_negative_and_open_cells_are_in_equilibrium(seed, bias_m, trust_m):
    cells, _ = random_cells(seed)
    measured = (cells.difference_m - np.float32(bias_m)) * cells.facing
    inside = cells.known
    places, links, even = equations(cells, inside, trust_m)
    loads = links[4] * measured.reshape(-1)[places] - links[5] * cells.push_per_m.reshape(-1)[places]
    gaps = np.maximum(measured, 0).astype(np.float32)
    relaxation = kernels.Relaxation(np.float32(1.7), np.float32(1e-9), 20_000)
    kernels.settle(gaps.reshape(-1), gaps.shape[1], kernels.Equations(places, links, even), loads, relaxation)
    assert (gaps >= 0).all()
    flat, width = gaps.reshape(-1).astype(float), gaps.shape[1]
    steps = (-1, 1, -width, width)
    inwards = sum(link * flat[places + step] for link, step in zip(links[:4], steps, strict=True)) + loads
    outwards = links[:5].sum(axis=0) * flat[places]
    scale = links[:5].sum(axis=0) * max(flat[places].max(), 1e-3)
    open_cells = flat[places] > 0
    assert (np.abs(inwards - outwards)[open_cells] < 1e-4 * scale[open_cells]).all()
    assert (inwards[~open_cells] < 1e-4 * scale[~open_cells]).all(), "where the gap is 0, it is pressed shut"


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), bias_m=st.floats(-0.001, 0.001), trust_m=st.sampled_from([0.008, 0.016, 0.03]))
def test_what_settle_returns_is_consistent(seed, bias_m, trust_m):
    cells, _ = random_cells(seed)
    solution = settle(cells, bias_m, trust_m)
    assert (solution.gap_m >= 0).all()
    assert not (solution.touching & ~cells.known).any()
    assert (solution.gap_m[solution.touching] == 0).all()
    assert (solution.gap_m[~cells.known] >= 0.01).all()
    measured = (cells.difference_m - np.float32(bias_m)) * cells.facing
    np.testing.assert_allclose(solution.residual_m, measured - solution.gap_m, atol=1e-7)


def smooth_cells(seed: int, size: int = 40) -> Cells:
    """Bumps below and above 0 with noise, as real scenes have them."""
    rng = np.random.default_rng(seed)
    v, u = np.indices((size, size)) / size
    angle, phase = rng.uniform(0, 2 * np.pi, 2)
    gap = 0.0015 * (1 + np.sin(7 * (u * np.cos(angle) + v * np.sin(angle)) + phase)) - 0.0004
    return cells_of_gap(gap + rng.normal(0, 0.0003, gap.shape), rng.uniform(10, 100))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), bias_m=st.floats(-0.0005, 0.001), more_m=st.floats(0.0002, 0.001))
def test_contact_grows_with_the_bias(seed, bias_m, more_m):
    cells = smooth_cells(seed)
    less, more = (settle(cells, value, 0.016).touching for value in (bias_m, bias_m + more_m))
    assert np.count_nonzero(less & ~more) <= 0.01 * np.count_nonzero(more)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), shift_m=st.floats(-0.02, 0.02))
def test_differences_and_bias_that_shift_together_change_nothing(seed, shift_m):
    cells = smooth_cells(seed)
    shifted = replace(cells, difference_m=cells.difference_m + np.float32(shift_m))
    one, other = settle(cells, 0.0003, 0.016), settle(shifted, 0.0003 + shift_m, 0.016)
    np.testing.assert_allclose(one.gap_m, other.gap_m, atol=2e-5)
    assert np.count_nonzero(one.touching ^ other.touching) <= 4


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), axis=st.sampled_from([0, 1]))
def test_a_mirrored_image_has_the_mirrored_contact(seed, axis):
    cells = smooth_cells(seed)
    mirrored = cells_of_gap(np.flip(cells.difference_m, axis).copy(), cells.push_per_m)
    one, other = settle(cells, 0.0, 0.016), settle(mirrored, 0.0, 0.016)
    np.testing.assert_allclose(np.flip(one.gap_m, axis), other.gap_m, atol=3e-5)
    near_m = MEMBRANE.membrane.gap_m
    changed = (np.flip(one.gap_m, axis) <= near_m) ^ (other.gap_m <= near_m)
    assert np.count_nonzero(changed) <= 0.02 * changed.size


def test_another_start_leads_to_the_same_gaps():
    cells = smooth_cells(3)
    start: Equilibrium = settle(cells, 0.0008, 0.016)
    np.testing.assert_allclose(
        settle(cells, 0.0, 0.016, start).gap_m, settle(cells, 0.0, 0.016).gap_m, atol=MEMBRANE.membrane.gap_m
    )


def test_a_cell_is_the_mean_of_the_pixels_that_take_part():
    rng = np.random.default_rng(1)
    differences, counts = rng.uniform(0.1, 0.3, (7, 10)).astype(np.float32), rng.integers(1, 65535, (7, 10), np.uint16)
    usable, excluded = rng.random((7, 10)) > 0.4, rng.random((7, 10)) > 0.7
    rays = rng.uniform(-0.5, 0.5, (12, 16, 2)).astype(np.float32)
    out = np.empty((6, 3, 4), np.float32)
    unit_m, bias_m, centre_m, limit_m = np.float32([1e-5, 0.003, 0.2, 0.08])
    window = kernels.DifferenceWindow(differences, usable, excluded, counts, unit_m, bias_m, centre_m, limit_m)
    kernels.average_cells(window, 3, RayWindow(rays, 3, 4), 0, 3, out)
    for row, column in np.ndindex(3, 4):
        box = np.s_[3 * row : 3 * row + 3, 3 * column : 3 * column + 3]
        part = usable[box] & (np.abs(differences[box] - 0.2) < 0.08)
        ray, z = rays[3:10, 4:14][box], counts[box] * unit_m - bias_m
        expected = [
            differences[box][part].mean() if part.any() else 0,
            part.sum() / 9,  # also of the last cells, which reach beyond the image
            (ray[..., 0] * z * part).sum() / 9,
            (ray[..., 1] * z * part).sum() / 9,
            (z * part).sum() / 9,
            excluded[box].sum() / 9,
        ]
        np.testing.assert_allclose(out[:, row, column], expected, rtol=1e-5)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.4, -0.2, 1.0), (-0.5, 0.5, 1.0)])
def test_cells_of_a_tilted_plane_are_as_long_as_its_points_are_apart(normal):
    rays = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 101), np.linspace(-0.4, 0.4, 81)))
    z = 0.3 / (normal[0] * rays[0] + normal[1] * rays[1] + normal[2])
    points = np.stack([rays[0] * z, rays[1] * z, z]).astype(np.float32)
    sides, facing = np.empty((2, 81, 101), np.float32), np.empty((81, 101), np.float32)
    shares = np.ones((81, 101), np.float32)
    kernels.measure_cells(points, shares, np.float32(0.5), (0.01, 0.01), sides, facing)
    inner = np.s_[..., 1:-1, 1:-1]
    right, down = points[:, 1:-1, 2:] - points[:, 1:-1, :-2], points[:, 2:, 1:-1] - points[:, :-2, 1:-1]
    lengths = np.stack([np.linalg.norm(steps, axis=0) / 2 for steps in (right, down)])
    np.testing.assert_allclose(sides[inner], lengths, rtol=0.01)
    along = np.abs(np.tensordot(normal, points / points[2], 1)) / np.linalg.norm(normal)
    np.testing.assert_allclose(facing[inner], np.minimum(along, 1)[inner], rtol=0.01)
    kernels.measure_cells(points, 0 * shares, np.float32(0.5), (0.01, 0.01), sides, facing)
    assert (sides == np.float32(0.001)).all()
    assert (facing == 1).all()


# Images of a bubble with an exact shape


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Two cameras in one place, so that pixels compare one by one."""
    lens = Intrinsics(width=320, height=240, fx=300.0, fy=300.0, cx=159.5, cy=119.5)
    camera = DepthCamera(intrinsics=lens, depth_unit_m=UNIT_M)
    return Rig(proximity=camera, tactile=camera, T_proximity_tactile=np.eye(4).tolist())


def counts(depth_m: np.ndarray) -> np.ndarray:
    return np.rint(depth_m / UNIT_M).astype(np.uint16)


def pressed_bubble(rig: Rig, contact_m: float, ball_m: float, pull_per_m: float = 7.0) -> tuple[SensorFrame, float]:
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

    def ball(x: np.ndarray) -> np.ndarray:
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


def sphere_from_inside(rig: Rig, ball_m: float, centre_m: tuple[float, float, float]) -> np.ndarray:
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
    assert free_curvature_per_m(frame, preset.alignment, rig) == pytest.approx(2 / ball_m, rel=0.1)


def test_without_depth_the_usual_bulge_is_assumed(rig):
    nothing = np.zeros(rig.tactile.intrinsics.shape, np.uint16)
    frame = SensorFrame(0, nothing, nothing, np.zeros((*nothing.shape, 3), np.uint8))
    assert free_curvature_per_m(frame, MEMBRANE.alignment, rig) == 10.0
