"""Outlier removal with general k-d trees: what one writes without a pixel grid."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.arrays import IndexArray
from ..registry import Job, Outcome, Runner, engine
from ..scenes import BenchScene
from .reference import candidate_points, mask_of


@engine("scipy-outliers", Job.OUTLIERS, "SciPy cKDTree, all cores")
def scipy_outliers(scene: BenchScene) -> Runner:
    """A new tree for each frame, then all queries at once."""
    from scipy.spatial import cKDTree

    points, pixels = candidate_points(scene)
    k = min(scene.preset.outliers.k, len(points))
    return _runner(scene, pixels, lambda: cKDTree(points).query(points, k, workers=-1)[0])


@engine("pykdtree-outliers", Job.OUTLIERS, "pykdtree, OpenMP", needs=("pykdtree",))
def pykdtree_outliers(scene: BenchScene) -> Runner:
    """The same with pykdtree, whose leaves suit few dimensions."""
    from pykdtree.kdtree import KDTree

    points, pixels = candidate_points(scene)
    k = min(scene.preset.outliers.k, len(points))
    return _runner(scene, pixels, lambda: KDTree(points).query(points, k)[0])


@engine("open3d-tensor-outliers", Job.OUTLIERS, "Open3D tensor remove_statistical_outliers", needs=("open3d",))
def open3d_tensor_outliers(scene: BenchScene) -> Runner:
    """Open3D's newer interface, on the CPU."""
    import open3d as o3d

    points, pixels = candidate_points(scene)
    section = scene.preset.outliers
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(points))

    def run() -> Outcome:
        _, kept = cloud.remove_statistical_outliers(section.k, section.ratio)
        return Outcome(lambda: mask_of(scene, pixels[kept.numpy()]))

    return run


def _runner(scene: BenchScene, pixels: IndexArray, query: Any) -> Runner:
    ratio, count = scene.preset.outliers.ratio, len(pixels)

    def run() -> Outcome:
        means = np.reshape(query(), (count, -1)).mean(axis=1)
        positive = means > 0
        deviation = np.sqrt(np.sum((means[positive] - means.mean()) ** 2) / max(count - 1, 1))
        kept = pixels[positive & (means < means.mean() + ratio * deviation)]
        return Outcome(lambda: mask_of(scene, kept))

    return run
