from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactune.core import outliers
from tactune.core.clouds import deproject
from tactune.core.frames import DepthCamera
from tactune.core.intrinsics import Intrinsics
from tactune.core.outliers import in_large_cluster, mean_neighbour_distances, statistical_inliers


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
def test_neighbour_distances_are_a_brute_force_searchs(seed, k, share, noise):
    points, pixels, lens = scene(seed, 41, 23, share, noise)
    if len(points) == 0:
        return
    k = min(k, len(points))
    wide = points.astype(np.float64)
    distances = np.sqrt(((wide[:, None] - wide[None]) ** 2).sum(axis=2))
    expected = np.sort(distances, axis=1)[:, :k].mean(axis=1)
    assert mean_neighbour_distances(points, pixels, lens, k) == pytest.approx(expected, rel=1e-12, abs=1e-15)


def test_points_that_the_rings_do_not_settle_go_to_the_tree(monkeypatch):
    points, pixels, lens = scene(3, 160, 120, 0.02, 0.001)
    calls = []
    tree = outliers.cKDTree
    monkeypatch.setattr(outliers, "cKDTree", lambda cloud: calls.append(len(cloud)) or tree(cloud))
    kept = statistical_inliers(points, pixels, lens, 60, 2.0)
    assert calls == [len(points)]
    assert np.array_equal(kept, open3d_inliers(points, 60, 2.0))


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_tiny_clouds_follow_open3d(count):
    points, pixels, lens = scene(0, 20, 20, 1.0, 0.01)
    some = statistical_inliers(points[:count], pixels[:count], lens, 20, 2.0)
    assert some.shape == (count,)
    if count:
        assert np.array_equal(some, open3d_inliers(points[:count], 20, 2.0))


def test_the_result_does_not_depend_on_the_number_of_threads():
    points, pixels, lens = scene(8, 160, 120, 0.8, 0.002)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        alone = mean_neighbour_distances(points, pixels, lens, 20)
    finally:
        numba.set_num_threads(threads)
    assert np.array_equal(alone, mean_neighbour_distances(points, pixels, lens, 20))


def test_clusters_are_kept_by_their_area():
    lens = Intrinsics(width=40, height=30, fx=30.0, fy=30.0, cx=20.0, cy=15.0)
    mask = np.zeros((30, 40), bool)
    mask[2:6, 2:6] = True  # 16 pixels of 100 mm2 at 0.3 m
    mask[20, 30] = mask[21, 31] = True  # two pixels that touch at a corner: 200 mm2
    pixels = np.flatnonzero(mask)
    points = np.zeros((len(pixels), 3), np.float32)
    points[:, 2] = 0.3
    for smallest, survivors in ((0.0, 18), (199.0, 18), (201.0, 16), (1599.0, 16), (1601.0, 0)):
        assert in_large_cluster(points, pixels, lens, smallest).sum() == survivors
