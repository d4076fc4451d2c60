"""The reference: the tolerance test in plain NumPy, OpenCV and SciPy, as baseline of the benchmark and oracle of tests.

It follows the formulas, not the kernels: whole images and library calls. All tables are prepared; nothing is slow on
purpose. In float32 it repeats the order of operations of the kernels and gives the same bits; float64 shows the
rounding error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from scipy.spatial import cKDTree

from ..contact.alignment import tactile_homography, tactile_pose
from ..contact.masking import in_hsv_range
from ..model.arrays import AnyArray, BoolArray, IndexArray, Uint8Array, Uint16Array
from ..model.clouds import ray_table
from ..model.frames import Rig, SensorFrame
from ..model.intrinsics import Distortion, Intrinsics
from ..model.patch import Provenance
from ..preset import Preset


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


def open3d_inliers(points: AnyArray, k: int, ratio: float) -> BoolArray:
    """Return the points (N, 3) that Open3D's `remove_statistical_outlier` keeps."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    _, kept = cloud.remove_statistical_outlier(k, ratio)
    mask = np.zeros(len(points), bool)
    mask[np.asarray(kept, np.intp)] = True
    return mask


class Reference:
    """The pipeline for one preset and rig; ``remove_outliers`` returns the inliers of points by ``k`` and ``ratio``."""

    def __init__(
        self,
        preset: Preset,
        rig: Rig,
        dtype: Any = np.float64,
        remove_outliers: Callable[[AnyArray, int, float], BoolArray] = inliers,
    ) -> None:
        self.preset, self.rig, self.dtype = preset, rig, dtype
        self._remove_outliers = remove_outliers
        rays = ray_table(rig.proximity.intrinsics).reshape(-1, 2)
        self._rays = rays.astype(dtype)
        self._in_region = np.ones(rig.proximity.intrinsics.shape, bool)
        if preset.region.enabled:
            left, top, width, height = preset.region.rectangle
            self._in_region[:] = False
            self._in_region[top : top + height, left : left + width] = True
        if preset.alignment.model == "rigid":
            T_t_p = np.linalg.inv(tactile_pose(preset.alignment, rig))
            directions = np.concatenate([rays.astype(np.float64), np.ones((len(rays), 1))], axis=1)
            self._directions = (directions @ T_t_p[:3, :3].T).astype(dtype)
            self._origin = T_t_p[:3, 3].astype(dtype)
        else:
            self._homography = _homography(tactile_homography(preset.alignment, rig), rig)

    def seen_by_tactile(self, depth: AnyArray, pixels: IndexArray) -> tuple[AnyArray, AnyArray, AnyArray, BoolArray]:
        """Return tactile depth and place u, v of proximity pixels at a depth (m), and which are visible."""
        if self.preset.alignment.model == "rigid":
            seen = self._directions[pixels] * depth[:, None] + self._origin
            with np.errstate(all="ignore"):
                u, v = _project(seen, self.rig.tactile.intrinsics, self.dtype)
            return seen[:, 2], u, v, seen[:, 2] > 0
        u, v, visible = (values[pixels] for values in self._homography)
        return depth, u, v, visible

    def find(self, frame: SensorFrame, verdicts: Uint8Array | None = None) -> tuple[AnyArray, IndexArray]:
        """Return points (N, 3) in metres and flat pixels (N,) of the patch; fill in each pixel's verdict."""
        preset, dtype = self.preset, self.dtype

        def pass_on(pixels: Any, next_verdict: Provenance) -> None:
            if verdicts is not None:
                verdicts[pixels] = next_verdict

        counts = frame.proximity_depth.reshape(-1)
        pass_on(slice(None), Provenance.NO_PROXIMITY_DEPTH)
        valid = (counts != 0) & (counts != 65535)
        pass_on(valid, Provenance.OUTSIDE_REGION)
        pixels = np.flatnonzero(valid & self._in_region.reshape(-1))
        depth = counts[pixels].astype(dtype) * dtype(self.rig.proximity.depth_unit_m)
        if preset.range.enabled:
            pass_on(pixels, Provenance.OUTSIDE_RANGE)
            near, far = (np.float32(limit) for limit in preset.range.limits_m)
            kept = (depth >= near) & (depth <= far)
            pixels, depth = pixels[kept], depth[kept]
        pass_on(pixels, Provenance.NO_TACTILE_DEPTH)
        expected, u, v, visible = self.seen_by_tactile(depth, pixels)
        measured = self._measured(frame.tactile_depth, u, v, visible)
        pass_on(pixels[~np.isnan(measured)], Provenance.OUTSIDE_TOLERANCE)
        with np.errstate(all="ignore"):
            touching = np.abs(expected - measured) <= dtype(preset.tolerance.t) * np.abs(expected)
        pixels, z = pixels[touching], depth[touching]
        points = np.column_stack([self._rays[pixels] * z[:, None], z])
        if preset.mask.enabled:
            pass_on(pixels, Provenance.MASKED)
            kept = ~self._on_membrane(frame.proximity_color, points, pixels)
            points, pixels = points[kept], pixels[kept]
        outliers = preset.outliers
        if outliers.enabled and len(points):
            pass_on(pixels, Provenance.OUTLIER)
            kept = self._remove_outliers(points, outliers.k, outliers.ratio)
            points, pixels = points[kept], pixels[kept]
        if outliers.min_cluster_area_mm2 > 0 and len(points):
            pass_on(pixels, Provenance.SMALL_CLUSTER)
            kept = self._in_large_cluster(points[:, 2], pixels)
            points, pixels = points[kept], pixels[kept]
        pass_on(pixels, Provenance.CONTACT)
        return points, pixels

    def _measured(self, tactile: Uint16Array, u: AnyArray, v: AnyArray, visible: BoolArray) -> AnyArray:
        """Return the measured tactile depth at tactile pixels; nan where there is none."""
        inside, row, column = _nearest(u, v, tactile.shape)
        looked_up = tactile[row, column]
        factor = self.dtype(self.rig.tactile.depth_unit_m * self.preset.alignment.depth_scale)
        measured = looked_up.astype(self.dtype) * factor + self.dtype(self.preset.alignment.depth_offset_m)
        measured[~(inside & visible) | (looked_up == 0) | (looked_up == 65535)] = np.nan
        return np.asarray(measured)

    def _on_membrane(self, image: Uint8Array, points: AnyArray, pixels: IndexArray) -> BoolArray:
        """Return which points have a known colour in the range of the mask, the bare membrane's."""
        bare, camera = in_hsv_range(image, self.preset.mask), self.rig.proximity_color
        if camera is None:
            return bare.reshape(-1)[pixels]
        T = np.asarray(camera.T_color_depth, dtype=self.dtype)
        x, y, z = points.T
        seen = np.stack([T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + T[i, 3] for i in range(3)], axis=-1)
        with np.errstate(all="ignore"):
            inside, row, column = _nearest(*_project(seen, camera.intrinsics, self.dtype), bare.shape)
        return np.asarray((seen[:, 2] > 0) & inside & bare[row, column])

    def _in_large_cluster(self, depth: AnyArray, pixels: IndexArray) -> BoolArray:
        """Return which pixels belong to an 8-connected group of sufficient area."""
        camera = self.rig.proximity.intrinsics
        mask = np.zeros(camera.shape, np.uint8)
        mask.reshape(-1)[pixels] = 1
        _, labels = cv2.connectedComponents(mask, connectivity=8)
        cluster = labels.reshape(-1)[pixels]
        areas_mm2 = np.bincount(cluster, weights=depth.astype(np.float64) ** 2 / (camera.fx * camera.fy)) * 1e6
        return np.asarray(areas_mm2[cluster] >= self.preset.outliers.min_cluster_area_mm2)


def _homography(H_p_t: AnyArray, rig: Rig) -> tuple[AnyArray, AnyArray, BoolArray]:
    """Return the tactile pixels u, v of all proximity pixels, and which are visible, flat."""
    (height, width), tactile = rig.proximity.intrinsics.shape, rig.tactile.intrinsics
    v0, u0 = np.mgrid[:height, :width].astype(np.float64)
    mapped = np.einsum("ij,jvu->ivu", np.linalg.inv(H_p_t), np.stack([u0, v0, np.ones_like(u0)]))
    centre = ((tactile.width - 1) / 2, (tactile.height - 1) / 2, 1.0)
    with np.errstate(all="ignore"):
        u, v = mapped[:2] / mapped[2]
    return u.ravel(), v.ravel(), (mapped[2] * (H_p_t[2] @ centre) > 0).ravel()


def _nearest(u: AnyArray, v: AnyArray, shape: tuple[int, ...]) -> tuple[BoolArray, AnyArray, AnyArray]:
    """Return which places lie within an image, and the row and column of their nearest pixels (0 outside)."""
    inside = (u >= -0.5) & (u < shape[1] - 0.5) & (v >= -0.5) & (v < shape[0] - 0.5)
    half = u.dtype.type(0.5)
    column, row = (np.where(inside, np.floor(place + half), 0).astype(np.intp) for place in (u, v))
    return inside, row, column


def _project(points: AnyArray, camera: Intrinsics, dtype: Any) -> tuple[AnyArray, AnyArray]:
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    if camera.has_distortion:
        k1, k2, p1, p2, k3 = (dtype(value) for value in camera.coefficients)
        two = dtype(2)
        r2 = x * x + y * y
        radial = dtype(1) + ((k3 * r2 + k2) * r2 + k1) * r2
        if camera.distortion is not Distortion.BROWN_CONRADY:  # the tangential part follows the radial one
            x, y, radial = x * radial, y * radial, dtype(1)
        dx = two * p1 * x * y + p2 * (r2 + two * x * x)
        dy = two * p2 * x * y + p1 * (r2 + two * y * y)
        x, y = x * radial + dx, y * radial + dy
    return x * dtype(camera.fx) + dtype(camera.cx), y * dtype(camera.fy) + dtype(camera.cy)
