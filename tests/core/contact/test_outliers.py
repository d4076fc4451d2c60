import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from tactune.core.contact.outliers import statistical
from tactune.core.contact.outliers.clusters import in_large_cluster
from tactune.core.contact.outliers.grid import Grid
from tactune.core.contact.outliers.statistical import below_threshold, exact_means, near_means, statistical_inliers
from tactune.core.model.clouds import deproject
from tactune.core.model.frames import DepthCamera
from tactune.core.model.intrinsics import Intrinsics


def scene(seed, width, height, share, noise_m, distortion="none"):
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
    return deproject(counts, camera, pixels), pixels, Grid(lens)


def open3d_inliers(points, k, ratio):
    o3d = pytest.importorskip("open3d", reason="needs the extra open3d")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    kept = np.zeros(len(points), bool)
    kept[np.asarray(cloud.remove_statistical_outlier(k, ratio)[1], dtype=int)] = True
    return kept


@pytest.mark.parametrize("k", [2, 20])
@pytest.mark.parametrize(("share", "noise_m"), [(0.9, 0.001), (0.3, 0.004), (0.02, 0.001)])
@pytest.mark.parametrize("distortion", ["none", "brown_conrady"])
def test_the_inlier_set_is_open3ds_point_for_point(k, share, noise_m, distortion):
    ratio = {2: 0.5, 20: 2.0}[k]
    points, pixels, grid = scene(k, 160, 120, share, noise_m, distortion)
    kept = statistical_inliers(points, pixels, grid, k, ratio)
    assert np.array_equal(kept, open3d_inliers(points, k, ratio))
    assert 0 < kept.sum() < len(points)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), k=st.integers(2, 60), share=st.floats(0.01, 1.0), noise=st.floats(0, 0.02))
def test_means_are_as_near_as_they_say(seed, k, share, noise):
    points, pixels, grid = scene(seed, 67, 41, share, noise)
    if len(points) < 2:
        return
    k = min(k, len(points))
    exact = exact_means(points, k)
    for precise, uncertainty in ((False, statistical.UNCERTAINTY), (True, statistical.PRECISE_UNCERTAINTY / 100)):
        assert np.abs(near_means(points, pixels, grid, k, precise) / exact - 1).max() <= uncertainty


def test_a_point_too_near_to_the_threshold_is_decided_more_precisely_then_exactly(monkeypatch):
    points, pixels, grid = scene(5, 80, 60, 0.9, 0.001)
    wanted = open3d_inliers(points, 20, 2.0)
    exact = exact_means(points, 20)
    nearest = np.abs(exact / (exact.mean() + 2.0 * exact.std(ddof=1)) - 1).min()
    assert nearest > 10 * statistical.UNCERTAINTY
    calls = []
    monkeypatch.setattr(statistical, "near_means", lambda *a: calls.append(a[4]) or near_means(*a))
    monkeypatch.setattr(statistical, "below_threshold", lambda *a: calls.append("exact") or below_threshold(*a))
    for name, expected in (
        ("", [False]),
        ("UNCERTAINTY", [False, True]),
        ("PRECISE_UNCERTAINTY", [False, True, "exact"]),
    ):
        if name:
            monkeypatch.setattr(statistical, name, nearest)
        calls.clear()
        assert np.array_equal(statistical_inliers(points, pixels, grid, 20, 2.0), wanted)
        assert calls == expected


@pytest.mark.parametrize(("factor", "max_pairs"), [(1, 20_000), (1, 10**8), (1e9, 10**8)])
def test_clouds_without_a_near_neighbour(monkeypatch, factor, max_pairs):
    """Left points go to the tree or are compared with all; coordinates that are too large go to the tree at once."""
    points, pixels, grid = scene(3, 640, 480, 0.0008, 0.001)
    points = points * np.float32(factor)
    monkeypatch.setattr(statistical, "MAX_PAIRS", max_pairs)
    assert np.array_equal(statistical_inliers(points, pixels, grid, 60, 2.0), open3d_inliers(points, 60, 2.0))


@given(mask=arrays(np.bool_, (7, 5)), smallest=st.integers(1, 8))
def test_groups_touch_at_corners_and_the_smallest_area_is_kept(mask, smallest):
    lens = Intrinsics(width=5, height=7, fx=30.0, fy=30.0, cx=2.0, cy=1.5)  # a pixel at 0.3 m is 100 mm2
    labels = ndimage.label(mask, np.ones((3, 3)))[0][mask]
    large = in_large_cluster(np.full(len(labels), 0.3), np.flatnonzero(mask), lens, 100 * smallest - 1e-6)
    assert np.array_equal(large, np.bincount(labels)[labels] >= smallest)
