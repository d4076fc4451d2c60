"""The baseline: the paper's pipeline written with NumPy in float64, OpenCV and Open3D.

Whole images and library calls, with all tables prepared; nothing is slow on purpose.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from ...contact.alignment import homography_table, tactile_homography, tactile_pose
from ...model.arrays import AnyArray, BoolArray, Float64Array, IndexArray
from ...model.clouds import nearest_pixels
from ...model.frames import ColorCamera
from ...preset import MaskSection
from ..registry import Job, Outcome, Runner, engine
from ..scenes import BenchScene

_Find = Callable[[], tuple[Float64Array, IndexArray]]


@engine("reference", Job.PIPELINE, "NumPy float64 + OpenCV + Open3D", baseline=True, needs=("open3d",))
def whole_pipeline(scene: BenchScene) -> Runner:
    """Per-pixel chain in NumPy and OpenCV, outliers by Open3D."""
    candidates = _candidates(scene)
    outliers = scene.preset.outliers

    def run() -> Outcome:
        points, pixels = candidates()
        if outliers.enabled and len(points):
            kept = open3d_inliers(points, outliers.k, outliers.ratio)
            points, pixels = points[kept], pixels[kept]
        if outliers.min_cluster_area_mm2 > 0 and len(points):
            large = _in_large_cluster(points[:, 2], mask_of(scene, pixels), scene)
            points, pixels = points[large], pixels[large]
        return Outcome(lambda: mask_of(scene, pixels), points)

    return run


@engine("reference-per-pixel", Job.PER_PIXEL, "NumPy float64 + OpenCV", baseline=True)
def per_pixel(scene: BenchScene) -> Runner:
    """The same without outlier removal."""
    candidates = _candidates(scene)

    def run() -> Outcome:
        points, pixels = candidates()
        return Outcome(lambda: mask_of(scene, pixels), points)

    return run


@engine("reference-outliers", Job.OUTLIERS, "Open3D remove_statistical_outlier", baseline=True, needs=("open3d",))
def outliers_only(scene: BenchScene) -> Runner:
    """Open3D's statistical outlier removal of the scene's candidates."""
    points, pixels = candidate_points(scene)
    section = scene.preset.outliers

    def run() -> Outcome:
        kept = open3d_inliers(points, section.k, section.ratio)
        return Outcome(lambda: mask_of(scene, pixels[kept]))

    return run


def candidate_points(scene: BenchScene) -> tuple[Float64Array, IndexArray]:
    """Return the points (N, 3) in metres and flat pixels (N,) that outlier removal starts from.

    Coordinates are float64 but representable as float32, so that every engine gets the same points.
    """
    points, pixels = _candidates(scene)()
    return points.astype(np.float32).astype(np.float64), pixels


def candidate_colors(scene: BenchScene) -> Any:
    """Return a function that returns which points (N, 3) do not have the colour of the mask."""
    preset, rig, frame = scene.preset, scene.rig, scene.frame

    def keeps(points: AnyArray) -> BoolArray:
        row, column, _ = nearest_pixels(points, rig.proximity.intrinsics)
        bare = _membrane_colored(frame.proximity_color, preset.mask)
        return ~_look_up(bare, points, row * rig.proximity.intrinsics.width + column, rig.proximity_color)

    return keeps


def open3d_inliers(points: AnyArray, k: int, ratio: float) -> IndexArray:
    """Return the indices that Open3D's `remove_statistical_outlier` keeps."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    _, kept = cloud.remove_statistical_outlier(k, ratio)
    return np.asarray(kept, np.intp)


def _in_large_cluster(depth: AnyArray, mask: BoolArray, scene: BenchScene) -> BoolArray:
    """Return which pixels of the mask, in order, belong to a connected group of sufficient area."""
    _, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    cluster, lens = labels[mask], scene.rig.proximity.intrinsics
    areas_mm2 = np.bincount(cluster, weights=depth**2 / (lens.fx * lens.fy)) * 1e6
    return np.asarray(areas_mm2[cluster] >= scene.preset.outliers.min_cluster_area_mm2)


def mask_of(scene: BenchScene, pixels: IndexArray) -> BoolArray:
    """Return the mask of flat pixels."""
    mask = np.zeros(scene.frame.proximity_depth.shape, bool)
    mask.reshape(-1)[pixels] = True
    return mask


def _candidates(scene: BenchScene) -> _Find:
    """Return a function that returns the points and pixels that pass tolerance, range, region and mask."""
    preset, rig, frame = scene.preset, scene.rig, scene.frame
    rays = rig.proximity.intrinsics.rays().astype(np.float64)
    align = _rigid(scene, rays) if preset.alignment.model == "rigid" else _homography(scene)
    flat_rays = rays.reshape(-1, 2)
    unit, t = rig.proximity.depth_unit_m, preset.tolerance.t
    in_region = np.ones(frame.proximity_depth.shape, bool)
    if preset.region.enabled:
        left, top, width, height = preset.region.rectangle
        in_region[:] = False
        in_region[top : top + height, left : left + width] = True

    def find() -> tuple[Float64Array, IndexArray]:
        counts = frame.proximity_depth
        pixels = np.flatnonzero((counts != 0) & (counts != 65535) & in_region)
        depth = counts.reshape(-1)[pixels] * unit
        if preset.range.enabled:
            near, far = preset.range.limits_m
            kept = (depth >= near) & (depth <= far)
            pixels, depth = pixels[kept], depth[kept]
        with np.errstate(invalid="ignore", divide="ignore"):
            expected, measured = align(depth, pixels, frame.tactile_depth)
            touching = np.abs(expected - measured) <= t * np.abs(expected)
        pixels, z = pixels[touching], depth[touching]
        points = np.column_stack([flat_rays[pixels] * z[:, None], z])
        if preset.mask.enabled:
            bare = _membrane_colored(frame.proximity_color, preset.mask)
            kept = ~_look_up(bare, points, pixels, rig.proximity_color)
            points, pixels = points[kept], pixels[kept]
        return points, pixels

    return find


def _rigid(scene: BenchScene, rays: Float64Array) -> Any:
    rig, section = scene.rig, scene.preset.alignment
    T_t_p = np.linalg.inv(tactile_pose(section, rig))
    directions = (np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=2) @ T_t_p[:3, :3].T).reshape(-1, 3)
    origin = T_t_p[:3, 3]
    factor = rig.tactile.depth_unit_m * section.depth_scale

    def align(depth: AnyArray, pixels: IndexArray, tactile: AnyArray) -> tuple[AnyArray, AnyArray]:
        seen = directions[pixels] * depth[:, None] + origin
        row, column, inside = nearest_pixels(seen, rig.tactile.intrinsics)
        counts = tactile[row, column]
        measured = counts * factor + section.depth_offset_m
        measured[~inside | (counts == 0) | (counts == 65535)] = np.nan
        return seen[:, 2], measured

    return align


def _homography(scene: BenchScene) -> Any:
    """Warp with OpenCV by a table of nearest pixels."""
    rig, section = scene.rig, scene.preset.alignment
    shape, tactile_shape = rig.proximity.intrinsics.shape, rig.tactile.intrinsics.shape
    table = homography_table(tactile_homography(section, rig), shape, tactile_shape)
    u, v = np.where(table < 0, -1, table % tactile_shape[1]), np.where(table < 0, -1, table // tactile_shape[1])
    maps = cv2.convertMaps(u.astype(np.float32), v.astype(np.float32), cv2.CV_16SC2, nninterpolation=True)
    factor = rig.tactile.depth_unit_m * section.depth_scale

    def align(depth: AnyArray, pixels: IndexArray, tactile: AnyArray) -> tuple[AnyArray, AnyArray]:
        aligned = cv2.remap(tactile, *maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        counts = aligned.reshape(-1)[pixels]
        measured = counts * factor + section.depth_offset_m
        measured[(counts == 0) | (counts == 65535)] = np.nan
        return depth, measured

    return align


def _membrane_colored(image: AnyArray, section: MaskSection) -> BoolArray:
    """Return which pixels of an RGB image have the mask's colour, by OpenCV's inRange."""
    hsv = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)
    low, high = section.hue
    spans = [(low, high)] if low <= high else [(low, 179), (0, high)]
    (s_low, s_high), (v_low, v_high) = section.saturation, section.value
    found = np.zeros(image.shape[:2], bool)
    for h_low, h_high in spans:
        found |= cv2.inRange(hsv, np.array([h_low, s_low, v_low]), np.array([h_high, s_high, v_high])) > 0
    return found


def _look_up(bare: BoolArray, points: AnyArray, pixels: IndexArray, camera: ColorCamera | None) -> BoolArray:
    """Return which points have the membrane's colour in the colour image."""
    if camera is None:
        return bare.reshape(-1)[pixels]
    T = np.asarray(camera.T_color_depth)
    row, column, inside = nearest_pixels(points @ T[:3, :3].T + T[:3, 3], camera.intrinsics)
    return np.asarray(inside & bare[row, column])
