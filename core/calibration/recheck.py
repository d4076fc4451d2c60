"""Recheck of a calibration: on the texture of a current frame, or against the points of a new calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..contact.checks import rig_in_use
from ..errors import CalibrationError, RigMismatchError
from ..model.arrays import Float64Array
from ..model.frames import Rig, SensorFrame
from ..preset import AlignmentSection, Preset
from .geometry import Alignment, clicks_in_depth
from .points import PointArrays
from .quality import millimetres_per_pixel
from .report import CalibrationReport
from .texture import measure_pairs

#: Drift above which to calibrate again, pixels; or the calibration's own 95 % bound, if larger.
RECALIBRATE_PX = 1.0
_MIN_FOUND = 4
#: A new calibration is worse if its error exceeds the present one's by this factor, and by this many pixels.
_WORSE_FACTOR, _WORSE_PX = 1.2, 0.1


@dataclass(frozen=True, eq=False)
class Drift:
    """Alignment error in a frame: its median, the places compared, (N, 2), and found minus predicted pixel there."""

    drift_px: float
    drift_mm: float
    recalibrate: bool
    sentence: str
    tactile: Float64Array
    offsets_px: Float64Array


def recheck(preset: Preset, rig: Rig, frame: SensorFrame) -> Drift:
    """Compare a preset's alignment with a current frame, by matching places of the membrane in the colour images."""
    frame.check_against(rig)
    if not rig.has_proximity:
        raise CalibrationError("the rig has one camera, so there is no alignment")
    if frame.tactile_color is None:
        raise CalibrationError(
            f"frame {frame.sequence} has no tactile colour image to compare; use a source that has one"
        )
    rig = rig_in_use(preset, rig)
    alignment = Alignment.of_preset(preset.alignment, rig)
    pose = _pose(preset.alignment, rig)
    record = preset.alignment.calibration
    points = measure_pairs(frame, rig, pose)
    if len(points) < _MIN_FOUND:
        raise CalibrationError(
            f"only {len(points)} places look alike in both colour images; "
            "light the membrane evenly and check that both cameras see it, then calibrate again if that does not help"
        )
    offsets = _offsets(points, alignment, pose, rig)
    lengths = np.hypot(*offsets.T)
    drift = float(np.median(lengths))
    drift_mm = float(np.median(lengths * millimetres_per_pixel(points.tactile_depth_m, rig)))
    limit = max(RECALIBRATE_PX, record.quality.alignment_bound_95_px if record else 0.0)
    measured = f"The alignment is off by {drift:.2f} px ({drift_mm:.2f} mm), median of {len(points)} places"
    advice = f"calibrate again, {limit:.1f} px would still be good" if drift > limit else "no need to calibrate again"
    return Drift(
        drift_px=drift,
        drift_mm=drift_mm,
        recalibrate=drift > limit,
        sentence=f"{measured}: {advice}.",
        tactile=points.tactile,
        offsets_px=offsets,
    )


def present_error_px(report: CalibrationReport, preset: Preset) -> float | None:
    """Return a preset's error at new pairs beyond click noise, at least that expected before; None without pairs."""
    quality, rig = report.chosen, report.rig
    used = {pair.id for pair in quality.pairs if pair.used}
    points = PointArrays.of([pair for pair in report.pairs if pair.id in used and pair.tactile_depth_m is not None])
    try:
        alignment, pose = Alignment.of_preset(preset.alignment, rig), _pose(preset.alignment, rig)
    except RigMismatchError:
        return None
    if not len(points):
        return None
    squared = float((_offsets(points, alignment, pose, rig) ** 2).sum(axis=1).mean())
    noise = 0.0 if quality.rms_px is None else quality.rms_px**2 * 2 * len(used) / quality.fit.degrees
    record = preset.alignment.calibration
    return max(float(np.sqrt(max(squared - noise, 0.0))), 0.0 if record is None else record.quality.alignment_px)


def is_worse(report: CalibrationReport, preset: Preset) -> bool:
    """Whether a new calibration is clearly worse than a preset's alignment."""
    present = present_error_px(report, preset)
    return present is not None and report.chosen.alignment_px > max(_WORSE_FACTOR * present, present + _WORSE_PX)


def _pose(section: AlignmentSection, rig: Rig) -> Alignment:
    """Return the pose of a preset or its rig, also where the preset aligns by a homography."""
    return Alignment.of_preset(section.model_copy(update={"model": "rigid"}), rig)


def _offsets(points: PointArrays, alignment: Alignment, pose: Alignment, rig: Rig) -> Float64Array:
    """Return found minus predicted proximity depth pixel, shape (N, 2)."""
    found = clicks_in_depth(rig, points.proximity, points.in_color, pose.points_m(rig, points.places))
    return np.asarray(found - alignment.pixels(rig, points.places))
