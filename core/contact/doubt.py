"""How sure a patch is: for each contact the probability that it touches, the error of its boundary, and the reasons.

A hovering object passes for contact where an error of the bias between the cameras hides its gap: a gap g is hidden
with the likelihood exp(-g^2 / (2 b^2)), where b is the standard deviation of the bias. A touch dents the membrane: if
the true dent is x, the measured one d since the untouched frame has the likelihood exp(-(d - x)^2 / (2 s^2)), where s
is its standard deviation. An object near the membrane is as likely to hover at any gap as to dent it by any depth. So
the odds that it touches are the ratio of the integrals over all depths x and over all gaps g, the latter times the
likelihood of x = 0:

    2 s / b * F(d / s) * exp(d^2 / (2 s^2)), where F is the normal distribution function.

The tolerance test lets every gap pass up to its limit. That widens b.

Large errors of the boundary and other faults lower the odds. Where the proximity camera saw the membrane itself before,
it sees a print or dirt, no object. Reasons for doubt are named in words.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from ..model.arrays import Uint16Array, median
from ..model.clouds import pixel_areas_m2, valid_depth
from ..model.frames import SensorFrame
from ..model.patch import SURE, Boundary, Candidates, Doubt, DoubtOf, Lazy, MembraneFacts, PressureFacts
from .dents import GRID, MAX_EVIDENCE, NEAR_M, Dents
from .membrane.equilibrium import LIMITS_PER_M
from .membrane.frame_bias import RigBias, rig_bias

if TYPE_CHECKING:
    from ..preset import Preset
    from .pixels import Pixels

#: Odds of a touch where no bias can hide a gap, and factor on the odds for each thing that is wrong.
_NO_BIAS_ODDS, _WRONG_ODDS = 24.0, 0.15
#: Where both depths have moved alike, within this, metres, the proximity camera sees the membrane itself.
_ALIKE_M: Final = 0.004
LOST_PRINTS: Final = "prints gone from the mask"
NO_UNTOUCHED: Final = "no untouched frame"
#: Prints are gone from the mask if it covers less than this share of what it covers in the untouched frame.
_FEWER_PRINTS: Final = 0.5
#: A contact with a boundary error of more than this share of its radius may be none: odds fall by the second, natural
#: logarithm, for each radius that the error is larger. Beyond the third share it is said.
_ERROR_SHARE, _PER_RADIUS, _TOO_SMALL = 0.5, 4.0, 0.9
#: There is too little depth beyond this share of the boundary, or of the tactile depth; more noise beyond this ratio.
_MANY_UNSEEN, _MANY_LOST, _NOISIER = 0.06, 0.1, 1.35
#: Of the inflation when it was untouched, the share below which the membrane counts as deflated, and that below which
#: the change is said; a press makes the free membrane rounder only.
_DEFLATED, _LESS_INFLATION = 0.1, 0.8
#: Contact pressure from this many standard deviations on adds no doubt; below the second it is said.
_SURE_SIGMAS, _WEAK_SIGMAS = 8.0, 7.0


class DoubtEstimator:
    """Says how sure the patches of one rig are; with an untouched frame it knows how far the membrane has moved.

    Whether a camera has moved since the untouched frame, a check for drift tells (`tactune.core.rig.drift.Watch`).
    """

    def __init__(self, pixels: Pixels, cameras_moved: bool = False) -> None:
        self._pixels, self._cameras_moved = pixels, cameras_moved

    def doubts(
        self, frame: SensorFrame, preset: Preset, facts: MembraneFacts | None, pressure: PressureFacts | None = None
    ) -> DoubtOf:
        """Return a function that tells the `Doubt` about one contact of a frame."""
        known = rig_bias(preset.noise, self._pixels.rig)
        whole = Lazy(lambda: self._whole_frame(frame, preset, facts, known))
        untouched = self._pixels.untouched
        dents = None if untouched is None else Dents(self._pixels, frame, untouched)
        calibration = preset.alignment.calibration if self._pixels.rig.has_proximity else None
        off_mm = 0.0 if calibration is None else calibration.quality.boundary_error_mm

        def doubt_of(contact: Candidates) -> Doubt:
            odds, reasons, boundary_mm = whole.get()
            if pressure is not None and pressure.curvature_growth < _LESS_INFLATION:
                deflated = pressure.curvature_growth < _DEFLATED
                reasons = (*reasons, "membrane deflated" if deflated else "inflation changed")
            if not len(contact):
                return Doubt(0.0, math.nan, reasons)
            odds += math.log(self._bias_odds(preset, facts, known, float(contact.points[:, 2].mean())))
            area_m2 = float(pixel_areas_m2(contact.points[:, 2], self._pixels.rig.proximity.intrinsics).sum())
            evidence = 0.0
            if dents is not None:
                dent = dents.around(contact.pixels, contact.points[:, 2])
                if abs(dent.behind_m) < _ALIKE_M and preset.test.needs_proximity:
                    evidence, reasons = -MAX_EVIDENCE, (*reasons, "print or dirt")
                else:
                    evidence = dent.evidence(preset.noise, known.tactile_m4, known.pixel_sigma_m)
                    reasons = (*reasons, "no dent") if evidence < 0 else reasons
            if pressure is not None:
                evidence, doubts = _pressure_evidence(contact, pressure, evidence)
                reasons = (*reasons, *doubts)
                boundary_mm = 1e3 * pressure.edge_error_m(contact.pixels)
            boundary_mm = math.hypot(boundary_mm, off_mm)
            radii = 1e-3 * boundary_mm / math.sqrt(area_m2 / math.pi)
            if radii > _ERROR_SHARE:
                odds -= min(_PER_RADIUS * (radii - _ERROR_SHARE), MAX_EVIDENCE)
            if radii > _TOO_SMALL:
                reasons = (*reasons, "smaller than the error of its boundary")
            probability = 1 / (1 + math.exp(-odds - evidence))
            if untouched is None and probability < SURE:
                reasons = (*reasons, NO_UNTOUCHED)
            return Doubt(probability, boundary_mm, reasons)

        return doubt_of

    def _whole_frame(
        self, frame: SensorFrame, preset: Preset, facts: MembraneFacts | None, known: RigBias
    ) -> tuple[float, tuple[str, ...], float]:
        """Return the logarithm of a factor on the odds, reasons for doubt, and the boundary error, mm."""
        reasons = []
        if (facts is None or not facts.bias_seen) and (reason := self._wrong_bias(frame, preset, known)):
            reasons.append(reason)
        wrong = ["cameras moved"] if self._cameras_moved else []
        if facts is not None and not LIMITS_PER_M[0] <= facts.curvature_per_m <= LIMITS_PER_M[1]:
            wrong.append("outside the model")
        if facts is not None and facts.missed_parts:
            wrong.append("found with a larger bias")
        light = self._pixels.light
        if light is not None and light.covered(frame.proximity_color) < _FEWER_PRINTS:
            wrong.append(LOST_PRINTS)
        boundary = Boundary(math.nan, 0.0, 1.0) if facts is None else facts.boundary.get()
        if boundary.noise_ratio > _NOISIER:
            wrong.append("more noise than measured")
        if boundary.unseen_share > _MANY_UNSEEN or self._lost_share(frame.tactile_depth) > _MANY_LOST:
            reasons.append("too little depth")
        return len(wrong) * math.log(_WRONG_ODDS), (*reasons, *wrong), 1e3 * boundary.error_m

    def _bias_odds(self, preset: Preset, facts: MembraneFacts | None, known: RigBias, distance_m: float) -> float:
        """Return the odds of a touch at a distance before any dent is seen."""
        if not preset.test.needs_proximity:
            return _NO_BIAS_ODDS
        passing_m = math.sqrt(2 / math.pi) * preset.test.accepted_share(preset, distance_m) * distance_m
        sigma_m = math.hypot(known.mean_m, known.sigma_m, passing_m) if facts is None else facts.bias_sigma_m
        return NEAR_M / (math.sqrt(math.pi / 2) * sigma_m)

    def _lost_share(self, tactile: Uint16Array) -> float:
        """Return the share of the untouched frame's tactile depth that is missing now."""
        before = self._pixels.untouched
        seen = np.empty(0, np.bool_) if before is None else valid_depth(before.tactile_depth[GRID])
        return float(np.mean(~valid_depth(tactile[GRID])[seen])) if seen.any() else 0.0

    def _wrong_bias(self, frame: SensorFrame, preset: Preset, known: RigBias) -> str:
        """Return what is wrong with the bias that is known before a frame is seen, in words; empty if nothing is."""
        if not preset.test.needs_proximity:
            return ""
        if not known.measured:
            return "bias unknown"
        if preset.contact_test == "membrane" and preset.membrane.bias:
            return ""
        counts = frame.tactile_depth[GRID]
        unit_m = np.float32(self._pixels.alignment.tables.tactile_unit_m)
        distance_m = median(np.where(valid_depth(counts), counts * unit_m, np.float32(np.nan)))
        harmless = abs(known.mean_m) <= preset.test.bias_limits(preset, distance_m).good_m
        return "" if harmless else "bias not corrected"


def _pressure_evidence(contact: Candidates, facts: PressureFacts, dent: float) -> tuple[float, tuple[str, ...]]:
    """Return what the pressure in a contact adds to the evidence of its dent, and reasons for doubt."""
    sigmas = float(np.nan_to_num(facts.sigmas_at(contact.pixels)).max())
    evidence = min(sigmas - _SURE_SIGMAS, 0.0)
    reasons = ["pressure hardly above the noise"] if sigmas < _WEAK_SIGMAS else []
    # a dent in the same noise confirms nothing
    evidence += dent if evidence == 0 else min(dent, 0.0)
    if facts.at_rim:
        evidence, reasons = evidence + math.log(_WRONG_ODDS), [*reasons, "at the rim"]
    if not facts.agrees:
        reasons.append("force and pressure disagree")
    if not facts.noise_known:
        evidence, reasons = evidence + math.log(_WRONG_ODDS), [*reasons, "noise not measured"]
    return evidence, tuple(reasons)
