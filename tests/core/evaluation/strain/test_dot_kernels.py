"""Depth under dots and steps between them, against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactune.core.evaluation.strain.surface import STEEPEST, SeenSurface, dot_points, surface_between
from tactune.core.model.frames import DepthCamera
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.rig.noise import image_noise

LENS = Intrinsics(width=120, height=90, fx=100.0, fy=100.0, cx=59.5, cy=44.5)
CAMERA = DepthCamera(intrinsics=LENS, depth_unit_m=1e-6)
PIXELS = np.array([(60.3, 45.8), (1.2, 2.0), (118.4, 88.1), (30.5, 70.5)])


def counts_of(inverse):
    return np.rint(1e6 / inverse).astype(np.uint16)


def points_of(counts, pixels):
    """Return the places of dots and the standard deviations of their depths, metres."""
    surface = SeenSurface.of(np.where(counts > 0, counts * CAMERA.depth_unit_m, np.nan), LENS)
    found = dot_points(surface, pixels, image_noise(counts, CAMERA))
    return found.points_m, found.fits[:, 1] * found.points_m[:, 2] ** 2


def quadratic(u, v):
    return 18.0 + 0.02 * (u - 60) - 0.01 * (v - 45) + 4e-4 * (u - 60) ** 2 - 2e-4 * (u - 60) * (v - 45)


def test_a_surface_whose_inverse_depth_is_quadratic_is_met_between_the_pixels():
    v, u = np.indices(LENS.shape).astype(float)
    points, sigma = points_of(counts_of(quadratic(u, v)), PIXELS)
    assert np.abs(points[:, 2] - 1 / quadratic(*PIXELS.T)).max() < 1e-5
    assert (sigma > 0).all()
    assert np.allclose(LENS.project(points), PIXELS, atol=1e-9)


@pytest.mark.parametrize("side, depth_m", [(56.0, 0.05), (58.9, 0.05), (62.0, 0.056), (64.2, 0.056)])
def test_a_dot_beside_a_step_has_the_depth_of_its_own_side(side, depth_m):
    counts = np.where(np.arange(LENS.width) < 60, 50_000, 56_000) * np.ones(LENS.shape)
    points, _ = points_of(counts.astype(np.uint16), np.array([(side, 40.0)]))
    assert points[0, 2] == pytest.approx(depth_m, abs=1e-5)


def test_noise_is_averaged_over_as_much_as_is_smooth_and_told():
    v, u = np.indices(LENS.shape).astype(float)
    rng = np.random.default_rng(3)
    errors, told = [], []
    for _ in range(40):
        noisy = quadratic(u, v) + 0.02 * np.kron(rng.normal(size=(15, 20)), np.ones((6, 6)))  # as of a stereo camera
        points, sigma = points_of(counts_of(noisy), PIXELS[:1])
        errors.append(points[0, 2] - 1 / quadratic(*PIXELS[0]))
        told.append(sigma[0])
    assert 0.5 < np.std(errors) / np.mean(told) < 2.0
    assert np.std(errors) < 0.4 * 0.02 / 18**2


def test_a_bump_is_not_flattened_by_what_lies_around():
    v, u = np.indices(LENS.shape).astype(float)
    top = np.array([(60.3, 45.8)])
    bump = np.exp(-((u - 60.3) ** 2 + (v - 45.8) ** 2) / (2 * 7.0**2))
    noise = 0.01 * np.kron(np.random.default_rng(5).normal(size=(15, 20)), np.ones((6, 6)))
    points, _ = points_of(counts_of(18.0 + 0.3 * bump + noise), top)
    assert points[0, 2] == pytest.approx(1 / 18.3, abs=0.04 / 18**2)


@pytest.mark.parametrize("hole_px", [1.5, 2.0, 2.5, 3.0])
def test_a_dot_whose_own_depth_is_missing_takes_that_around_it(hole_px):
    """Stereo matching finds nothing in dark dots."""
    v, u = np.indices(LENS.shape).astype(float)
    counts = counts_of(quadratic(u, v))
    for dot in PIXELS:
        counts[np.hypot(u - dot[0], v - dot[1]) <= hole_px] = 0
    inner = PIXELS[[0, 3]]
    points, _ = points_of(counts, inner)
    assert np.abs(points[:, 2] - 1 / quadratic(*inner.T)).max() < 5e-5


def test_where_there_is_no_depth_there_is_no_place():
    counts = np.full(LENS.shape, 50_000, np.uint16)
    counts[30:60, 40:80] = 0
    points, _ = points_of(counts, np.array([(60.0, 45.0), (20.0, 20.0)]))
    assert np.isnan(points[0]).all() and points[1, 2] == pytest.approx(0.05, abs=1e-6)


@given(st.integers(0, 2**32 - 1))
def test_a_way_between_pixels_is_smooth_as_numpy_says(seed):
    rng = np.random.default_rng(seed)
    slope = rng.choice([0.0, 1e-3, 3e-3])
    depth = 0.1 + slope * np.arange(40) * np.ones((30, 1)) + rng.choice([0.0, 0.004]) * (np.arange(40) > 20)
    depth[rng.random(depth.shape) < rng.choice([0.0, 0.3, 0.6])] = np.nan
    start, end = rng.uniform((-6, -6), (46, 36), (2, 2))
    assert surface_between(depth, 100.0, start, end) == numpy_says(depth, 100.0, start, end)


def test_a_way_from_nowhere_is_not_smooth():
    assert not surface_between(np.full((30, 40), 0.1), 100.0, np.array((np.nan, 5.0)), np.array((5.0, 5.0)))


def numpy_says(depth, focal_px, start, end):
    count = max(int(np.hypot(*(end - start))), 1) + 1
    u, v = np.rint(np.linspace(start, end, count)).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
    way = np.full(count, np.nan)
    way[inside] = depth[v[inside], u[inside]]
    seen = np.flatnonzero(np.isfinite(way))
    if len(seen) < count / 2:
        return False
    apart = min(3, len(seen) - 1)
    first, second = seen[: len(seen) - apart], seen[apart:]
    return bool((np.abs(way[second] - way[first]) <= STEEPEST * (second - first) * way[second] / focal_px).all())
