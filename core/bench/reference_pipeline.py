"""The reference implementation: the tolerance test in plain NumPy, for tests and benchmarks.

It follows the formulas, not the kernels: whole images, no tables, no shortcuts, SciPy's k-d tree for neighbours. In
float32 it repeats the order of operations of the kernels and gives the same bits; float64 shows the rounding error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import label
from scipy.spatial import cKDTree

from ..contact.alignment import tactile_homography, tactile_pose
from ..model.arrays import AnyArray, BoolArray, Uint8Array
from ..model.clouds import ray_table
from ..model.frames import Rig, SensorFrame
from ..model.intrinsics import Distortion, Intrinsics
from ..model.provenance import Provenance
from ..preset import MaskSection, Preset


@dataclass(frozen=True, eq=False)
class ReferencePatch:
    """Points (N, 3) in metres and provenance (H, W), as in `ContactPatch`."""

    points: AnyArray
    provenance: Uint8Array


def reference_patch(preset: Preset, rig: Rig, frame: SensorFrame, dtype: Any = np.float32) -> ReferencePatch:
    """Compute a frame's contact patch in NumPy with the given floating-point type."""
    counts = frame.proximity_depth
    depth = counts.astype(dtype) * dtype(rig.proximity.depth_unit_m)
    rays = ray_table(rig.proximity.intrinsics).astype(dtype)
    points = np.concatenate([rays * depth[..., None], depth[..., None]], axis=2)

    with np.errstate(all="ignore"):
        expected, measured = _both_depths(preset, rig, frame, depth, dtype)
        agrees = np.abs(expected - measured) <= dtype(preset.tolerance.t) * np.abs(expected)

    provenance = np.full(counts.shape, Provenance.OUTSIDE_TOLERANCE, np.uint8)
    provenance[agrees] = Provenance.CONTACT
    provenance[np.isnan(expected) | np.isnan(measured)] = Provenance.NO_TACTILE_DEPTH
    if preset.range.enabled:
        near, far = (np.float32(limit) for limit in preset.range.limits_m)
        provenance[(depth < near) | (depth > far)] = Provenance.OUTSIDE_RANGE
    if preset.region.enabled:
        left, top, width, height = preset.region.rectangle
        outside = np.ones(counts.shape, bool)
        outside[top : top + height, left : left + width] = False
        provenance[outside] = Provenance.OUTSIDE_REGION
    provenance[(counts == 0) | (counts == 65535)] = Provenance.NO_PROXIMITY_DEPTH

    contact = provenance == Provenance.CONTACT
    if preset.mask.enabled:
        provenance[contact & _membrane_colored(points, frame, rig, preset.mask, dtype)] = Provenance.MASKED
    if preset.outliers.enabled:
        where = np.argwhere(provenance == Provenance.CONTACT)
        rejected = where[~inliers(points[tuple(where.T)], preset.outliers.k, preset.outliers.ratio)]
        provenance[tuple(rejected.T)] = Provenance.OUTLIER
    if preset.outliers.min_cluster_area_mm2 > 0:
        provenance[_in_small_cluster(provenance, depth, rig, preset)] = Provenance.SMALL_CLUSTER
    return ReferencePatch(points[provenance == Provenance.CONTACT], provenance)


def _both_depths(
    preset: Preset, rig: Rig, frame: SensorFrame, depth: AnyArray, dtype: Any
) -> tuple[AnyArray, AnyArray]:
    """Return dp and dt of the tolerance test, nan where either camera has no depth."""
    expected, u, v, visible = seen_by_tactile(preset, rig, depth, dtype)
    no_depth = (frame.proximity_depth == 0) | (frame.proximity_depth == 65535)
    expected = np.where(no_depth | ~visible, dtype(np.nan), expected)
    inside, row, column = _nearest(u, v, frame.tactile_depth.shape)
    looked_up = frame.tactile_depth[row, column]
    factor = dtype(rig.tactile.depth_unit_m * preset.alignment.depth_scale)
    measured = looked_up.astype(dtype) * factor + dtype(preset.alignment.depth_offset_m)
    measured[~(inside & visible) | (looked_up == 0) | (looked_up == 65535)] = np.nan
    return expected, measured


def seen_by_tactile(
    preset: Preset, rig: Rig, depth: AnyArray, dtype: Any
) -> tuple[AnyArray, AnyArray, AnyArray, BoolArray]:
    """Return the tactile depth (metres) expected at proximity pixels, their tactile pixels u, v, and which are visible.

    All have the shape of ``depth``, (H, W), metres. Points behind the tactile camera are not visible.
    """
    height, width = depth.shape
    if preset.alignment.model == "rigid":
        T_t_p = np.linalg.inv(tactile_pose(preset.alignment, rig))
        rays = ray_table(rig.proximity.intrinsics).astype(np.float64)
        rays = np.concatenate([rays, np.ones((height, width, 1))], axis=2)
        seen = (rays @ T_t_p[:3, :3].T).astype(dtype) * depth[..., None] + T_t_p[:3, 3].astype(dtype)
        with np.errstate(all="ignore"):
            u, v = _project(seen, rig.tactile.intrinsics, dtype)
        return seen[..., 2], u, v, seen[..., 2] > 0
    H_p_t = tactile_homography(preset.alignment, rig)
    v0, u0 = np.mgrid[:height, :width].astype(np.float64)
    mapped = np.einsum("ij,jvu->ivu", np.linalg.inv(H_p_t), np.stack([u0, v0, np.ones_like(u0)]))
    centre = ((rig.tactile.intrinsics.width - 1) / 2, (rig.tactile.intrinsics.height - 1) / 2, 1.0)
    with np.errstate(all="ignore"):
        u, v = mapped[:2] / mapped[2]
    return depth, u, v, mapped[2] * (H_p_t[2] @ centre) > 0


def _nearest(u: AnyArray, v: AnyArray, shape: tuple[int, ...]) -> tuple[BoolArray, AnyArray, AnyArray]:
    """Return which places lie within an image, and the row and column of their nearest pixels (0 outside)."""
    inside = (u >= -0.5) & (u < shape[1] - 0.5) & (v >= -0.5) & (v < shape[0] - 0.5)
    half = u.dtype.type(0.5)
    column, row = (np.where(inside, np.floor(place + half), 0).astype(int) for place in (u, v))
    return inside, row, column


def _project(points: AnyArray, camera: Intrinsics, dtype: Any) -> tuple[AnyArray, AnyArray]:
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    if camera.has_distortion:
        k1, k2, p1, p2, k3 = (dtype(value) for value in camera.coefficients)
        two = dtype(2)
        r2 = x * x + y * y
        radial = dtype(1) + ((k3 * r2 + k2) * r2 + k1) * r2
        if camera.distortion is Distortion.BROWN_CONRADY:
            dx = two * p1 * x * y + p2 * (r2 + two * x * x)
            dy = two * p2 * x * y + p1 * (r2 + two * y * y)
            x, y = x * radial + dx, y * radial + dy
        else:
            x, y = x * radial, y * radial
            dx = two * p1 * x * y + p2 * (r2 + two * x * x)
            dy = two * p2 * x * y + p1 * (r2 + two * y * y)
            x, y = x + dx, y + dy
    return x * dtype(camera.fx) + dtype(camera.cx), y * dtype(camera.fy) + dtype(camera.cy)


def _membrane_colored(points: AnyArray, frame: SensorFrame, rig: Rig, section: MaskSection, dtype: Any) -> AnyArray:
    """Return which pixels have a known colour in the range of the preset."""
    image = frame.proximity_color
    hsv = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)
    low, high = section.hue
    hue = hsv[..., 0]
    colored = (low <= hue) & (hue <= high) if low <= high else (low <= hue) | (hue <= high)
    for channel, (floor, ceiling) in ((1, section.saturation), (2, section.value)):
        colored &= (hsv[..., channel] >= floor) & (hsv[..., channel] <= ceiling)
    if rig.proximity_color is None:
        return np.asarray(colored)

    T = np.asarray(rig.proximity_color.T_color_depth, dtype=dtype)
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    seen = np.stack([T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + T[i, 3] for i in range(3)], axis=-1)
    with np.errstate(all="ignore"):
        inside, row, column = _nearest(*_project(seen, rig.proximity_color.intrinsics, dtype), image.shape)
    return np.asarray((seen[..., 2] > 0) & inside & colored[row, column])


def inliers(points: AnyArray, k: int, ratio: float) -> BoolArray:
    """Return the inliers of Open3D's statistical outlier removal of points (N, 3), by its definition."""
    count = len(points)
    if count < 2:
        return np.zeros(count, bool)
    k = min(k, count)
    distances = np.reshape(cKDTree(points).query(points, k)[0], (count, k))
    means = distances.mean(axis=1)
    mean = means.mean()
    deviation = np.sqrt(np.sum((means[means > 0] - mean) ** 2) / (count - 1))
    return np.asarray((means > 0) & (means < mean + ratio * deviation))


def _in_small_cluster(provenance: AnyArray, depth: AnyArray, rig: Rig, preset: Preset) -> AnyArray:
    contact = provenance == Provenance.CONTACT
    labels, count = label(contact, structure=np.ones((3, 3)))
    camera = rig.proximity.intrinsics
    pixel_mm2 = np.where(contact, depth.astype(np.float64) ** 2, 0.0) / (camera.fx * camera.fy) * 1e6
    areas = np.bincount(labels.ravel(), weights=pixel_mm2.ravel(), minlength=count + 1)
    return np.asarray(contact & (areas[labels] < preset.outliers.min_cluster_area_mm2))
