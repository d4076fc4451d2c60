"""Depth quality of both cameras in a region, and the bias between them, with a verdict on each number.

Fill rate, plane-fit error, Z accuracy and temporal noise over 40 frames are those of librealsense's tools/depth-quality
(readme.md and rs-depth-quality.cpp). Two differences: 65535 counts are no depth, as everywhere in this package, and a
pixel that never had depth counts in the fill rate only. The limits follow what Intel's data sheet of the D400 family
promises (fill rate 99 %, noise in the order of 1 to 2 % of the distance); the bias is judged by the preset's contact
test.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from ..contact.alignment import tactile_homography, tactile_pose
from ..errors import FrameError, RigMismatchError, as_sentence, minus
from ..model.arrays import Float64Array, Uint16Array
from ..model.clouds import ray_table, valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame
from ..model.robust import spread
from ..preset import Preset
from ..sources.base import CameraRole
from .bias import depth_differences

#: Left, top, width, height in pixels.
Rectangle = tuple[int, int, int, int]

#: Number of frames for the temporal noise, as in the tool, and fewest depths of a pixel.
NOISE_FRAMES: Final = 40
_MIN_DEPTHS: Final = 5
#: Share of the points at either end of the depth range that the mean squares leave out, as in the tool.
_CLIPPED: Final = 1 / 200
#: Good and fair values: fill rate; noise and plane fit as a share of the distance; Z accuracy.
_FILL, _NOISE, _ACCURACY = (0.99, 0.95), (0.01, 0.02), (0.02, 0.04)
#: Plane-fit error as a share of the distance: probably not flat, and certainly not one plane. Angles in degrees.
_NOT_FLAT, _NO_PLANE, _TILTED_DEG, _EDGE_ON_DEG = 0.03, 0.1, 15.0, 70.0
#: If the scatter of the differences exceeds this multiple of the fair bias, limited to the second number in metres, the
#: cameras do not see the same surface.
_ONE_SURFACE, _MAX_FAIR_M = 1.5, 0.01
_FLAT_STEP: Final = "No flat surface fills the region: choose a flat target, or drag the region onto one."


class Verdict(StrEnum):
    """Grade of a value."""

    GOOD = "good"
    FAIR = "fair"
    POOR = "poor"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class Reading:
    """One value with its grade.

    Attributes
    ----------
    title, value : str
        Such as ``"Fill rate"``, and the value with its unit; empty if unknown.
    verdict : Verdict
    limit : str
        Limit of a good value.
    step : str
        What to do next; empty if nothing needs to be done.
    """

    title: str
    value: str
    verdict: Verdict
    limit: str = ""
    step: str = ""

    @property
    def line(self) -> str:
        """Everything in one line."""
        value = f"{self.title}: {self.value}" if self.value else self.title
        limit = f" ({self.limit_words})" if self.limit else ""
        return f"{value} – {self.verdict}{limit}." + (f" {self.step}" if self.step else "")

    @property
    def limit_words(self) -> str:
        """The limit, marked as that of a good value if the value exceeds it."""
        return self.limit if self.verdict is Verdict.GOOD or not self.limit else f"good: {self.limit}"


@dataclass(frozen=True)
class CameraQuality:
    """Depth quality of one camera in a region; nan for unknown values.

    Attributes
    ----------
    region : (int, int, int, int)
        Left, top, width, height in this camera's pixels.
    frames : int
        Number of frames for the temporal noise.
    fill_rate : float
        Share of the region's pixels with depth in the newest frame, 0 to 1.
    distance_m, angle_deg : float
        Distance of the camera from the fitted plane, and angle between its normal and the optical axis.
    plane_rms_m : float
        Root mean square distance of the points from the plane, without the nearest and the farthest 0.5 %.
    z_accuracy : float
        Signed error of the distance along the axis as a share of the true one; positive: measured too far.
    temporal_noise_m, temporal_noise_share : float
        Median over the pixels of the standard deviation over the frames, in metres, and over each pixel's depth.
    """

    role: CameraRole
    model: str
    region: Rectangle
    frames: int
    fill_rate: float
    distance_m: float
    angle_deg: float
    plane_rms_m: float
    z_accuracy: float
    temporal_noise_m: float
    temporal_noise_share: float

    def readings(self) -> tuple[Reading, ...]:
        """Return all values with their grades, in display order."""
        readings = [self._fill(), self._plane(), self._noise()]
        if math.isfinite(self.z_accuracy):
            share, word = abs(self.z_accuracy), "too far" if self.z_accuracy >= 0 else "too near"
            verdict = _graded(share, _ACCURACY)
            step = "Measure the true distance along the optical axis, from the front glass."
            limit = f"within {100 * _ACCURACY[0]:.0f} %"
            readings.append(
                Reading("Z accuracy", f"{100 * share:.2f} % {word}", verdict, limit, _unless_good(verdict, step))
            )
        return tuple(readings)

    def _fill(self) -> Reading:
        steps = {
            "proximity": "Raise the laser power or gain, lower the confidence threshold, keep sunlight and black or "
            "shiny targets away.",
            "tactile": "Light the scene evenly, give the target texture, stay beyond the shortest distance.",
        }
        verdict = _graded(-self.fill_rate, (-_FILL[0], -_FILL[1]))
        value, limit = f"{100 * self.fill_rate:.1f} %", f"{100 * _FILL[0]:.0f} % or more"
        return Reading("Fill rate", value, verdict, limit, _unless_good(verdict, steps[self.role]))

    def _plane(self) -> Reading:
        if not math.isfinite(self.plane_rms_m):
            step = "Too few pixels in the region have depth for a plane fit."
            return Reading("Plane fit", "", Verdict.UNKNOWN, step=step)
        share = self.plane_rms_m / self.distance_m
        if share > _NO_PLANE or self.angle_deg > _EDGE_ON_DEG:
            return Reading("Plane fit", "no flat surface", Verdict.UNKNOWN, step=_FLAT_STEP)
        verdict = _graded(share, _NOISE)
        step = _unless_good(verdict, "Check that the target is flat; otherwise come nearer and improve the light.")
        if share > _NOT_FLAT:
            step = _FLAT_STEP
        elif self.angle_deg > _TILTED_DEG:
            step = "Turn the target to face the camera."
        value = (
            f"{1e3 * self.plane_rms_m:.2f} mm, {100 * share:.2f} % of {1e3 * self.distance_m:.0f} mm, "
            f"tilted {self.angle_deg:.0f}°"
        )
        return Reading("Plane fit RMS", value, verdict, f"below {100 * _NOISE[0]:.0f} % at this distance", step)

    def _noise(self) -> Reading:
        if not math.isfinite(self.temporal_noise_m):
            step = f"It needs {NOISE_FRAMES} frames of a static scene; let the source play."
            return Reading("Temporal noise", "", Verdict.UNKNOWN, step=step)
        share, verdict = self.temporal_noise_share, _graded(self.temporal_noise_share, _NOISE)
        value = f"{1e3 * self.temporal_noise_m:.2f} mm, {100 * share:.2f} %, over {self.frames} frames"
        step = _unless_good(verdict, "Keep the scene static; if it is, improve light and texture.")
        return Reading("Temporal noise", value, verdict, f"below {100 * _NOISE[0]:.0f} % at this distance", step)


@dataclass(frozen=True)
class Quality:
    """Depth quality of both cameras, and the difference of both depths in the region.

    Attributes
    ----------
    proximity, tactile : CameraQuality
    bias_m, scatter_m, distance_m : float
        Median of proximity minus tactile depth at the same place, its robust scatter over the pixels, and the median
        proximity depth; nan where both cannot be compared. It is the bias only if both see the same surface.
    problem : str
        Why they cannot be compared.
    """

    proximity: CameraQuality
    tactile: CameraQuality
    bias_m: float = math.nan
    scatter_m: float = math.nan
    distance_m: float = math.nan
    problem: str = ""

    def bias_reading(self, preset: Preset) -> Reading:
        """Grade the bias by the contact test of a preset: its tolerance, or what the membrane test corrects."""
        title = "Bias between the cameras"
        if not math.isfinite(self.bias_m):
            return Reading(title, "", Verdict.UNKNOWN, step=as_sentence(self.problem))
        value = (
            f"the {'proximity' if self.bias_m >= 0 else 'tactile'} camera reads {1e3 * abs(self.bias_m):.2f} mm "
            f"({100 * abs(self.bias_m) / self.distance_m:.2f} %) farther, scatter {1e3 * self.scatter_m:.2f} mm"
        )
        limits = preset.test.bias_limits(preset, self.distance_m)
        if self.scatter_m > _ONE_SURFACE * min(limits.fair_m, _MAX_FAIR_M):
            step = "The cameras do not see the same surface: put a flat, opaque target in front of both."
            return Reading(title, value, Verdict.UNKNOWN, step=step)
        verdict = _graded(abs(self.bias_m), (limits.good_m, limits.fair_m))
        offset = minus(f"{1e3 * self.bias_m:+.1f}")
        step = f"If both see the same flat target, add {offset} mm to the preset's depth offset."
        return Reading(title, value, verdict, limits.reason, _unless_good(verdict, step))


def measure_quality(
    frames: Sequence[SensorFrame], rig: Rig, preset: Preset, region: Rectangle, true_distance_m: float | None = None
) -> Quality:
    """Measure both cameras and the bias between them in a region of the proximity image.

    Everything but the temporal noise is computed from the last frame. Without a pose the tactile camera is measured in
    the same rectangle, without bias.

    Parameters
    ----------
    frames : sequence of SensorFrame
        At least one, oldest first; the last 40 are used.
    rig : Rig
    preset : Preset
        Its alignment relates both cameras.
    region : (int, int, int, int)
        Left, top, width, height in proximity pixels.
    true_distance_m : float, optional
        Distance from the cameras to the target along the optical axis, measured otherwise, for the Z accuracy.
    """
    frames = list(frames)[-NOISE_FRAMES:]
    if not frames:
        raise FrameError("there is no frame to measure; let the source play")
    for frame in frames:
        frame.check_against(rig)
    left, top, width, height = region
    size = rig.proximity.intrinsics
    if min(left, top) < 0 or min(width, height) < 1 or left + width > size.width or top + height > size.height:
        raise FrameError(
            f"the region {width} x {height} at ({left}, {top}) does not lie within the proximity image of "
            f"{size.width} x {size.height} pixels; move it"
        )
    beside = _cut(region, rig.tactile)
    compared: tuple[float, float, float, str] = (math.nan, math.nan, math.nan, "")
    try:
        beside = _tactile_region(frames[-1], rig, preset, region)
        compared = _compared(frames[-1], rig, preset, region)
    except (RigMismatchError, FrameError) as error:
        compared = math.nan, math.nan, math.nan, str(error)
    near, far = ([frame.proximity_depth for frame in frames], [frame.tactile_depth for frame in frames])
    return Quality(
        _camera_quality("proximity", near, rig.proximity, region, true_distance_m),
        _camera_quality("tactile", far, rig.tactile, beside, true_distance_m),
        *compared,
    )


def _camera_quality(
    role: CameraRole, images: Sequence[Uint16Array], camera: DepthCamera, region: Rectangle, true_m: float | None
) -> CameraQuality:
    window = _window(region)
    newest = images[-1][window]
    valid = valid_depth(newest)
    depth = newest[valid].astype(np.float64) * camera.depth_unit_m
    points = np.column_stack([ray_table(camera.intrinsics)[window][valid] * depth[:, None], depth])
    distance_m = angle_deg = rms_m = accuracy = math.nan
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
        if true_m is not None:
            accuracy = (float(np.median(errors)) + float(at_axis_m) - true_m) / true_m
    noise_m, noise_share = temporal_noise(np.stack([image[window] for image in images]), camera.depth_unit_m)
    return CameraQuality(
        role, camera.model, region, len(images), float(valid.mean()), distance_m, angle_deg, rms_m, accuracy,
        noise_m, noise_share,
    )  # fmt: skip


def temporal_noise(counts: Uint16Array, unit_m: float) -> tuple[float, float]:
    """Return the temporal noise of images of a static scene, (N, H, W): metres, and as a share of the depth.

    It is the median over the pixels of each pixel's standard deviation (normalised by N); nan without five depths.
    """
    depths = np.where(valid_depth(counts), counts, np.nan).astype(np.float32).reshape(len(counts), -1)
    depths = depths[:, np.isfinite(depths).sum(axis=0) >= _MIN_DEPTHS]
    if depths.shape[1] == 0:
        return math.nan, math.nan
    median = np.nanmedian(depths, axis=0)
    deviation = np.nanstd(depths - median, axis=0)  # centred, so that float32 is precise enough
    return float(np.median(deviation)) * unit_m, float(np.median(deviation / median))


def _compared(frame: SensorFrame, rig: Rig, preset: Preset, region: Rectangle) -> tuple[float, float, float, str]:
    """Return median difference, scatter and median depth in a region, metres, and no problem."""
    window = _window(region)
    expected_m, difference_m = (
        image[window] for image in depth_differences(frame, preset.with_value("region.enabled", False), rig)
    )
    both = np.isfinite(difference_m)
    if not both.any():
        raise FrameError("no pixel of the region has a depth in both cameras; move the region")
    bias_m = float(np.median(difference_m[both]))
    return bias_m, spread(difference_m[both], bias_m), float(np.median(expected_m[both])), ""


def _tactile_region(frame: SensorFrame, rig: Rig, preset: Preset, region: Rectangle) -> Rectangle:
    """Return the rectangle of the tactile image that corresponds to a region of the proximity image.

    The region's corners are projected at the region's median proximity depth (rigid) or mapped by the homography.
    """
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


def _cut(region: Rectangle, camera: DepthCamera) -> Rectangle:
    """Return a region clipped to an image."""
    size = camera.intrinsics
    left, top = min(region[0], size.width - 1), min(region[1], size.height - 1)
    return left, top, min(region[2], size.width - left), min(region[3], size.height - top)


def _window(region: Rectangle) -> tuple[slice, slice]:
    left, top, width, height = region
    return slice(top, top + height), slice(left, left + width)


def _graded(value: float, limits: tuple[float, float]) -> Verdict:
    return Verdict.GOOD if value <= limits[0] else Verdict.FAIR if value <= limits[1] else Verdict.POOR


def _unless_good(verdict: Verdict, step: str) -> str:
    return "" if verdict is Verdict.GOOD else step
