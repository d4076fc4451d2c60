"""Recheck of a calibration: its points are located again in a current frame, or judged against a new calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..contact.alignment import tactile_homography, tactile_pose
from ..contact.checks import rig_in_use
from ..errors import CalibrationError, RigMismatchError
from ..model.arrays import Float64Array
from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from .calibrate import rigid_points
from .quality import PatchEffect, millimetres_per_pixel, patch_effect
from .report import CalibrationReport
from .rigid import Pose, RigidPoints, clicks_in_depth
from .texture import measure_pairs

#: Drift above which to calibrate again, pixels; or the calibration's own 95 % bound, if larger.
RECALIBRATE_PX = 1.0
_MIN_FOUND = 4
#: A new calibration is worse if its error exceeds the present one's by this factor, and by this many pixels.
_WORSE_FACTOR, _WORSE_PX = 1.2, 0.1


@dataclass(frozen=True, eq=False)
class Drift:
    """Alignment error in the current frame.

    Attributes
    ----------
    drift_px, drift_mm : float
        Median distance between predicted and found places, in proximity pixels, and across the line of sight.
    worst_px : float
        95th percentile of the distances.
    stored, found : int
        Number of points in the preset, and of those found again.
    recalibrate : bool
    sentence : str
        The result in words.
    tactile : float64, shape (N, 2)
        Compared places, tactile pixels.
    offsets_px : float64, shape (N, 2)
        Found minus predicted proximity depth pixel.
    """

    drift_px: float
    drift_mm: float
    worst_px: float
    stored: int
    found: int
    recalibrate: bool
    sentence: str
    tactile: Float64Array
    offsets_px: Float64Array


def recheck(preset: Preset, rig: Rig, frame: SensorFrame) -> Drift:
    """Compare a preset's alignment with a current frame.

    The preset's points and other textured places of the membrane are located in the proximity colour image by local
    matching.

    Parameters
    ----------
    preset : Preset
    rig : Rig
    frame : SensorFrame
        With a tactile colour image.

    Raises
    ------
    CalibrationError
        There is no tactile colour image or too little texture.
    RigMismatchError
        Neither preset nor rig has the pose between the cameras.
    """
    frame.check_against(rig)
    if frame.tactile_color is None:
        raise CalibrationError(
            f"frame {frame.sequence} has no tactile colour image to compare; use a source that has one"
        )
    section, rig = preset.alignment, rig_in_use(preset, rig)
    pose = _present_pose(preset, rig)
    record = section.calibration
    stored = np.array([[p.tactile_u, p.tactile_v] for p in record.points if p.enabled] if record else []).reshape(-1, 2)
    points, found_again = measure_pairs(frame, rig, pose), 0
    if len(stored):
        again = measure_pairs(frame, rig, pose, stored)
        points, found_again = RigidPoints.joined([again, points]), len(again.tactile)
    if len(points.tactile) < _MIN_FOUND:
        raise CalibrationError(
            f"only {len(points.tactile)} places look alike in both colour images; "
            "light the membrane evenly and check that both cameras see it, then calibrate again if that does not help"
        )
    found, predicted = _found_and_predicted(points, preset, rig, pose)
    offsets = found - predicted
    lengths = np.hypot(*offsets.T)
    drift = float(np.median(lengths))
    drift_mm = float(np.median(lengths * millimetres_per_pixel(points.tactile_depth_m, rig)))
    limit = max(RECALIBRATE_PX, record.quality.alignment_bound_95_px if record else 0.0)
    return Drift(
        drift_px=drift,
        drift_mm=drift_mm,
        worst_px=float(np.percentile(lengths, 95)),
        stored=len(stored),
        found=found_again,
        recalibrate=drift > limit,
        sentence=_sentence(drift, drift_mm, limit, len(points.tactile)),
        tactile=points.tactile,
        offsets_px=offsets,
    )


@dataclass(frozen=True)
class Replacement:
    """The expected errors of a new calibration and of the alignment that it would replace.

    Attributes
    ----------
    new_px : float
        Expected alignment error of the new calibration, proximity pixels.
    present_px : float
        Error of the present alignment at the new calibration's pairs beyond the noise of the clicks, proximity pixels;
        at least the error that its own calibration expected.
    mm_per_px : float
        Millimetres across the line of sight per proximity pixel, mean over the pairs.
    new, present : PatchEffect
        What both errors do to a contact patch.
    """

    new_px: float
    present_px: float
    mm_per_px: float
    new: PatchEffect
    present: PatchEffect

    @property
    def worse(self) -> bool:
        """Whether the new calibration is clearly worse than the present alignment."""
        return clearly_larger(self.new_px, self.present_px, _WORSE_PX)


def clearly_larger(error: float, other: float, least: float) -> bool:
    """Whether an error exceeds another one by a fifth and by this much."""
    return error > max(_WORSE_FACTOR * other, other + least)


def replacement(report: CalibrationReport, preset: Preset) -> Replacement | None:
    """Compare a new calibration with a preset's alignment; None without a present alignment or pairs with depth."""
    rig, chosen = report.rig, report.chosen
    used = {pair.id for pair in chosen.pairs if pair.used}
    pairs = [pair for pair in report.pairs if pair.id in used and pair.tactile_depth_m is not None]
    section = preset.alignment
    try:
        pose = _present_pose(preset, rig)
    except RigMismatchError:
        return None
    if not pairs:
        return None
    found, predicted = _found_and_predicted(rigid_points(pairs), preset, rig, pose)
    squared_px = float(np.mean(((found - predicted) ** 2).sum(axis=1)))
    noise = 0.0 if chosen.rms_px is None else chosen.rms_px**2 * 2 * len(used) / chosen.degrees
    record = section.calibration
    expected_px = 0.0 if record is None else record.quality.alignment_px
    present_px = max(float(np.sqrt(max(squared_px - noise, 0.0))), expected_px)
    depths = np.array([pair.tactile_depth_m for pair in pairs], np.float64)
    mm_per_px = float(millimetres_per_pixel(depths, rig).mean())
    effect = _present_effect(report, preset, pose)
    if record is not None:
        effect = PatchEffect(
            max(effect.boundary_mm, record.quality.boundary_error_mm),
            effect.depth_mm,
            max(effect.supported_tolerance, record.quality.supported_tolerance),
        )
    return Replacement(chosen.alignment_px, present_px, mm_per_px, chosen.effect, effect)


def _present_effect(report: CalibrationReport, preset: Preset, pose: Pose) -> PatchEffect:
    """Return the patch effect of a preset's alignment: where it differs from the new one beyond that one's error.

    The distance along the line of sight is judged by the new rigid fit, or taken as equal where there is none.
    """
    rig, spread = report.rig, report.chosen.map
    places = spread.places
    depth = pose.scale * places[:, 2] + pose.offset_m
    points = pose.points_m(rig.tactile.intrinsics, places)
    by_pose = preset.alignment.model == "rigid"
    predicted = _predicted(preset, rig, places, points)
    gap_px = np.hypot(*(predicted - spread.proximity).T)
    lateral_px = np.sqrt(np.maximum(gap_px**2 - spread.sigma_px**2, 0.0))
    distance = depth if report.rigid is None else report.rigid.points_m(places)[:, 2]
    along_mm = 1e3 * (distance - (points[:, 2] if by_pose else depth)) * (report.rigid is not None)
    return patch_effect(lateral_px * millimetres_per_pixel(places[:, 2], rig), along_mm, distance)


def _found_and_predicted(
    points: RigidPoints, preset: Preset, rig: Rig, pose: Pose
) -> tuple[Float64Array, Float64Array]:
    """Return proximity depth pixels (N, 2): found, and predicted by the preset."""
    space = pose.points_m(rig.tactile.intrinsics, points.places)
    found = clicks_in_depth(rig, points.proximity, points.in_color, space)
    return found, _predicted(preset, rig, points.places, space)


def _predicted(preset: Preset, rig: Rig, places: Float64Array, points_m: Float64Array) -> Float64Array:
    """Return where the preset's alignment maps places (N, 3): proximity depth pixels (N, 2)."""
    if preset.alignment.model == "rigid":
        return rig.proximity.intrinsics.project(points_m)
    x, y, w = tactile_homography(preset.alignment, rig) @ np.column_stack([places[:, :2], np.ones(len(places))]).T
    return np.column_stack([x / w, y / w])


def _present_pose(preset: Preset, rig: Rig) -> Pose:
    section = preset.alignment
    return Pose.of(tactile_pose(section, rig), section.depth_scale, section.depth_offset_m)


def _sentence(drift: float, drift_mm: float, limit: float, count: int) -> str:
    measured = f"The alignment is off by {drift:.2f} px ({drift_mm:.2f} mm), median of {count} places"
    if drift > limit:
        return f"{measured}: calibrate again, {limit:.1f} px would still be good."
    return f"{measured}: no need to calibrate again."
