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
from ..model.alignment import CalibrationRecord, ModelSummary, PointPair, SnapshotRecord
from ..model.files import json_fields
from ..model.frames import Rig
from ..preset import AlignmentSection, HomographyAlignment, Preset, RigidAlignment, now
from .agreement import Agreement
from .fits import Fit
from .points import listed
from .quality import Coverage, PatchEffect, UncertaintyMap

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
    """One pair under a fit; False in ``used`` marks an outlier.

    ``dx`` and ``dy`` are clicked minus predicted proximity pixel, ``residual_mm`` is across the line of sight (nan
    without depth), ``left_out_px`` is the residual under the fit of the other pairs (nan if they determine no model).
    """

    id: str
    used: bool = True
    dx: float = math.nan
    dy: float = math.nan
    residual_mm: float = math.nan
    left_out_px: float = math.nan

    @property
    def residual_px(self) -> float:
        """Length of the residual, pixels."""
        return math.hypot(self.dx, self.dy)


@dataclass(frozen=True, eq=False)
class ModelQuality:
    """Quality of one model's fit.

    ``rms_px`` is the RMS residual of the used pairs, None if the model fits exactly for lack of surplus ones. The
    alignment error is that over the membrane, root mean square, from the click noise and smooth errors.
    """

    model: ModelName
    fit: Fit
    agreement: Agreement
    rms_px: float | None
    alignment_px: float
    alignment_mm: float
    alignment_bound_95_px: float
    effect: PatchEffect
    pairs: tuple[PairQuality, ...]
    map: UncertaintyMap

    @property
    def degrees(self) -> int:
        """Degrees of freedom of the fit."""
        return self.fit.degrees

    @property
    def cross_validated_px(self) -> float | None:
        """Root mean square residual of regions under the fit of the other pairs."""
        return self.agreement.cross_validated_px

    @property
    def excluded(self) -> tuple[str, ...]:
        """Ids of the outliers."""
        return tuple(pair.id for pair in self.pairs if not pair.used)

    @property
    def worst(self) -> PairQuality:
        """The used pair with the largest residual."""
        return max((pair for pair in self.pairs if pair.used), key=lambda pair: pair.residual_px)

    def far_from_fit(self) -> list[PairQuality]:
        """Return the used pairs with a much larger residual than the median, the worst first."""
        kept = sorted((pair for pair in self.pairs if pair.used), key=lambda pair: -pair.residual_px)
        usual = float(np.median([pair.residual_px for pair in kept]))
        limit = max(_SUSPICIOUS * usual, _CLICK_AGAIN_PX)
        return [pair for pair in kept if self.degrees > 0 and pair.residual_px > limit]

    @property
    def standing_out(self) -> frozenset[str]:
        """Ids of the pairs to look at: rejected, or far from the fit, not merely the worst."""
        return frozenset({*self.excluded, *(pair.id for pair in self.far_from_fit())})

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
            "smooth_error_probability": self.agreement.probability,
            "smooth_error": self.agreement.cause,
            "degrees_of_freedom": self.degrees,
            "condition_number": self.fit.condition,
            "alignment_mm": self.alignment_mm,
            "depth_difference_mm": self.effect.depth_mm,
            "pairs": [json_fields(vars(pair) | {"residual_px": pair.residual_px}) for pair in self.pairs],
        }


@dataclass(frozen=True)
class DepthOffset:
    """An offset of the tactile depth fitted to the pairs, metres, with its standard deviation; whether it is used."""

    offset_m: float
    sigma_m: float
    used: bool

    def words(self) -> str:
        """Return it in one sentence."""
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
        """The quality of ``model``."""
        return self.quality[self.model]

    @property
    def homography(self) -> Fit | None:
        """The fitted homography."""
        return self.quality["homography"].fit if "homography" in self.quality else None

    @property
    def rigid(self) -> Fit | None:
        """The fitted pose."""
        return self.quality["rigid"].fit if "rigid" in self.quality else None

    @property
    def verdict(self) -> str:
        """Grade and next step, in words."""
        return f"{grade(self.chosen)} {next_step(self.chosen, self.coverage)}"

    def to_json(self) -> dict[str, Any]:
        """Return the whole report as JSON values."""
        homography, rigid, offset = self.homography, self.rigid, self.depth_offset
        H: Any = None if homography is None else homography.alignment.homography
        pose: Any = None if rigid is None else rigid.alignment.pose
        return {
            "model": self.model,
            "recommended": self.recommended,
            "reason": self.reason,
            "homography": None if H is None else H.tolist(),
            "T_proximity_tactile": None if pose is None else pose.tolist(),
            "depth_offset_m": None if rigid is None else rigid.alignment.offset_m,
            "fitted_offset": None if offset is None else vars(offset),
            "pose_uncertainty": None if rigid is None else _pose_uncertainty(rigid),
            **self.chosen.summary,
            "verdict": self.verdict,
            "warnings": list(self.warnings),
            "points": len(self.chosen.pairs),
            "coverage": {"cells": self.coverage.cells, "depth_range_m": self.coverage.depth_range_m},
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
            points=self.pairs,
            snapshots=snapshots,
            quality=ModelSummary(**self.chosen.summary),
        )

    def apply_to(
        self, preset: Preset, *, snapshots: tuple[SnapshotRecord, ...] = (), set_tolerance: bool = False
    ) -> Preset:
        """Return the preset with this alignment, its record and its rig.

        Raises
        ------
        CalibrationError
            A fitted value is outside the preset's limits, such as an offset of 0.2 m.
        """
        values: dict[str, Any] = {"model": self.model, "calibration": self.record(snapshots)}
        section = preset.alignment
        try:
            if self.homography is not None:
                H: Any = self.homography.alignment.homography
                values["homography"] = HomographyAlignment(
                    H_p_t=H.tolist(), plane_distance_m=section.homography.plane_distance_m
                )
            if self.rigid is not None:
                pose: Any = self.rigid.alignment.pose
                values["rigid"] = RigidAlignment(T_proximity_tactile=pose)
                values |= {"depth_scale": 1.0, "depth_offset_m": self.rigid.alignment.offset_m}
            section = AlignmentSection.model_validate(section.model_copy(update=values).model_dump())
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            raise CalibrationError(
                f"the fit does not make a preset: {'.'.join(map(str, first['loc']))} is {first['input']!r} "
                f"({first['msg']}); check the pairs and their tactile depths"
            ) from error
        tolerance = preset.tolerance
        if set_tolerance:
            tolerance = tolerance.model_copy(update={"t": round(min(self.chosen.effect.supported_tolerance, 1.0), 4)})
        return preset.model_copy(
            update={"alignment": section, "tolerance": tolerance, "rig": self.rig, "modified": now()}
        )

    def words(self) -> str:
        """Return the whole report as text."""
        lines = [f"Model: {self.model}. {self.reason}"]
        if self.depth_offset is not None:
            lines.append(self.depth_offset.words())
        lines += ["", *_table(self.quality)]
        lines += [f"Not fitted, {name}: {reason}" for name, reason in self.refused.items()]
        if self.rigid is not None:
            sigma = _pose_uncertainty(self.rigid)
            size = f"{sigma['translation_mm']:.2f} mm and {sigma['rotation_deg']:.3f} degrees"
            lines.append(f"Pose: uncertain by {size} (one sigma)")
        low_high = self.coverage.depth_range_m
        depth = f"; depth {1e3 * low_high[0]:.0f} to {1e3 * low_high[1]:.0f} mm" if low_high else "; no depths"
        cells = " / ".join(" ".join(str(count) for count in row) for row in self.coverage.cells)
        lines.append(f"Points per cell of the image: {cells}{depth}")
        lines.append(f"Pairs under the {self.model} model (px: dX, dY, length, cross-validated; mm):")
        lines += [
            f"  {pair.id:>6}  {pair.dx:8.2f} {pair.dy:8.2f} {pair.residual_px:8.2f} {_shown(pair.left_out_px, 8)}  "
            f"{_shown(pair.residual_mm, 7)}{'' if pair.used else '  rejected: the others contradict it'}"
            for pair in self.chosen.pairs
        ]
        lines += [f"Warning: {warning}" for warning in self.warnings]
        return "\n".join([*lines, "", f"Verdict: {self.verdict}"])


_NUMBERS: tuple[tuple[str, str, Callable[[ModelQuality], float | None]], ...] = (
    ("residual, RMS", "px", lambda q: q.rms_px),
    ("worst residual", "px", lambda q: None if q.rms_px is None else q.worst.residual_px),
    ("cross-validated residual", "px", lambda q: q.cross_validated_px),
    ("expected alignment error", "px", lambda q: q.alignment_px),
    ("  its 95 % bound", "px", lambda q: q.alignment_bound_95_px),
    ("expected alignment error", "mm", lambda q: q.alignment_mm),
    ("patch boundary error", "mm", lambda q: q.effect.boundary_mm),
    ("supported tolerance t", "", lambda q: q.effect.supported_tolerance),
    ("condition number", "", lambda q: q.fit.condition),
)


def _table(quality: Mapping[ModelName, ModelQuality]) -> list[str]:
    lines = ["".join([f"{'':32}", *(f"{name:>12}" for name in quality)])]
    for title, unit, value in _NUMBERS:
        cells = [_shown(value(one), 12, 2 if unit else 4) for one in quality.values()]
        lines.append("".join([f"{title + (f' ({unit})' if unit else ''):32}", *cells]))
    return lines


def _pose_uncertainty(rigid: Fit) -> dict[str, float]:
    turn_rad, shift_m = rigid.pose_sigma
    return {"rotation_deg": math.degrees(turn_rad), "translation_mm": 1e3 * shift_m}


def _shown(value: float | None, width: int, decimals: int = 2) -> str:
    return f"{'-':>{width}}" if value is None or math.isnan(value) else f"{value:{width}.{decimals}f}"


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


def next_step(quality: ModelQuality, coverage: Coverage) -> str:
    """Return the step that improves the calibration most, one sentence."""
    used, bad = sum(pair.used for pair in quality.pairs), quality.far_from_fit()[:3]
    if quality.excluded:
        worst = max((pair for pair in quality.pairs if not pair.used), key=lambda pair: pair.residual_px)
        them = "them" if len(quality.excluded) > 1 else "it"
        step = (
            f"Click {listed(quality.excluded)} again or delete {them}: rejected, because the others contradict {them} "
            f"(pair {worst.id} by {worst.residual_px:.0f} px)."
        )
    elif used < ADVISED_POINTS:
        step = f"Click at least {ADVISED_POINTS - used} more: with six the quality can be estimated."
    elif quality.agreement.found:
        step = quality.agreement.next_step()
    elif bad:
        errors = " and ".join(f"{pair.residual_px:.1f}" for pair in bad)
        names = listed([pair.id for pair in bad])
        step = f"Click {names} again: {errors} px from the fit, much more than the others."
    elif quality.model == "rigid" and coverage.depth_span_mm < ADVISED_SPAN_MM:
        step = (
            f"Add points at another inflation level: all lie within {coverage.depth_span_mm:.0f} mm of depth, "
            f"{ADVISED_SPAN_MM:.0f} mm or more determine the pose well."
        )
    elif quality.model == "homography" and quality.effect.boundary_mm > GOOD_MM:
        step = "Check the tactile depths and take the rigid model: off its plane this homography is wrong."
    elif quality.alignment_px > GOOD_PX:
        wanted = min(int(np.ceil(used * (quality.alignment_px / GOOD_PX) ** 2)), 60)
        step = f"Add points where there are few, about {wanted} in all, clicked with the same care."
    else:
        step = "Check it on the live image and save it; nothing more is needed."
    return step
