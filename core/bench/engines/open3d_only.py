"""The pipeline with Open3D's point clouds only.

Without a pixel grid the tolerance test becomes a distance to the nearest tactile point, so its outcome differs from
the reference. Its colour mask is the one of the reference.
"""

from __future__ import annotations

import numpy as np

from ...contact.alignment import tactile_pose
from ...model.frames import DepthCamera
from ..registry import Job, Outcome, Runner, engine
from ..scenes import BenchScene
from .reference import candidate_colors, open3d_inliers


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
