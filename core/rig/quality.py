"""Depth quality of both cameras in a region, with a verdict on each number.

Fill rate and plane-fit error are those of librealsense's tools/depth-quality (readme.md and rs-depth-quality.cpp), with
one difference: 65535 counts are no depth, as everywhere in this package. The limits follow what Intel's data sheet of
the D400 family promises. Noise and bias are measured by `tactune.core.rig.noise`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from ..contact.alignment import tactile_homography, tactile_pose
from ..errors import FrameError, RigMismatchError
from ..model.arrays import Float64Array, Uint16Array
from ..model.clouds import ray_table, valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame
from ..preset import Preset
from ..sources.base import CameraRole

#: Left, top, width, height in pixels.
Rectangle = tuple[int, int, int, int]

#: Share of the points at either end of the depth range that the mean squares leave out, as in the tool.
_CLIPPED: Final = 1 / 200
#: Good and fair values: fill rate, and plane-fit error as a share of the distance.
_FILL, _FLATNESS = (0.99, 0.95), (0.01, 0.02)
#: Plane-fit error as a share of the distance: probably not flat, and certainly not one plane. Angles in degrees.
_NOT_FLAT, _NO_PLANE, _TILTED_DEG, _EDGE_ON_DEG = 0.03, 0.1, 15.0, 70.0
_FLAT_STEP: Final = "No flat surface fills the region: choose a flat target, or drag the region onto one."
_FILL_STEPS: Final[dict[CameraRole, str]] = {
    "proximity": "Raise the laser power or gain, lower the confidence threshold, keep sunlight and black or shiny "
    "targets away.",
    "tactile": "Light the scene evenly, give the target texture, stay beyond the shortest distance.",
}


class Verdict(StrEnum):
    """Grade of a value."""

    GOOD = "good"
    FAIR = "fair"
    POOR = "poor"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class Reading:
    """One value with its unit, empty if unknown, its grade, the limit of a good value, and what to do next."""

    title: str
    value: str
    verdict: Verdict
    limit: str = ""
    step: str = ""

    @property
    def limit_words(self) -> str:
        """The limit, marked as that of a good value if the value exceeds it."""
        return self.limit if self.verdict is Verdict.GOOD or not self.limit else f"good: {self.limit}"


@dataclass(frozen=True)
class CameraQuality:
    """Depth quality of one camera in a region: share of pixels with depth, and a plane's place, angle and residual."""

    role: CameraRole
    model: str
    region: Rectangle
    fill_rate: float
    distance_m: float
    angle_deg: float
    plane_rms_m: float

    def readings(self) -> tuple[Reading, Reading]:
        """Return the fill rate and the plane fit with their grades."""
        verdict = _graded(-self.fill_rate, (-_FILL[0], -_FILL[1]))
        limit, step = f"{100 * _FILL[0]:.0f} % or more", _unless_good(verdict, _FILL_STEPS[self.role])
        return Reading("Fill rate", f"{100 * self.fill_rate:.1f} %", verdict, limit, step), self._plane()

    def _plane(self) -> Reading:
        if not math.isfinite(self.plane_rms_m):
            step = "Too few pixels in the region have depth for a plane fit."
            return Reading("Plane fit", "", Verdict.UNKNOWN, step=step)
        share = self.plane_rms_m / self.distance_m
        if share > _NO_PLANE or self.angle_deg > _EDGE_ON_DEG:
            return Reading("Plane fit", "no flat surface", Verdict.UNKNOWN, step=_FLAT_STEP)
        verdict = _graded(share, _FLATNESS)
        step = _unless_good(verdict, "Check that the target is flat; otherwise come nearer and improve the light.")
        if share > _NOT_FLAT:
            step = _FLAT_STEP
        elif self.angle_deg > _TILTED_DEG:
            step = "Turn the target to face the camera."
        value = (
            f"{1e3 * self.plane_rms_m:.2f} mm, {100 * share:.2f} % of {1e3 * self.distance_m:.0f} mm, "
            f"tilted {self.angle_deg:.0f}°"
        )
        return Reading("Plane fit RMS", value, verdict, f"below {100 * _FLATNESS[0]:.0f} % at this distance", step)


def measure_quality(
    frame: SensorFrame, rig: Rig, preset: Preset, region: Rectangle
) -> tuple[CameraQuality, CameraQuality]:
    """Measure the proximity camera in a region, and the tactile camera where it sees the same."""
    frame.check_against(rig)
    left, top, width, height = region
    size = rig.proximity.intrinsics
    if min(left, top) < 0 or min(width, height) < 1 or left + width > size.width or top + height > size.height:
        raise FrameError(
            f"the region {width} x {height} at ({left}, {top}) does not lie within the proximity image of "
            f"{size.width} x {size.height} pixels; move it"
        )
    try:
        beside = _tactile_region(frame, rig, preset, region)
    except (RigMismatchError, FrameError):
        lens = rig.tactile.intrinsics
        left, top = min(left, lens.width - 1), min(top, lens.height - 1)
        beside = left, top, min(width, lens.width - left), min(height, lens.height - top)
    return (
        _camera_quality("proximity", frame.proximity_depth, rig.proximity, region),
        _camera_quality("tactile", frame.tactile_depth, rig.tactile, beside),
    )


def _camera_quality(role: CameraRole, image: Uint16Array, camera: DepthCamera, region: Rectangle) -> CameraQuality:
    window = _window(region)
    valid = valid_depth(image[window])
    depth = image[window][valid].astype(np.float64) * camera.depth_unit_m
    points = np.column_stack([ray_table(camera.intrinsics)[window][valid] * depth[:, None], depth])
    distance_m = angle_deg = rms_m = math.nan
    columns = np.column_stack([points[:, :2], np.ones(len(points))])
    if len(points) >= 3 and np.linalg.matrix_rank(columns) == 3:
        slope_x, slope_y, at_axis_m = np.linalg.lstsq(columns, depth, rcond=None)[0]  # z = a x + b y + c
        length = math.sqrt(slope_x**2 + slope_y**2 + 1)
        distance_m, angle_deg = float(at_axis_m) / length, math.degrees(math.acos(1 / length))
        ordered = points[np.argsort(depth, kind="stable")]
        cut = int(len(ordered) * _CLIPPED)
        kept = ordered[cut : len(ordered) - cut]
        errors = (kept[:, 2] - slope_x * kept[:, 0] - slope_y * kept[:, 1] - at_axis_m) / length
        rms_m = float(np.sqrt(np.mean(errors**2)))
    return CameraQuality(role, camera.model, region, float(valid.mean()), distance_m, angle_deg, rms_m)


def _tactile_region(frame: SensorFrame, rig: Rig, preset: Preset, region: Rectangle) -> Rectangle:
    """Return the rectangle of the tactile image that corresponds to a region of the proximity image."""
    left, top, width, height = region
    right, bottom = left + width - 1, top + height - 1
    corners: Float64Array = np.array([[left, top], [right, top], [left, bottom], [right, bottom]], np.float64)
    if preset.alignment.model == "homography":
        u, v, w = np.linalg.inv(tactile_homography(preset.alignment, rig)) @ np.column_stack([corners, np.ones(4)]).T
        pixels = np.column_stack([u / w, v / w])
    else:
        counts = frame.proximity_depth[_window(region)]
        valid = counts[valid_depth(counts)]
        if len(valid) == 0:
            raise FrameError("the proximity camera sees no depth in the region; move it")
        T_t_p = np.linalg.inv(tactile_pose(preset.alignment, rig))
        depth = float(np.median(valid)) * rig.proximity.depth_unit_m
        points = np.column_stack([rig.proximity.intrinsics.normalise(corners), np.ones(4)]) * depth
        pixels = rig.tactile.intrinsics.project(points @ T_t_p[:3, :3].T + T_t_p[:3, 3])
    limits = np.array([rig.tactile.intrinsics.width, rig.tactile.intrinsics.height])
    first = np.clip(np.rint(pixels.min(axis=0)), 0, limits).astype(int)
    last = np.clip(np.rint(pixels.max(axis=0)) + 1, 0, limits).astype(int)
    if (last - first < 2).any():
        raise FrameError("the tactile camera does not see the region; move it")
    return int(first[0]), int(first[1]), int(last[0] - first[0]), int(last[1] - first[1])


def _window(region: Rectangle) -> tuple[slice, slice]:
    left, top, width, height = region
    return slice(top, top + height), slice(left, left + width)


def _graded(value: float, limits: tuple[float, float]) -> Verdict:
    return Verdict.GOOD if value <= limits[0] else Verdict.FAIR if value <= limits[1] else Verdict.POOR


def _unless_good(verdict: Verdict, step: str) -> str:
    return "" if verdict is Verdict.GOOD else step
