"""Check of a calibration: on the texture of a current frame, or against the points of a new calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import CalibrationError, RigMismatchError, minus
from ..model.alignment import PointPair
from ..model.arrays import Float64Array
from ..model.frames import Rig, SensorFrame
from ..preset import AlignmentSection, Preset
from .agreement import held_out_px, regions_of
from .geometry import Alignment, clicks_in_depth, named_sides
from .report import CalibrationReport, millimetres_per_pixel
from .texture import measure_pairs

#: Drift above which to calibrate again, pixels; or the calibration's own 95 % bound, if larger.
RECALIBRATE_PX = 1.0
_MIN_FOUND = 4
#: A comparison needs pairs in this many quarters of the image, and this many pairs.
_MIN_REGIONS, _MIN_COMPARED = 3, 6
#: A new calibration is worse if its residuals, or else its expected error, exceed the present one's by this factor; the
#: expected error also by this many pixels.
_WORSE_FACTOR, _WORSE_PX = 1.2, 0.1


@dataclass(frozen=True, eq=False)
class Drift:
    """Alignment error in a frame: its median, the places compared, (N, 2), and found minus predicted pixel there."""

    drift_px: float
    recalibrate: bool
    sentence: str
    tactile: Float64Array
    offsets_px: Float64Array


def check_alignment(preset: Preset, rig: Rig, frame: SensorFrame) -> Drift:
    """Compare a preset's alignment with a current frame, by matching places of the membrane in the colour images."""
    frame.check_against(rig)
    if not rig.has_proximity:
        raise CalibrationError("the rig has one camera, so there is no alignment")
    if frame.tactile_color is None:
        raise CalibrationError(f"frame {frame.sequence} has no tactile colour image; use a source that has one")
    alignment = Alignment.of_preset(preset.alignment, rig)
    pose = _pose(preset.alignment, rig)
    record = preset.alignment.calibration
    points = measure_pairs(frame, rig, pose)
    if len(points) < _MIN_FOUND:
        raise CalibrationError(
            f"only {len(points)} places look alike in both colour images; "
            "light the membrane evenly and check that both cameras see it, then calibrate again if that does not help"
        )
    found = clicks_in_depth(rig, points.proximity, points.in_color, pose.points_m(rig, points.places))
    offsets = np.asarray(found - alignment.pixels(rig, points.places))
    lengths = np.hypot(*offsets.T)
    drift = float(np.median(lengths))
    drift_mm = float(np.median(lengths * millimetres_per_pixel(points.tactile_depth_m, rig)))
    limit = max(RECALIBRATE_PX, record.quality.alignment_bound_95_px if record else 0.0)
    measured = (
        f"The alignment is off by {drift:.2f} px ({drift_mm:.2f} mm){_way(offsets, drift)}, "
        f"median of {len(points)} places"
    )
    again = "calibrate again" if alignment.homography is None else "calibrate again by the rigid model"
    advice = f"more than {limit:.1f} px, {again}" if drift > limit else "no need to calibrate again"
    return Drift(drift, drift > limit, f"{measured}: {advice}.", points.tactile, offsets)


@dataclass(frozen=True)
class Comparison:
    """A new alignment beside a preset's present one, at ``pairs`` pairs, each left out of both fits.

    ``new_px`` and ``present_px`` are the RMS residuals there, with the clicks' noise; ``better_px`` is by how much the
    new one is smaller, with the half width of its 95 % interval. ``verdict`` is "better", "worse" or "equal".
    """

    pairs: int
    new_px: float
    present_px: float
    better_px: float
    half_width_px: float
    verdict: str

    @property
    def sentence(self) -> str:
        """The residuals, their difference and what follows from it."""
        words = {
            "better": "The new alignment is better",
            "worse": "The new alignment is worse than the present one",
            "equal": "These pairs show no difference that matters",
        }
        return (
            f"{words[self.verdict]}: {self.new_px:.2f} px new, {self.present_px:.2f} px present at {self.pairs} pairs, "
            f"each left out of both fits; difference {minus(f'{self.better_px:+z.2f}')} ± {self.half_width_px:.2f} px."
        )


def compare_alignments(report: CalibrationReport, preset: Preset) -> Comparison | None:
    """Compare a new calibration with a preset's alignment by the same pairs, each held out from both.

    The new alignment predicts each pair from the others; pairs of the present alignment's own calibration do not count.
    The differences of the squared residuals in the quarters of the image give the interval, since neighbouring pairs
    share errors. A better one also differs by more than its own 95 % bound: what lies within it, the pairs cannot tell
    from the truth. A worse one has residuals larger by a fifth or more. None where there is no present alignment, or
    too few such pairs.
    """
    from scipy.special import stdtrit  # slow to import

    quality, rig = report.chosen, report.rig
    fit = quality.fit
    try:
        present = Alignment.of_preset(preset.alignment, rig)
    except RigMismatchError:
        return None
    if fit.degrees <= 0:
        return None
    record = preset.alignment.calibration
    seen = set() if record is None else {_clicks(pair) for pair in record.points if pair.enabled}
    fitted = {pair.id for pair in report.pairs if _clicks(pair) in seen}
    points, names = fit.model.points.keep(fit.inliers), np.array(fit.model.names)[fit.inliers]
    before = points.proximity - present.pixels(rig, points.places, points.in_color)
    usable = np.isfinite(before).all(axis=1) & ~np.isin(names, list(fitted))
    new, old = ((residuals[usable] ** 2).sum(axis=1) for residuals in (held_out_px(fit), before))
    if len(new) < _MIN_COMPARED:
        return None
    region = regions_of(points.places[usable])[0]
    regions = [region == one for one in np.unique(region)]
    if len(regions) < _MIN_REGIONS:
        return None
    new_px, old_px = (float(np.sqrt(squares.mean())) for squares in (new, old))
    gains = np.array([(old - new)[own].mean() for own in regions])
    error = float(stdtrit(len(gains) - 1, 0.975) * gains.std(ddof=1) / np.sqrt(len(gains)))
    better, half = old_px - new_px, error / max(new_px + old_px, 1e-9)  # a^2 - b^2 = (a - b)(a + b)
    shifts = present.pixels(rig, points.places) - fit.predict(points.places)
    apart = float(np.sqrt(np.nanmean((shifts**2).sum(axis=1))))
    verdict = "worse" if better < -half and new_px > _WORSE_FACTOR * old_px else "equal"
    if better > half and apart > quality.alignment_bound_95_px:
        verdict = "better"
    return Comparison(len(new), new_px, old_px, better, half, verdict)


def is_worse(report: CalibrationReport, preset: Preset) -> bool:
    """Whether a new calibration is worse than a preset's alignment, or is expected to be where pairs tell nothing."""
    compared, record = compare_alignments(report, preset), preset.alignment.calibration
    if compared is not None and compared.verdict != "equal":
        return compared.verdict == "worse"
    expected = None if record is None else record.quality.alignment_px
    return expected is not None and report.chosen.alignment_px > max(_WORSE_FACTOR * expected, expected + _WORSE_PX)


def _clicks(pair: PointPair) -> tuple[object, ...]:
    return pair.proximity, pair.proximity_image, pair.tactile


def _pose(section: AlignmentSection, rig: Rig) -> Alignment:
    """Return the pose of a preset or its rig, also where the preset aligns by a homography."""
    return Alignment.of_preset(section.model_copy(update={"model": "rigid"}), rig)


def _way(offsets: Float64Array, drift: float) -> str:
    """Return which way the offsets, (N, 2), point in the proximity image; empty where they do not agree."""
    way = np.median(offsets, axis=0)
    return f" to the {named_sides(*way)} in the proximity image" if np.hypot(*way) > drift / 2 else ""
