from __future__ import annotations

from functools import reduce
from operator import add

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactune.core.contact.outliers import statistical
from tactune.core.contact.outliers.clusters import in_large_cluster
from tactune.core.contact.outliers.statistical import (
    NeighbourMemory,
    exact_means,
    near_means,
    precise_means,
    statistical_inliers,
)
from tactune.core.model.clouds import deproject
from tactune.core.model.frames import DepthCamera
from tactune.core.model.intrinsics import Intrinsics


def scene(seed: int, width: int, height: int, share: float, noise_m: float, distortion: str = "none"):
    """A wavy, noisy surface seen through a random share of the pixels."""
    rng = np.random.default_rng(seed)
    lens = Intrinsics(
        width=width, height=height, fx=0.7 * width, fy=0.72 * width, cx=width / 2 - 0.3, cy=height / 2 + 0.2,
        distortion=distortion, coefficients=(0.1, -0.05, 0.002, -0.001, 0.01),
    )  # fmt: skip
    v, u = np.mgrid[:height, :width]
    depth = 0.3 + 0.03 * np.sin(u / 9) * np.cos(v / 7) + rng.normal(0, noise_m, u.shape)
    depth[rng.random(depth.shape) < 0.01] += 0.05
    camera = DepthCamera(intrinsics=lens, depth_unit_m=0.0001)
    pixels = np.flatnonzero(rng.random(depth.shape) < share)
    counts = np.clip(depth / camera.depth_unit_m, 1, 65534).astype(np.uint16)
    return deproject(counts, camera, pixels), pixels, lens


def open3d_inliers(points, k, ratio):
    o3d = pytest.importorskip("open3d", reason="needs the extra open3d")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    kept = np.zeros(len(points), bool)
    kept[np.asarray(cloud.remove_statistical_outlier(k, ratio)[1], dtype=int)] = True
    return kept


@pytest.mark.parametrize("k", [2, 5, 20, 50])
@pytest.mark.parametrize("ratio", [0.5, 2.0])
@pytest.mark.parametrize(("share", "noise_m"), [(0.9, 0.001), (0.3, 0.004), (0.02, 0.001)])
@pytest.mark.parametrize("distortion", ["none", "brown_conrady", "inverse_brown_conrady"])
def test_the_inlier_set_is_open3ds_point_for_point(k, ratio, share, noise_m, distortion):
    points, pixels, lens = scene(k, 160, 120, share, noise_m, distortion)
    kept = statistical_inliers(points, pixels, lens, k, ratio)
    assert np.array_equal(kept, open3d_inliers(points, k, ratio))
    assert 0 < kept.sum() < len(points)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), k=st.integers(1, 40), share=st.floats(0.001, 1.0), noise=st.floats(0, 0.02))
def test_exact_means_are_those_of_a_brute_force_search(seed, k, share, noise):
    points, _, _ = scene(seed, 41, 23, share, noise)
    if len(points) == 0:
        return
    k = min(k, len(points))
    wide = points.astype(np.float64)
    distances = np.sqrt(((wide[:, None] - wide[None]) ** 2).sum(axis=2))
    nearest = np.sort(distances, axis=1)[:, :k]
    # one after another, as Open3D adds; from Python 3.12 on, sum() carries what rounding loses
    expected = [reduce(add, row) / k for row in nearest.tolist()]
    assert exact_means(points, k).tolist() == expected
    chosen = np.arange(0, len(points), 3)
    assert exact_means(points, k, chosen).tolist() == expected[::3]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), k=st.integers(2, 60), share=st.floats(0.01, 1.0), noise=st.floats(0, 0.02))
def test_near_means_are_as_near_as_they_say(seed, k, share, noise):
    points, pixels, lens = scene(seed, 67, 41, share, noise)
    if len(points) < 2:
        return
    k = min(k, len(points))
    exact = exact_means(points, k)
    near, precise = (means(points, pixels, lens, k, NeighbourMemory()) for means in (near_means, precise_means))
    assert np.abs(near / exact - 1).max() <= statistical.UNCERTAINTY
    assert np.abs(precise / exact - 1).max() <= statistical.PRECISE_UNCERTAINTY / 100


def test_a_point_too_near_to_the_threshold_is_decided_in_float64_and_then_exactly(monkeypatch):
    points, pixels, lens = scene(5, 80, 60, 0.9, 0.001)
    wanted = open3d_inliers(points, 20, 2.0)
    exact = exact_means(points, 20)
    limit = exact.mean() + 2.0 * exact.std(ddof=1)
    nearest = np.abs(exact / limit - 1).min()
    assert nearest > 10 * statistical.UNCERTAINTY
    calls = []

    def counted_exact(points, k, chosen=None):
        calls.append("exact for some" if chosen is not None else "exact for all")
        return exact_means(points, k, chosen)

    monkeypatch.setattr(statistical, "exact_means", counted_exact)
    monkeypatch.setattr(statistical, "precise_means", lambda *a: calls.append("precise") or precise_means(*a))
    assert np.array_equal(statistical_inliers(points, pixels, lens, 20, 2.0), wanted)
    assert calls == []
    monkeypatch.setattr(statistical, "UNCERTAINTY", nearest)
    assert np.array_equal(statistical_inliers(points, pixels, lens, 20, 2.0), wanted)
    assert calls[0] == "precise"
    assert "exact for all" not in calls
    calls.clear()
    monkeypatch.setattr(statistical, "PRECISE_UNCERTAINTY", nearest)
    assert np.array_equal(statistical_inliers(points, pixels, lens, 20, 2.0), wanted)
    assert calls[0] == "precise"
    assert calls.count("exact for all") == 1


def test_clouds_without_a_near_neighbour_go_to_the_tree(monkeypatch):
    points, pixels, lens = scene(3, 640, 480, 0.0008, 0.001)
    calls = []
    monkeypatch.setattr(statistical, "MAX_PAIRS", 20_000)
    monkeypatch.setattr(statistical, "exact_means", lambda *a: calls.append(len(a[-1])) or exact_means(*a))
    assert np.array_equal(statistical_inliers(points, pixels, lens, 60, 2.0), open3d_inliers(points, 60, 2.0))
    assert len(calls) == 1
    few = points[:100], pixels[:100]
    assert np.array_equal(statistical_inliers(*few, lens, 60, 2.0), open3d_inliers(few[0], 60, 2.0))
    assert len(calls) == 1  # compared with all others instead
    calls.clear()
    far = points * np.float32(1e9)
    monkeypatch.setattr(statistical, "exact_means", lambda *a: calls.append(len(a[0])) or exact_means(*a))
    assert np.array_equal(statistical_inliers(far, pixels, lens, 20, 2.0), open3d_inliers(far, 20, 2.0))
    assert calls == [len(points)]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.floats(0.05, 0.95), width=st.integers(1, 30), height=st.integers(1, 20))
def test_groups_are_opencvs_components(seed, share, width, height):
    rng = np.random.default_rng(seed)
    mask = rng.random((height, width)) < share
    lens = Intrinsics(width=width, height=height, fx=30.0, fy=30.0, cx=20.0, cy=15.0)
    pixels = np.flatnonzero(mask)
    points = np.full((len(pixels), 3), 0.3, np.float32)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    for pixels_needed in (1, 2, 5, 20):
        expected = stats[labels[mask], cv2.CC_STAT_AREA] >= pixels_needed
        assert np.array_equal(in_large_cluster(points[:, 2], pixels, lens, 100.0 * (pixels_needed - 0.5)), expected)
