"""The verdict on a calibration in words, with the one next step that helps most."""

from __future__ import annotations

import numpy as np

from ..model.arrays import Float64Array
from ..model.frames import Rig
from .quality import Coverage
from .report import ModelQuality

#: Expected alignment error over the membrane, pixels, up to which a calibration is good, and usable.
GOOD_PX, USABLE_PX = 0.6, 1.5
#: Points that a calibration should have at least, so that its quality can be seen.
ADVISED_POINTS = 6
#: Depth that the points of a rigid alignment should span, millimetres.
ADVISED_SPAN_MM = 20.0
_FAR_PX = 80.0
_SUSPICIOUS = 3.0


def verdict(quality: ModelQuality, coverage: Coverage, proximity: Float64Array, rig: Rig) -> str:
    """Say how good a fit is and what to do next.

    Parameters
    ----------
    quality : ModelQuality
        Of the chosen model.
    coverage : Coverage
    proximity : float64, shape (N, 2)
        Proximity depth pixels of the pairs that the fit uses.
    rig : Rig
    """
    return f"{grade(quality)} {next_step(quality, coverage, proximity, rig)}"


def grade(quality: ModelQuality) -> str:
    """Say in one sentence how good a fit is."""
    if quality.degrees <= 0:
        used = sum(pair.used for pair in quality.pairs)
        return (
            f"Unknown: {used} points fit a {quality.model} exactly, so residuals of 0 say nothing; clicks of usual "
            f"noise would leave an alignment error of {quality.alignment_px:.1f} px."
        )
    word = "Good" if quality.alignment_px <= GOOD_PX else "Usable" if quality.alignment_px <= USABLE_PX else "Poor"
    effect = quality.effect
    return (
        f"{word}: expected alignment error {quality.alignment_px:.2f} px ({quality.alignment_mm:.2f} mm), with 95 % "
        f"certainty below {quality.alignment_bound_95_px:.2f} px; patch boundary off by "
        f"{effect.boundary_mm:.1f} mm; the tolerance test needs t from {effect.supported_tolerance:.3f}."
    )


def next_step(quality: ModelQuality, coverage: Coverage, proximity: Float64Array, rig: Rig) -> str:
    """Say in one sentence what helps most now."""
    used = len(proximity)
    if quality.excluded:
        listed = ", ".join(quality.excluded[:5]) + (", ..." if len(quality.excluded) > 5 else "")
        worst = max((pair for pair in quality.pairs if not pair.used), key=lambda pair: pair.residual_px)
        return (
            f"Click again or delete pair {listed}: left out, because the others contradict it "
            f"(pair {worst.id} by {worst.residual_px:.0f} px)."
        )
    missing = ADVISED_POINTS - used
    if missing > 0:
        return f"Add {missing} more point{'s' if missing > 1 else ''}: with six the quality can be seen."
    found = _weakest_place(quality, proximity, rig) or _shallow_points(quality, coverage) or _suspicious_pair(quality)
    if found:
        return found
    if quality.alignment_px > GOOD_PX:
        wanted = int(np.ceil(used * (quality.alignment_px / GOOD_PX) ** 2))
        return f"Add points to lower the error; about {min(wanted, 60)} of the same care in all."
    return "Nothing more is needed: check it on the live image and save it."


def _weakest_place(quality: ModelQuality, proximity: Float64Array, rig: Rig) -> str:
    """Name the place that is known worst, if it is far from every point and much worse than the rest."""
    uncertainty = quality.map
    gaps = np.hypot(*(uncertainty.proximity[:, None] - proximity[None]).transpose(2, 0, 1)).min(axis=1)
    far = gaps > _FAR_PX
    if not far.any():
        return ""
    worst = int(np.argmax(np.where(far, uncertainty.sigma_px, -1.0)))
    if uncertainty.sigma_px[worst] < 1.3 * np.median(uncertainty.sigma_px):
        return ""
    place = place_name(uncertainty.proximity[worst], rig.proximity.intrinsics.shape)
    return (
        f"Add points {place}: none within {10 * int(gaps[worst] // 10)} px, and the error grows to "
        f"{uncertainty.sigma_px[worst]:.1f} px there."
    )


def _shallow_points(quality: ModelQuality, coverage: Coverage) -> str:
    if quality.model != "rigid" or coverage.depth_span_mm >= ADVISED_SPAN_MM:
        return ""
    return (
        f"Add points at another inflation level: all lie within {coverage.depth_span_mm:.0f} mm of depth, "
        f"{ADVISED_SPAN_MM:.0f} mm or more hold the pose."
    )


def _suspicious_pair(quality: ModelQuality) -> str:
    kept = [pair for pair in quality.pairs if pair.used and np.isfinite(pair.left_out_px)]
    if not kept or quality.cross_validated_px is None:
        return ""
    worst = max(kept, key=lambda pair: pair.left_out_px)
    usual = float(np.median([pair.left_out_px for pair in kept]))
    if worst.left_out_px < _SUSPICIOUS * max(usual, 0.3):
        return ""
    return f"Look at pair {worst.id} again: the others put it {worst.left_out_px:.1f} px away."


def place_name(pixel: Float64Array, shape: tuple[int, int]) -> str:
    """Return where in an image (height, width) a pixel lies, such as ``"at the upper left"``."""
    row = ("upper", "middle", "lower")[int(np.clip(3 * pixel[1] / shape[0], 0, 2))]
    column = ("left", "middle", "right")[int(np.clip(3 * pixel[0] / shape[1], 0, 2))]
    if row == column == "middle":
        return "in the middle"
    if row == "middle":
        return f"at the {column}"
    return f"at the {row} {column}"
