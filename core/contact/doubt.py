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
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ..model.arrays import Float32Array, IndexArray, Uint16Array, median
from ..model.clouds import pixel_areas_m2, valid_depth
from ..model.frames import SensorFrame
from ..model.patch import SURE, Boundary, Candidates, Doubt, DoubtOf, Lazy, MembraneFacts, PressureFacts
from .membrane.equilibrium import LIMITS_PER_M
from .membrane.frame_bias import RigBias, rig_bias

if TYPE_CHECKING:
    from ..preset import Preset
    from .pixels import Pixels

#: Range of depths that are taken to be equally likely where no dent can be seen, metres.
_NEAR_M: Final = 0.005
#: Odds of a touch where no bias can hide a gap, and factor on the odds for each thing that is wrong.
_NO_BIAS_ODDS, _WRONG_ODDS = 24.0, 0.15
#: Most points of a contact, and rows and columns around it, that tell a dent; step between the tactile pixels that tell
#: how the rest has moved.
_MAX_POINTS, _BOX_ROWS, _STEP_PX = 400, 20, 16
_GRID: Final = (slice(_STEP_PX // 2, None, _STEP_PX),) * 2
#: The dent is the mean in the box around a contact that is wider on each side by this share: it does not end there.
_BESIDE: Final = 0.25
#: Standard deviation of a dent that no averaging reduces, metres, and share of the movement elsewhere that adds to it.
_DENT_FLOOR_M, _MOVED_SHARE = 0.0003, 0.5
#: Where both depths have moved alike, within this, metres, the proximity camera sees the membrane itself.
_ALIKE_M: Final = 0.004
#: Largest evidence of the untouched frame, natural logarithm of odds.
_MAX_EVIDENCE: Final = 4.0
LOST_PRINTS: Final = "prints gone from the mask"
NO_UNTOUCHED: Final = "no untouched frame"
#: Prints are gone from the mask if it covers less than this share of what it covers in the untouched frame.
_FEWER_PRINTS: Final = 0.5
#: A contact with a boundary error of more than this share of its radius may be none: odds fall by the second, natural
#: logarithm, for each radius that the error is larger. Beyond the third share it is said.
_ERROR_SHARE, _PER_RADIUS, _TOO_SMALL = 0.5, 4.0, 0.9
#: There is too little depth beyond this share of the boundary, or of the tactile depth; more noise beyond this ratio.
_MANY_UNSEEN, _MANY_LOST, _NOISIER = 0.06, 0.1, 1.35
#: Of the inflation when it was untouched, the share below which the membrane counts as deflated.
_DEFLATED: Final = 0.1
#: Contact pressure from this many standard deviations on adds no doubt; below the second it is said. The boundary's
#: error as a share of the window.
_SURE_SIGMAS, _WEAK_SIGMAS, _OF_WINDOW = 8.0, 7.0, 0.5


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
        moved = Lazy(lambda: self._dents_m(frame, _GRID))

        def doubt_of(contact: Candidates) -> Doubt:
            odds, reasons, boundary_mm = whole.get()
            if pressure is not None and pressure.curvature_growth < _DEFLATED:
                reasons = (*reasons, "membrane deflated")
            if not len(contact):
                return Doubt(0.0, math.nan, reasons)
            odds += math.log(self._bias_odds(preset, facts, known, float(contact.points[:, 2].mean())))
            area_m2 = float(pixel_areas_m2(contact.points[:, 2], self._pixels.rig.proximity.intrinsics).sum())
            evidence = 0.0
            if self._pixels.untouched is not None:
                dent_m, seen_m2, elsewhere_m, behind_m = self._moved_in(contact, frame, moved.get())
                if abs(behind_m) < _ALIKE_M and preset.test.needs_proximity:
                    evidence, reasons = -_MAX_EVIDENCE, (*reasons, "print or dirt")
                elif not math.isnan(dent_m):
                    evidence = _dent_evidence(preset, known, dent_m, seen_m2, elsewhere_m)
                    reasons = (*reasons, "no dent") if evidence < 0 else reasons
            if pressure is not None:
                evidence, doubts = _pressure_evidence(contact, pressure, evidence)
                reasons = (*reasons, *doubts)
                boundary_mm = 1e3 * _OF_WINDOW * pressure.edge_m
            radii = 1e-3 * boundary_mm / math.sqrt(area_m2 / math.pi)
            if radii > _ERROR_SHARE:
                odds -= min(_PER_RADIUS * (radii - _ERROR_SHARE), _MAX_EVIDENCE)
            if radii > _TOO_SMALL:
                reasons = (*reasons, "smaller than the error of its boundary")
            probability = 1 / (1 + math.exp(-odds - evidence))
            if self._pixels.untouched is None and probability < SURE:
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
        return _NEAR_M / (math.sqrt(math.pi / 2) * sigma_m)

    def _lost_share(self, tactile: Uint16Array) -> float:
        """Return the share of the untouched frame's tactile depth that is missing now."""
        before = self._pixels.untouched
        seen = np.empty(0, np.bool_) if before is None else valid_depth(before.tactile_depth[_GRID])
        return float(np.mean(~valid_depth(tactile[_GRID])[seen])) if seen.any() else 0.0

    def _wrong_bias(self, frame: SensorFrame, preset: Preset, known: RigBias) -> str:
        """Return what is wrong with the bias that is known before a frame is seen, in words; empty if nothing is."""
        if not preset.test.needs_proximity:
            return ""
        if not known.measured:
            return "bias unknown"
        if preset.contact_test == "membrane" and preset.membrane.bias:
            return ""
        counts = frame.tactile_depth[_GRID]
        distance_m = median(np.where(valid_depth(counts), counts * self._tactile_unit_m, np.float32(np.nan)))
        harmless = abs(known.mean_m) <= preset.test.bias_limits(preset, distance_m).good_m
        return "" if harmless else "bias not corrected"

    def _moved_in(
        self, contact: Candidates, frame: SensorFrame, everywhere_m: Float32Array
    ) -> tuple[float, float, float, float]:
        """Return how far the membrane around a contact has moved towards the camera, in what area, m^2, and elsewhere.

        Metres; nan if unseen. The last is how much farther what the proximity camera sees in contact has moved; large
        if it saw nothing.
        """
        pixels, before, elsewhere_m = self._pixels, self._pixels.untouched, everywhere_m.copy()
        assert before is not None
        some = np.s_[:: max(len(contact) // _MAX_POINTS, 1)]
        where = pixels.alignment.tactile_pixels(contact.pixels[some], contact.points[some, 2], pixels.rig)
        height, width = frame.tactile_depth.shape
        u, v = np.rint(np.nan_to_num(where, nan=-1.0)).astype(np.int64)
        seen = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        if not seen.any():
            return math.nan, 0.0, math.nan, math.nan
        u, v, places = u[seen], v[seen], contact.pixels[some][seen]
        box = rows, columns = _around(v, height), _around(u, width)
        elsewhere_m[tuple(slice(side.start // _STEP_PX, side.stop // _STEP_PX + 1) for side in box)] = np.nan
        pixel_m2 = float(pixel_areas_m2(contact.points[some, 2], pixels.rig.tactile.intrinsics).mean())
        area_m2 = pixel_m2 * (rows.stop - rows.start) * (columns.stop - columns.start)
        then, now = (each.proximity_depth.reshape(-1)[places] for each in (before, frame))
        behind_m = _moved_m(then, now, np.float32(pixels.rig.proximity.depth_unit_m)) - self._dents_m(frame, (v, u))
        farther_m = median(np.nan_to_num(behind_m, nan=1.0))
        return _middle_mean(self._dents_m(frame, box)), area_m2, _middle_mean(elsewhere_m), farther_m

    def _dents_m(self, frame: SensorFrame, where: Any) -> Float32Array:
        """Return how far the membrane has moved towards the camera; there is an untouched frame."""
        assert self._pixels.untouched is not None
        before, now = (each.tactile_depth[where] for each in (self._pixels.untouched, frame))
        return _moved_m(before, now, self._tactile_unit_m)

    @property
    def _tactile_unit_m(self) -> np.float32:
        return np.float32(self._pixels.alignment.tables.tactile_unit_m)


def _moved_m(before: Uint16Array, now: Uint16Array, unit_m: np.float32) -> Float32Array:
    """Return how far depths have moved towards the camera; nan where one is missing."""
    moved = (before.astype(np.float32) - now) * unit_m
    return np.asarray(np.where(valid_depth(before) & valid_depth(now), moved, np.float32(np.nan)))


def _around(places: IndexArray, size: int) -> slice:
    """Return a range of rows or columns around some of an image."""
    first, last = int(places.min()), int(places.max()) + 1
    beside = round(_BESIDE * (last - first))
    return slice(max(first - beside, 0), min(last + beside, size), max((last - first) // _BOX_ROWS, 1))


def _middle_mean(values: Float32Array) -> float:
    """Return the mean of the half around the median, nan left out: coarse disparities make the median itself coarse."""
    known = np.sort(values[np.isfinite(values)])
    middle = known[len(known) // 4 : len(known) - len(known) // 4]
    return float(middle.mean()) if len(middle) else math.nan


def _dent_evidence(preset: Preset, known: RigBias, dent_m: float, area_m2: float, elsewhere_m: float) -> float:
    """Return the logarithm of how much likelier a dent makes a touch than if none could be seen."""
    frames = 2 - (0.0 if preset.noise is None else preset.noise.tactile.changing_share)  # the untouched is averaged
    tactile_m4 = (1 - known.tactile_weight) * known.noise_m4
    noise_m2 = frames / (area_m2 / tactile_m4 + 1 / known.pixel_sigma_m**2)
    elsewhere_m = 0.0 if math.isnan(elsewhere_m) else elsewhere_m
    sigma_m = math.sqrt(noise_m2 + _DENT_FLOOR_M**2 + (_MOVED_SHARE * elsewhere_m) ** 2)
    sigmas = max(dent_m - elsewhere_m, 0.0) / sigma_m
    deeper = (1 + math.erf(sigmas / math.sqrt(2))) / 2
    depths_m = min(math.sqrt(2 * math.pi) * sigma_m * deeper, _NEAR_M)  # that agree with the dent
    evidence = math.log(depths_m / _NEAR_M) + sigmas**2 / 2
    return min(evidence, _MAX_EVIDENCE)


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
