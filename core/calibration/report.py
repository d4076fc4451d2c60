"""Result of a calibration: data, JSON, text, and the verdict with the most useful next step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

import numpy as np

from ..errors import minus
from ..model.alignment import CalibrationRecord, ModelSummary, PointPair, SnapshotRecord
from ..model.files import json_fields
from ..model.frames import Rig
from ..preset import HomographyAlignment, Preset, RigidAlignment, now
from .agreement import Agreement
from .fits import Fit
from .points import listed
from .quality import Coverage, PatchEffect

ModelName = Literal["homography", "rigid"]
#: Expected alignment error over the membrane, pixels, up to which a calibration is good, and usable.
GOOD_PX, USABLE_PX = 0.6, 1.5
#: The same for the contact patch's boundary, millimetres: a homography may fit its pairs and be wrong at other depths.
GOOD_MM, USABLE_MM = 5.0, 20.0
#: Number of points from which the quality can be judged.
ADVISED_POINTS = 6
#: Depth that the points of a rigid alignment should span, millimetres.
ADVISED_SPAN_MM = 20.0
#: A pair stands out if its residual exceeds this multiple of the median residual, and this many pixels.
_SUSPICIOUS, _CLICK_AGAIN_PX = 3.0, 1.0


@dataclass(frozen=True)
class PairQuality:
    """One pair under a fit: clicked minus predicted proximity pixel, and that across the line of sight (mm, or nan)."""

    id: str
    used: bool = True
    dx: float = math.nan
    dy: float = math.nan
    residual_mm: float = math.nan

    @property
    def residual_px(self) -> float:
        """Length of the residual, pixels."""
        return math.hypot(self.dx, self.dy)


@dataclass(frozen=True, eq=False)
class ModelQuality:
    """Quality of one model's fit; ``rms_px`` is None where no pair is surplus, the error is that over the membrane."""

    model: ModelName
    fit: Fit
    agreement: Agreement
    rms_px: float | None
    alignment_px: float
    alignment_mm: float
    alignment_bound_95_px: float
    effect: PatchEffect
    pairs: tuple[PairQuality, ...]

    @property
    def excluded(self) -> tuple[str, ...]:
        """Ids of the outliers."""
        return tuple(pair.id for pair in self.pairs if not pair.used)

    def far_from_fit(self) -> list[PairQuality]:
        """Return the used pairs with a much larger residual than the median, the worst first."""
        kept = sorted((pair for pair in self.pairs if pair.used), key=lambda pair: -pair.residual_px)
        usual = float(np.median([pair.residual_px for pair in kept]))
        limit = max(_SUSPICIOUS * usual, _CLICK_AGAIN_PX)
        return [pair for pair in kept if self.fit.degrees > 0 and pair.residual_px > limit]

    @property
    def standing_out(self) -> frozenset[str]:
        """Ids of the pairs to look at: rejected, or far from the fit, not merely the worst."""
        return frozenset({*self.excluded, *(pair.id for pair in self.far_from_fit())})

    @property
    def summary(self) -> dict[str, Any]:
        """The numbers that a preset keeps, as JSON values; missing ones are None."""
        return {
            "rms_px": self.rms_px,
            "cross_validated_px": self.agreement.cross_validated_px,
            "alignment_px": self.alignment_px,
            "alignment_bound_95_px": self.alignment_bound_95_px,
            "boundary_error_mm": self.effect.boundary_mm,
            "supported_tolerance": self.effect.supported_tolerance,
            "excluded": list(self.excluded),
        }


@dataclass(frozen=True)
class DepthOffset:
    """An offset of the tactile depth fitted to the pairs, metres, with its standard deviation; whether it is used."""

    offset_m: float
    sigma_m: float
    used: bool

    def words(self) -> str:
        size = minus(f"{1e3 * self.offset_m:+z.2f} ± {1e3 * self.sigma_m:.2f} mm")
        return f"Offset of the tactile depth: {size}, {'corrected' if self.used else 'not corrected'}."


@dataclass(frozen=True, eq=False)
class CalibrationReport:
    """Fits of both models, the recommendation and the next step.

    ``model`` is the model asked for, or with ``"auto"`` the recommended one, for which ``reason`` says why. ``refused``
    says why a model was not fitted. ``depth_offset`` is None if the pairs do not determine one. ``pairs`` are all given
    ones, including disabled ones.
    """

    model: ModelName
    recommended: ModelName
    reason: str
    quality: Mapping[ModelName, ModelQuality]
    refused: Mapping[ModelName, str]
    coverage: Coverage
    depth_offset: DepthOffset | None
    warnings: tuple[str, ...]
    pairs: tuple[PointPair, ...]
    rig: Rig
    date: datetime

    @property
    def chosen(self) -> ModelQuality:
        return self.quality[self.model]

    @property
    def homography(self) -> Fit | None:
        return self.quality["homography"].fit if "homography" in self.quality else None

    @property
    def rigid(self) -> Fit | None:
        return self.quality["rigid"].fit if "rigid" in self.quality else None

    @property
    def verdict(self) -> str:
        """Grade and next step, in words."""
        return f"{grade(self.chosen)} {next_step(self.chosen, self.coverage)}"

    def to_json(self) -> dict[str, Any]:
        aligned = self.chosen.fit.alignment
        return {
            "model": self.model,
            "recommended": self.recommended,
            "reason": self.reason,
            "homography": None if aligned.homography is None else aligned.homography.tolist(),
            "T_proximity_tactile": None if aligned.pose is None else aligned.pose.tolist(),
            "depth_offset_m": aligned.offset_m,
            **self.chosen.summary,
            "alignment_mm": self.chosen.alignment_mm,
            "verdict": self.verdict,
            "warnings": list(self.warnings),
            "pairs": [json_fields(vars(pair) | {"residual_px": pair.residual_px}) for pair in self.chosen.pairs],
            "refused": dict(self.refused),
            "date": self.date.isoformat(),
        }

    def apply_to(self, preset: Preset, *, snapshots: tuple[SnapshotRecord, ...] = ()) -> Preset:
        """Return the preset with this alignment, its record and its rig."""
        record = CalibrationRecord(
            date=self.date,
            model=self.model,
            proximity_serial=self.rig.proximity.serial,
            tactile_serial=self.rig.tactile.serial,
            verdict=self.verdict,
            points=self.pairs,
            snapshots=snapshots,
            quality=ModelSummary(**self.chosen.summary),
        )
        values: dict[str, Any] = {"model": self.model, "calibration": record}
        if self.homography is not None:
            H: Any = self.homography.alignment.homography
            distance_m = preset.alignment.homography.plane_distance_m
            values["homography"] = HomographyAlignment(H_p_t=H.tolist(), plane_distance_m=distance_m)
        if self.rigid is not None:
            pose: Any = self.rigid.alignment.pose
            values["rigid"] = RigidAlignment(T_proximity_tactile=pose)
            values |= {"depth_scale": 1.0, "depth_offset_m": self.rigid.alignment.offset_m}
        section = preset.alignment.model_copy(update=values)
        return preset.model_copy(update={"alignment": section, "rig": self.rig, "verdict": None, "modified": now()})

    def words(self) -> str:
        lines = [f"Model: {self.model}. {self.reason}"]
        if self.depth_offset is not None:
            lines.append(self.depth_offset.words())
        lines += [
            f"Residual of the {name} model: {quality.rms_px:.2f} px RMS; expected alignment error "
            f"{quality.alignment_px:.2f} px"
            for name, quality in self.quality.items()
            if quality.rms_px is not None
        ]
        lines += [f"Not fitted, {name}: {reason}" for name, reason in self.refused.items()]
        lines.append(f"Pairs under the {self.model} model (px: dX, dY, length; mm):")
        lines += [
            f"  {pair.id:>6}  {pair.dx:8.2f} {pair.dy:8.2f} {pair.residual_px:8.2f}  {pair.residual_mm:7.2f}"
            f"{'' if pair.used else '  rejected: the others contradict it'}"
            for pair in self.chosen.pairs
        ]
        lines += [f"Warning: {warning}" for warning in self.warnings]
        return "\n".join([*lines, "", f"Verdict: {self.verdict}"])


def grade(quality: ModelQuality) -> str:
    """Return the grade of a fit with its numbers, one sentence."""
    if quality.fit.degrees <= 0:
        used = sum(pair.used for pair in quality.pairs)
        return f"Unknown: a {quality.model} fits any {used} pairs, so their residuals mean nothing."
    effect = quality.effect
    good = quality.alignment_px <= GOOD_PX and effect.boundary_mm <= GOOD_MM
    usable = quality.alignment_px <= USABLE_PX and effect.boundary_mm <= USABLE_MM
    word = "Good" if good else "Usable" if usable else "Poor"
    return (
        f"{word}: expected alignment error {quality.alignment_px:.2f} px ({quality.alignment_mm:.2f} mm), with 95 % "
        f"certainty below {quality.alignment_bound_95_px:.2f} px; patch boundary off by "
        f"{effect.boundary_mm:.2f} mm; the tolerance test needs t = {100 * effect.supported_tolerance:.2f} % or more."
    )


def next_step(quality: ModelQuality, coverage: Coverage) -> str:
    """Return the step that improves the calibration most, one sentence."""
    used, shared = sum(pair.used for pair in quality.pairs), quality.agreement.found
    wrong = quality.excluded or [pair.id for pair in ([] if shared else quality.far_from_fit()[:3])]
    if wrong:
        them, far = "them" if len(wrong) > 1 else "it", max(p.residual_px for p in quality.pairs if p.id in wrong)
        return f"Click {listed(wrong)} again or delete {them}: the others contradict {them} by up to {far:.1f} px."
    if used < ADVISED_POINTS:
        return f"Click at least {ADVISED_POINTS - used} more: with six the quality can be estimated."
    if shared:
        return quality.agreement.next_step()
    if quality.model == "rigid" and coverage.depth_span_mm < ADVISED_SPAN_MM:
        return (
            f"Add points at another inflation level: all lie within {coverage.depth_span_mm:.0f} mm of depth, "
            f"{ADVISED_SPAN_MM:.0f} mm or more determine the pose well."
        )
    if quality.model == "homography" and quality.effect.boundary_mm > GOOD_MM:
        step = "Check the tactile depths and take the rigid model: off its plane this homography is wrong."
    elif quality.alignment_px > GOOD_PX:
        wanted = min(int(np.ceil(used * (quality.alignment_px / GOOD_PX) ** 2)), 60)
        step = f"Add points where there are few, about {wanted} in all, clicked with the same care."
    else:
        step = "Check it on the live image and save it; nothing more is needed."
    return step
