"""Result of a calibration: data, JSON, text, and the verdict with the most useful next step."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from ..errors import CalibrationError, minus
from ..model.alignment import CalibrationRecord, ClickedPair, ModelSummary, SnapshotRecord
from ..model.arrays import Float64Array
from ..model.files import json_fields
from ..model.frames import Rig
from ..preset import AlignmentSection, HomographyAlignment, Preset, RigidAlignment, now
from .agreement import Agreement
from .correspondences import Correspondence, listed
from .depth_advice import DepthAdvice
from .distortion import DistortionAdvice
from .homography import HomographyFit
from .quality import Coverage, PatchEffect, UncertaintyMap
from .rigid import DepthFit, RigidFit

ModelName = Literal["homography", "rigid"]
#: Expected alignment error over the membrane, pixels, up to which a calibration is good, and usable.
GOOD_PX, USABLE_PX = 0.6, 1.5
#: The same for the contact patch's boundary, millimetres: a homography may fit its pairs and be wrong at other depths.
GOOD_MM, USABLE_MM = 5.0, 20.0
#: Number of points from which the quality can be judged.
ADVISED_POINTS = 6
#: Depth that the points of a rigid alignment should span, millimetres.
ADVISED_SPAN_MM = 20.0
_FAR_PX = 80.0
_SUSPICIOUS = 3.0
#: Smallest residual for which a pair is to be clicked again, pixels.
_CLICK_AGAIN_PX = 1.0


@dataclass(frozen=True)
class PairQuality:
    """One correspondence under a fit.

    Attributes
    ----------
    id : str
    used : bool
        False for an outlier that the fit leaves out.
    residual_u, residual_v : float
        Clicked minus predicted proximity pixel: dX and dY.
    residual_px, residual_mm : float
        Length of the residual in pixels, and in millimetres across the line of sight (nan without depth).
    left_out_px : float
        Residual under the fit of the other correspondences (cross-validation); nan if they determine no model.
    tactile_depth_m : float
        nan without depth.
    """

    id: str
    used: bool
    residual_u: float
    residual_v: float
    residual_px: float
    residual_mm: float
    left_out_px: float
    tactile_depth_m: float


@dataclass(frozen=True, eq=False)
class ModelQuality:
    """Quality of one model's fit.

    Attributes
    ----------
    model : {"homography", "rigid"}
    rms_px, rms_mm, worst_px : float or None
        Residuals of the correspondences used; None if the model fits exactly for lack of surplus ones.
    worst_id : str or None
    agreement : Agreement
        Of the regions of the image and of depth.
    click_noise_px : float or None
        Click noise estimated from the residuals, including model error.
    degrees : int
        Degrees of freedom.
    condition : float
        Condition number of the scaled design.
    alignment_px, alignment_mm : float
        Expected root mean square alignment error over the membrane, from the click noise and smooth errors.
    alignment_bound_95_px : float
        95 % bound of the root mean square alignment error.
    effect : PatchEffect
    excluded, doubtful : tuple of str
        Ids of outliers, and of pairs that may be some.
    pairs : tuple of PairQuality
    map : UncertaintyMap
    """

    model: ModelName
    rms_px: float | None
    rms_mm: float | None
    worst_px: float | None
    worst_id: str | None
    agreement: Agreement
    click_noise_px: float | None
    degrees: int
    condition: float
    alignment_px: float
    alignment_mm: float
    alignment_bound_95_px: float
    effect: PatchEffect
    excluded: tuple[str, ...]
    doubtful: tuple[str, ...]
    pairs: tuple[PairQuality, ...]
    map: UncertaintyMap

    @property
    def cross_validated_px(self) -> float | None:
        """Root mean square residual of regions under the fit of the other correspondences."""
        return self.agreement.cross_validated_px

    @property
    def summary(self) -> dict[str, Any]:
        """The numbers that a preset keeps, as JSON values."""
        return {
            "rms_px": self.rms_px,
            "cross_validated_px": self.cross_validated_px,
            "alignment_px": self.alignment_px,
            "alignment_bound_95_px": self.alignment_bound_95_px,
            "boundary_error_mm": self.effect.boundary_mm,
            "supported_tolerance": self.effect.supported_tolerance,
            "excluded": list(self.excluded),
        }

    def to_json(self) -> dict[str, Any]:
        """Return JSON values without the map; missing numbers are None."""
        return self.summary | {
            "rms_mm": self.rms_mm,
            "worst_px": self.worst_px,
            "worst_id": self.worst_id,
            "agreement": self.agreement.to_json(),
            "click_noise_px": self.click_noise_px,
            "degrees_of_freedom": self.degrees,
            "condition_number": self.condition,
            "alignment_mm": self.alignment_mm,
            "depth_difference_mm": self.effect.depth_mm,
            "doubtful": list(self.doubtful),
            "pairs": [json_fields(vars(pair)) for pair in self.pairs],
        }


@dataclass(frozen=True, eq=False)
class CalibrationReport:
    """Fits of both models, the recommendation and the next step.

    Attributes
    ----------
    model : {"homography", "rigid"}
        The model asked for, or with ``"auto"`` the recommended one.
    recommended : {"homography", "rigid"}
    reason : str
        Reason of the recommendation.
    homography, rigid : fits, or None if refused
    quality : mapping of model name to ModelQuality
    refused : mapping of model name to the reason why it was not fitted
    coverage : Coverage
    verdict : str
        Grade and next step, in words.
    depth_fit : {"none", "offset", "scale", "both"}
        The correction of the tactile depth that the rigid fit contains.
    depth_advice : DepthAdvice
        The correction that is recommended, and why.
    distortion : DistortionAdvice
        Lens distortion that the pairs show and the rig does not state; its rig is ``rig`` if it is used.
    warnings : tuple of str
    pairs : tuple of Correspondence
        All given correspondences, including disabled ones.
    rig : Rig
    date : datetime
    """

    model: ModelName
    recommended: ModelName
    reason: str
    homography: HomographyFit | None
    rigid: RigidFit | None
    quality: Mapping[str, ModelQuality]
    refused: Mapping[str, str]
    coverage: Coverage
    verdict: str
    depth_fit: DepthFit
    depth_advice: DepthAdvice
    distortion: DistortionAdvice
    warnings: tuple[str, ...]
    pairs: tuple[Correspondence, ...]
    rig: Rig
    date: datetime

    @property
    def chosen(self) -> ModelQuality:
        """The quality of ``model``."""
        return self.quality[self.model]

    @property
    def distortion_used(self) -> bool:
        """Whether the fits contain the estimated lens distortion."""
        return self.rig is self.distortion.rig

    def to_json(self) -> dict[str, Any]:
        """Return the whole report as JSON values."""
        chosen, rigid = self.chosen, self.rigid
        return {
            "model": self.model,
            "recommended": self.recommended,
            "reason": self.reason,
            "homography": None if self.homography is None else self.homography.H_p_t.tolist(),
            "T_proximity_tactile": None if rigid is None else rigid.T_proximity_tactile.tolist(),
            "depth_fit": self.depth_fit,
            "depth_advice": vars(self.depth_advice),
            "distortion": {
                "found": self.distortion.found,
                "used": self.distortion_used,
                "sentence": self.distortion.sentence,
                "k1": {name: list(values) for name, values in self.distortion.k1.items()},
            },
            "depth_scale": None if rigid is None else rigid.pose.scale,
            "depth_offset_m": None if rigid is None else rigid.pose.offset_m,
            "pose_uncertainty": None if rigid is None else _pose_uncertainty(rigid),
            **chosen.summary,
            "verdict": self.verdict,
            "warnings": list(self.warnings),
            "points": len(chosen.pairs),
            "coverage": {
                "cells": [list(row) for row in self.coverage.cells],
                "share": self.coverage.share,
                "depth_range_m": None if self.coverage.depth_range_m is None else list(self.coverage.depth_range_m),
            },
            "models": {name: quality.to_json() for name, quality in self.quality.items()},
            "refused": dict(self.refused),
            "date": self.date.isoformat(),
        }

    def record(self, snapshots: tuple[SnapshotRecord, ...] = ()) -> CalibrationRecord:
        """Return the record of this calibration for a preset."""
        return CalibrationRecord(
            date=self.date,
            model=self.model,
            proximity_serial=self.rig.proximity.serial,
            tactile_serial=self.rig.tactile.serial,
            verdict=self.verdict,
            points=tuple(ClickedPair(**vars(pair)) for pair in self.pairs),
            snapshots=snapshots,
            quality=ModelSummary(**self.chosen.summary),
        )

    def apply_to(
        self, preset: Preset, *, snapshots: tuple[SnapshotRecord, ...] = (), set_tolerance: bool = False
    ) -> Preset:
        """Return the preset with this alignment, its record and its rig.

        Parameters
        ----------
        set_tolerance : bool
            Also set ``tolerance.t`` to the smallest value that the calibration supports.

        Raises
        ------
        CalibrationError
            A fitted value is outside the preset's limits, such as a depth scale of 1.4.
        """
        section = preset.alignment.model_copy(update={"model": self.model, "calibration": self.record(snapshots)})
        if self.homography is not None:
            matrix: Any = tuple(tuple(row) for row in self.homography.H_p_t.tolist())
            section = section.model_copy(
                update={
                    "homography": HomographyAlignment(
                        H_p_t=matrix, plane_distance_m=preset.alignment.homography.plane_distance_m
                    )
                }
            )
        if self.rigid is not None:
            pose: Any = self.rigid.T_proximity_tactile
            section = section.model_copy(
                update={
                    "rigid": RigidAlignment(T_proximity_tactile=pose),
                    "depth_scale": float(self.rigid.pose.scale),
                    "depth_offset_m": float(self.rigid.pose.offset_m),
                }
            )
        tolerance = preset.tolerance
        if set_tolerance:
            tolerance = tolerance.model_copy(update={"t": round(min(self.chosen.effect.supported_tolerance, 1.0), 4)})
        try:
            section = AlignmentSection.model_validate(section.model_dump())
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            raise CalibrationError(
                f"the fit does not make a preset: {'.'.join(map(str, first['loc']))} is {first['input']!r} "
                f"({first['msg']}); check the pairs and their tactile depths"
            ) from error
        return preset.model_copy(
            update={"alignment": section, "tolerance": tolerance, "rig": self.rig, "modified": now()}
        )

    def words(self) -> str:
        """Return the whole report as text."""
        lines = [f"Model: {self.model}. {self.reason}", self.depth_advice.reason]
        if self.distortion_used:  # otherwise the verdict says it
            lines.append(self.distortion.result)
        lines += ["", _table(self)]
        chosen = self.chosen
        lines += [f"Not fitted, {name}: {reason}" for name, reason in self.refused.items()]
        if self.rigid is not None:
            lines.append(_pose_words(self.rigid))
        low_high = self.coverage.depth_range_m
        depth = f"; depth {1e3 * low_high[0]:.0f} to {1e3 * low_high[1]:.0f} mm" if low_high else "; no depths"
        cells = " / ".join(" ".join(str(count) for count in row) for row in self.coverage.cells)
        lines.append(f"Points per cell of the image: {cells}{depth}")
        lines.append(f"Pairs under the {self.model} model (px: dX, dY, length, cross-validated; mm):")
        for pair in chosen.pairs:
            mark = "" if pair.used else "  rejected: the others contradict it"
            lines.append(
                f"  {pair.id:>6}  {pair.residual_u:8.2f} {pair.residual_v:8.2f} {pair.residual_px:8.2f} "
                f"{shown(pair.left_out_px, 8)}  {shown(pair.residual_mm, 7)}{mark}"
            )
        lines += [f"Warning: {warning}" for warning in self.warnings]
        return "\n".join([*lines, "", f"Verdict: {self.verdict}"])


#: Title, unit and value of the numbers that both models are compared by.
NUMBERS: tuple[tuple[str, str, Callable[[ModelQuality], float | None]], ...] = (
    ("residual, RMS", "px", lambda q: q.rms_px),
    ("worst residual", "px", lambda q: q.worst_px),
    ("cross-validated residual", "px", lambda q: q.cross_validated_px),
    ("expected alignment error", "px", lambda q: q.alignment_px),
    ("  its 95 % bound", "px", lambda q: q.alignment_bound_95_px),
    ("expected alignment error", "mm", lambda q: q.alignment_mm),
    ("patch boundary error", "mm", lambda q: q.effect.boundary_mm),
    ("supported tolerance t", "", lambda q: q.effect.supported_tolerance),
    ("condition number", "", lambda q: q.condition),
)


def _table(report: CalibrationReport) -> str:
    names = list(report.quality)
    lines = ["".join([f"{'':32}", *(f"{name:>12}" for name in names)])]
    for title, unit, value in NUMBERS:
        cells = [shown(value(report.quality[name]), 12, 4 if not unit else 2) for name in names]
        lines.append("".join([f"{title + (f' ({unit})' if unit else ''):32}", *cells]))
    return "\n".join(lines)


def _pose_words(rigid: RigidFit) -> str:
    sigma = _pose_uncertainty(rigid)
    text = f"Pose: uncertain by {sigma['translation_mm']:.2f} mm and {sigma['rotation_deg']:.3f} degrees (one sigma)"
    if sigma["scale"] is not None:
        text += f"; tactile depth x {rigid.pose.scale:.4f} ± {sigma['scale']:.4f}"
    if sigma["offset_mm"] is not None:
        text += f"; tactile depth {minus(f'{1e3 * rigid.pose.offset_m:+.2f}')} mm ± {sigma['offset_mm']:.2f} mm"
    return text


def _pose_uncertainty(rigid: RigidFit) -> dict[str, float | None]:
    (turn_rad, shift_m), (scale, offset_m) = rigid.pose_sigma, rigid.depth_sigma
    return {
        "rotation_deg": math.degrees(turn_rad),
        "translation_mm": 1e3 * shift_m,
        "scale": scale,
        "offset_mm": None if offset_m is None else 1e3 * offset_m,
    }


def shown(value: float | None, width: int, decimals: int = 2) -> str:
    """Format a number to a width in characters; a dash for an unknown one."""
    return f"{'-':>{width}}" if value is None or math.isnan(value) else f"{value:{width}.{decimals}f}"


def verdict(quality: ModelQuality, coverage: Coverage, proximity: Float64Array, rig: Rig) -> str:
    """Return the grade of a fit and the next step.

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


def distortion_verdict(quality: ModelQuality, distortion: DistortionAdvice) -> str:
    """Return the grade of a fit to pairs that show lens distortion, and the offer to estimate it."""
    return f"{grade(quality)} {distortion.sentence}"


def grade(quality: ModelQuality) -> str:
    """Return the grade of a fit, and what disagrees, in one sentence each."""
    if quality.degrees <= 0:
        used = sum(pair.used for pair in quality.pairs)
        return f"Unknown: a {quality.model} fits any {used} pairs, so their residuals mean nothing."
    effect = quality.effect
    good = quality.alignment_px <= GOOD_PX and effect.boundary_mm <= GOOD_MM and not quality.agreement.sloppy
    usable = quality.alignment_px <= USABLE_PX and effect.boundary_mm <= USABLE_MM
    word = "Good" if good else "Usable" if usable else "Poor"
    numbers = (
        f"{word}: expected alignment error {quality.alignment_px:.2f} px ({quality.alignment_mm:.2f} mm), with 95 % "
        f"certainty below {quality.alignment_bound_95_px:.2f} px; patch boundary off by "
        f"{effect.boundary_mm:.2f} mm; the tolerance test needs t = {100 * effect.supported_tolerance:.2f} % or more."
    )
    return f"{numbers} {quality.agreement.words()}".strip()


def next_step(quality: ModelQuality, coverage: Coverage, proximity: Float64Array, rig: Rig) -> str:
    """Return the step that improves the calibration most, one sentence."""
    used = len(proximity)
    if quality.excluded:
        worst = max((pair for pair in quality.pairs if not pair.used), key=lambda pair: pair.residual_px)
        them = "them" if len(quality.excluded) > 1 else "it"
        return (
            f"Click {listed(quality.excluded)} again or delete {them}: rejected, because the others contradict {them} "
            f"(pair {worst.id} by {worst.residual_px:.0f} px){_or_doubtful(quality)}."
        )
    if quality.doubtful:
        who = "one of them" if len(quality.doubtful) > 1 else "it"
        return f"Click {listed(quality.doubtful)} again: {who} may be wrong, and the others do not decide."
    missing = ADVISED_POINTS - used
    if missing > 0:
        return f"Click at least {missing} more: with six the quality can be estimated."
    found = (
        quality.agreement.next_step()
        or _large_residuals(quality)
        or _weakest_place(quality, proximity, rig)
        or _shallow_points(quality, coverage)
        or _wrong_off_its_plane(quality)
        or _suspicious_pair(quality)
    )
    if found:
        return found
    if quality.alignment_px > GOOD_PX:
        wanted = int(np.ceil(used * (quality.alignment_px / GOOD_PX) ** 2))
        return f"Add points to lower the error; about {min(wanted, 60)} in all, clicked with the same care."
    return "Check it on the live image and save it; nothing more is needed."


def _or_doubtful(quality: ModelQuality) -> str:
    return f"; if that is right, look at {listed(quality.doubtful)}" if quality.doubtful else ""


def _large_residuals(quality: ModelQuality) -> str:
    """Return advice on pairs whose residual is much larger than the median: their clicks, not their places, are bad."""
    bad, usual = _far_from_fit(quality)
    if not bad:
        return ""
    errors = " and ".join(f"{pair.residual_px:.1f}" for pair in bad[:3])
    return (
        f"Click {listed([pair.id for pair in bad[:3]])} again: {errors} px from the fit, half of all pairs are within "
        f"{usual:.1f} px."
    )


def _far_from_fit(quality: ModelQuality) -> tuple[list[PairQuality], float]:
    """Return the pairs to click again, the worst first, and the median residual, pixels."""
    kept = sorted((pair for pair in quality.pairs if pair.used), key=lambda pair: -pair.residual_px)
    if quality.degrees <= 0:
        return [], 0.0
    usual = float(np.median([pair.residual_px for pair in kept]))
    return [pair for pair in kept if pair.residual_px > max(_SUSPICIOUS * usual, _CLICK_AGAIN_PX)], usual


def standing_out(quality: ModelQuality) -> frozenset[str]:
    """Return the ids of the pairs to look at: rejected, doubtful, or far from the fit, not merely the worst."""
    return frozenset({*quality.excluded, *quality.doubtful, *(pair.id for pair in _far_from_fit(quality)[0])})


def _weakest_place(quality: ModelQuality, proximity: Float64Array, rig: Rig) -> str:
    """Return advice on the most uncertain place, if it is far from all points, above `GOOD_PX` and above the median."""
    uncertainty = quality.map
    gaps = np.hypot(*(uncertainty.proximity[:, None] - proximity[None]).transpose(2, 0, 1)).min(axis=1)
    far = gaps > _FAR_PX
    if not far.any():
        return ""
    worst = int(np.argmax(np.where(far, uncertainty.sigma_px, -1.0)))
    if uncertainty.sigma_px[worst] < max(1.3 * np.median(uncertainty.sigma_px), GOOD_PX):
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
        f"{ADVISED_SPAN_MM:.0f} mm or more determine the pose well."
    )


def _wrong_off_its_plane(quality: ModelQuality) -> str:
    if quality.model != "homography" or quality.effect.boundary_mm <= GOOD_MM:
        return ""
    return "Check the tactile depths and take the rigid model: off its plane this homography is wrong."


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
    """Return the region of an image (height, width) with a pixel, such as ``"at the upper left"``."""
    row = ("upper", "middle", "lower")[int(np.clip(3 * pixel[1] / shape[0], 0, 2))]
    column = ("left", "middle", "right")[int(np.clip(3 * pixel[0] / shape[1], 0, 2))]
    if row == column == "middle":
        return "in the middle"
    if row == "middle":
        return f"at the {column}"
    return f"at the {row} {column}"
