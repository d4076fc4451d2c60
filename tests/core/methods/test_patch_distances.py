from __future__ import annotations

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactune.core.evaluation.metrics import (
    area_error_mm2,
    boundary_distance_px,
    cloud_distances,
    separate_contacts,
    symmetric_rmse_m,
)


def clouds(seed: int, first: int, second: int):
    random = np.random.default_rng(seed)
    return random.normal(0.0, 0.05, (first, 3)), random.normal(0.01, 0.03, (second, 3))


def directed(points, others):
    """Every distance to every other point, the least of each."""
    return np.array([min(math.dist(p, q) for q in others) for p in points])


@given(st.integers(0, 10_000), st.integers(1, 40), st.integers(1, 40))
def test_every_distance_against_a_brute_force_oracle(seed, first, second):
    patch, truth = clouds(seed, first, second)
    there, back = directed(patch, truth), directed(truth, patch)
    found = cloud_distances(patch, truth)
    assert found.patch_to_truth_rms_m == pytest.approx(math.sqrt(sum(d * d for d in there) / first))
    assert found.truth_to_patch_rms_m == pytest.approx(math.sqrt(sum(d * d for d in back) / second))
    assert found.symmetric_rmse_m == pytest.approx((found.patch_to_truth_rms_m + found.truth_to_patch_rms_m) / 2)
    assert found.hausdorff_m == pytest.approx(max(*there, *back))
    assert found.percentile_95_m == pytest.approx(max(np.percentile(there, 95), np.percentile(back, 95)))
    assert found.chamfer_m == pytest.approx((sum(there) / first + sum(back) / second) / 2)
    assert symmetric_rmse_m(patch, truth) == pytest.approx(found.symmetric_rmse_m)


def test_every_distance_against_open3d():
    open3d = pytest.importorskip("open3d")
    patch, truth = clouds(7, 3000, 2000)
    a, b = (open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points)) for points in (patch, truth))
    there, back = np.asarray(a.compute_point_cloud_distance(b)), np.asarray(b.compute_point_cloud_distance(a))
    found = cloud_distances(patch, truth)
    rms = [float(np.sqrt(np.mean(distances**2))) for distances in (there, back)]
    assert found.patch_to_truth_rms_m == pytest.approx(rms[0], rel=1e-9)
    assert found.truth_to_patch_rms_m == pytest.approx(rms[1], rel=1e-9)
    assert found.symmetric_rmse_m == pytest.approx(sum(rms) / 2, rel=1e-9)
    assert found.hausdorff_m == pytest.approx(max(there.max(), back.max()), rel=1e-9)
    assert found.chamfer_m == pytest.approx((there.mean() + back.mean()) / 2, rel=1e-9)


def test_direction_is_in_the_name():
    found = cloud_distances([[0, 0, 0]], [[0, 0, 0], [0, 0, 3]])
    assert found.patch_to_truth_rms_m == 0.0
    assert found.truth_to_patch_rms_m == pytest.approx(3 / math.sqrt(2))
    assert found.hausdorff_m == 3.0


def test_no_distance_to_nothing():
    some, none = np.zeros((2, 3)), np.empty((0, 3))
    for patch, truth in ((some, none), (none, some), (none, none)):
        assert all(math.isnan(value) for value in astuple(cloud_distances(patch, truth)))


def square(left: int, top: int, side: int):
    mask = np.zeros((60, 60), bool)
    mask[top : top + side, left : left + side] = True
    return mask


def test_boundary_distance_of_concentric_squares():
    assert boundary_distance_px(square(10, 10, 20), square(10, 10, 20)) == 0.0
    inner, outer = square(15, 15, 21), square(12, 12, 27)
    # from each inner outline pixel straight out it is 3 px; from the outer corners it is more
    there = 3.0
    side = [3.0] * 21 + [math.hypot(3, step) for step in (1, 2, 3)] * 2
    outer_pixels = 4 * (sum(side) - math.hypot(3, 3)) / (4 * 26)
    assert boundary_distance_px(inner, outer) == pytest.approx((there + outer_pixels) / 2, rel=1e-4)
    assert boundary_distance_px(outer, inner) == pytest.approx(boundary_distance_px(inner, outer))


def test_boundary_distance_is_brute_force_on_blobs():
    random = np.random.default_rng(3)
    for _ in range(5):
        masks = [square(*random.integers(5, 20, 2), 25) ^ square(*random.integers(10, 30, 2), 12) for _ in range(2)]
        outlines = [outline(mask) for mask in masks]
        expected = sum(directed(*pair).mean() for pair in (outlines, outlines[::-1])) / 2
        assert boundary_distance_px(*masks) == pytest.approx(expected, rel=1e-4)


def outline(mask):
    """Pixels of the mask with a pixel above, below, left or right that is not in it."""
    rows, columns = np.nonzero(mask)
    padded = np.pad(mask, 1)
    return [
        (r, c)
        for r, c in zip(rows, columns, strict=True)
        if not all(padded[r + 1 + i, c + 1 + j] for i, j in ((0, 1), (1, 0), (0, -1), (-1, 0)))
    ]


def test_an_edge_of_the_image_is_an_outline():
    full = np.ones((20, 30), bool)
    assert boundary_distance_px(full, full) == 0.0


def test_no_boundary_no_distance():
    some, none = square(10, 10, 5), np.zeros((60, 60), bool)
    assert math.isnan(boundary_distance_px(some, none))
    assert math.isnan(boundary_distance_px(none, some))


def test_separate_contacts():
    mask = square(5, 5, 10) | square(30, 5, 10) | square(50, 50, 5)
    assert separate_contacts(np.zeros((60, 60), bool)) == 0
    assert separate_contacts(mask) == 2
    assert separate_contacts(mask, min_pixels=25) == 3
    assert separate_contacts(square(5, 5, 10) | square(15, 15, 10)) == 1  # joined at a corner


def test_area_error_is_positive_where_the_patch_is_too_large():
    assert area_error_mm2(120.0, 100.0) == 20.0
    assert area_error_mm2(80.0, 100.0) == -20.0
