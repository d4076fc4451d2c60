"""Libraries for clouds without a pixel grid: Open3D's point clouds, and outlier removal with k-d trees.

Without a pixel grid the tolerance test of the `open3d-only` pipeline becomes a distance to the nearest tactile point,
so its outcome differs from the reference. Its colour mask is the one of the reference.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...contact.alignment import tactile_pose
from ...model.arrays import IndexArray
from ...model.frames import DepthCamera
from ..registry import Job, Outcome, Runner, engine
from ..scenes import BenchScene
from .reference import candidate_colors, candidate_points, mask_of, open3d_inliers


@engine("open3d-only", Job.PIPELINE, "Open3D's own point-cloud calls", exact=False, needs=("open3d",))
def whole_pipeline(scene: BenchScene) -> Runner:
    """Both depth images to clouds, nearest tactile distance within t z, mask by colour, outliers."""
    import open3d as o3d

    preset, rig, frame = scene.preset, scene.rig, scene.frame
    T_p_t = tactile_pose(preset.alignment, rig)
    keeps_color = candidate_colors(scene)

    def cloud(counts: np.ndarray, camera: DepthCamera, factor: float) -> o3d.geometry.PointCloud:
        lens = camera.intrinsics
        image = o3d.geometry.Image(np.where(counts == 65535, 0, counts).astype(np.uint16))
        pinhole = o3d.camera.PinholeCameraIntrinsic(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy)
        return o3d.geometry.PointCloud.create_from_depth_image(
            image, pinhole, depth_scale=1.0 / factor, depth_trunc=100.0
        )

    def run() -> Outcome:
        proximity = cloud(frame.proximity_depth, rig.proximity, rig.proximity.depth_unit_m)
        factor = rig.tactile.depth_unit_m * preset.alignment.depth_scale
        tactile = cloud(frame.tactile_depth, rig.tactile, factor).transform(T_p_t)
        distances = np.asarray(proximity.compute_point_cloud_distance(tactile))
        points = np.asarray(proximity.points)
        points = points[distances <= preset.tolerance.t * points[:, 2]]
        if preset.mask.enabled and len(points):
            points = points[keeps_color(points)]
        if preset.outliers.enabled and len(points):
            points = points[open3d_inliers(points, preset.outliers.k, preset.outliers.ratio)]
        return Outcome(lambda: _pixels_of(points, scene), points)

    return run


def _pixels_of(points: np.ndarray, scene: BenchScene) -> np.ndarray:
    """Return the mask of the pixels that the points project to."""
    uv = np.rint(scene.rig.proximity.intrinsics.project(points)).astype(np.intp)
    mask = np.zeros(scene.frame.proximity_depth.shape, bool)
    mask[uv[:, 1], uv[:, 0]] = True
    return mask


@engine("scipy-outliers", Job.OUTLIERS, "SciPy cKDTree, all cores")
def scipy_outliers(scene: BenchScene) -> Runner:
    """Build a tree for each frame, then query all points at once."""
    from scipy.spatial import cKDTree

    points, pixels = candidate_points(scene)
    k = min(scene.preset.outliers.k, len(points))
    return _runner(scene, pixels, lambda: cKDTree(points).query(points, k, workers=-1)[0])


@engine("pykdtree-outliers", Job.OUTLIERS, "pykdtree, OpenMP", needs=("pykdtree",))
def pykdtree_outliers(scene: BenchScene) -> Runner:
    """The same with pykdtree, which is optimised for few dimensions."""
    from pykdtree.kdtree import KDTree

    points, pixels = candidate_points(scene)
    k = min(scene.preset.outliers.k, len(points))
    return _runner(scene, pixels, lambda: KDTree(points).query(points, k)[0])


@engine("open3d-tensor-outliers", Job.OUTLIERS, "Open3D tensor remove_statistical_outliers", needs=("open3d",))
def open3d_tensor_outliers(scene: BenchScene) -> Runner:
    """Open3D's tensor interface, on the CPU."""
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
