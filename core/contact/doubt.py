"""How sure a patch is: for each contact the probability that it touches, the error of its boundary, and the reasons.

The probability begins with what is known of the bias between the cameras, since with a wrong bias a hovering object
passes for contact. Then the untouched frame is heard: a touch dents the membrane, by at least what its area lifts
against the pressure; and where the proximity camera saw the membrane itself before, it sees a print or dirt, no object.
Reasons for doubt are named in words.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ..model.arrays import Float32Array, Uint16Array, median
from ..model.clouds import pixel_areas_m2, valid_depth
from ..model.frames import SensorFrame
from ..model.patch import Boundary, Candidates, Doubt, DoubtOf, Lazy, MembraneFacts, PressureFacts
from .membrane.equilibrium import LIMITS_PER_M, USUAL_PER_M
from .membrane.frame_bias import rig_bias

if TYPE_CHECKING:
    from ..preset import Preset
    from .pixels import Pixels

#: Probability that what a test calls contact touches if the bias is seen on prints in the frame, if it was measured
#: before or there is none, if firm contact alone tells it, and if it is unknown.
_SEEN, _MEASURED, _FIRM, _UNKNOWN = 0.98, 0.96, 0.8, 0.6
#: Factors on the odds for each thing that is wrong.
_WRONG_ODDS: Final = 0.15
#: Fewest points of a contact that tell a dent, most that are looked up, and step between the tactile pixels that tell
#: how the rest has moved.
_FEWEST_POINTS, _MAX_POINTS, _STEP_PX = 20, 400, 16
_GRID: Final = (slice(_STEP_PX // 2, None, _STEP_PX),) * 2
#: Reach of the membrane around a contact as a multiple of its radius: its logarithm is the dent of a flat contact.
_REACH: Final = 8.0
#: Largest expected dent, metres: a large contact need not be a deep one.
_MAX_DENT_M: Final = 0.002
#: Standard deviation of a dent that no averaging reduces, metres, and share of the movement elsewhere that adds to it.
_DENT_FLOOR_M, _MOVED_SHARE = 0.0003, 0.5
#: Where both depths have moved alike, within this, metres, the proximity camera sees the membrane itself.
_ALIKE_M: Final = 0.004
#: Largest evidence of the untouched frame, natural logarithm of odds.
_MAX_EVIDENCE: Final = 4.0
LOST_PRINTS: Final = "prints gone from the mask"
#: Prints are gone from the mask if it covers less than this share of what it covers in the untouched frame.
_FEWER_PRINTS: Final = 0.5
#: Contact of less area is as likely an error beside a larger one, m^2.
_SMALL_M2: Final = 15e-6
#: A contact with a boundary error of more than this share of its radius may be none: odds fall by the second, natural
#: logarithm, for each radius that the error is larger. Beyond the third share it is said.
_ERROR_SHARE, _PER_RADIUS, _TOO_SMALL = 0.5, 4.0, 0.9
#: There is too little depth beyond this share of the boundary, or of the tactile depth; more noise beyond this ratio.
_MANY_UNSEEN, _MANY_LOST, _NOISIER = 0.06, 0.1, 1.35
#: A dent is missing, and said to be, from this evidence on.
_MISSING: Final = -1.0
#: Of the inflation when it was untouched, the share below which the membrane counts as deflated.
_DEFLATED: Final = 0.1
#: Contact pressure from this many standard deviations on adds no doubt. The boundary's error as a share of the window.
_SURE_SIGMAS, _OF_WINDOW = 8.0, 0.5


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
        whole = Lazy(lambda: self._whole_frame(frame, preset, facts))
        moved = Lazy(lambda: self._dents_m(frame, _GRID))
        noise_m4 = rig_bias(preset.noise, self._pixels.rig).noise_m4

        def doubt_of(contact: Candidates) -> Doubt:
            odds, reasons, boundary_mm = whole.get()
            if pressure is not None and pressure.curvature_growth < _DEFLATED:
                reasons = (*reasons, "membrane deflated")
            if not len(contact):
                return Doubt(0.0, math.nan, reasons)
            area_m2 = float(pixel_areas_m2(contact.points[:, 2], self._pixels.rig.proximity.intrinsics).sum())
            odds += math.log(area_m2 / (area_m2 + _SMALL_M2))
            evidence = 0.0
            if len(contact) >= _FEWEST_POINTS and self._pixels.untouched is not None:
                dent_m, elsewhere_m, behind_m = self._moved_in(contact, frame, moved.get())
                if abs(behind_m) < _ALIKE_M and preset.test.needs_proximity:
                    evidence, reasons = -_MAX_EVIDENCE, (*reasons, "print or dirt")
                elif not math.isnan(dent_m):
                    evidence = _dent_evidence(dent_m, elsewhere_m, area_m2, facts, noise_m4)
                    reasons = (*reasons, "no dent") if evidence < _MISSING else reasons
            if pressure is not None:
                evidence, doubts = _pressure_evidence(contact, pressure, evidence)
                reasons = (*reasons, *doubts)
                boundary_mm = 1e3 * _OF_WINDOW * pressure.edge_m
            radii = 1e-3 * boundary_mm / math.sqrt(area_m2 / math.pi)
            if radii > _ERROR_SHARE:
                odds -= min(_PER_RADIUS * (radii - _ERROR_SHARE), _MAX_EVIDENCE)
            if radii > _TOO_SMALL:
                reasons = (*reasons, "smaller than the error of its boundary")
            return Doubt(1 / (1 + math.exp(-odds - evidence)), boundary_mm, reasons)

        return doubt_of

    def _whole_frame(
        self, frame: SensorFrame, preset: Preset, facts: MembraneFacts | None
    ) -> tuple[float, tuple[str, ...], float]:
        """Return the logarithm of the odds before any dent is seen, reasons for doubt, and the boundary error, mm."""
        reasons = []
        seen = facts is not None and facts.bias_seen
        firm = facts is not None and facts.firm_m2 > 0.0
        measured, not_corrected = self._bias_measured(frame, preset)
        probability = _SEEN if seen else _MEASURED if measured else _FIRM if firm else _UNKNOWN
        if not (seen or measured):
            reasons.append("bias not corrected" if not_corrected else "bias unknown")
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
        odds = math.log(probability / (1 - probability)) + len(wrong) * math.log(_WRONG_ODDS)
        return odds, (*reasons, *wrong), 1e3 * boundary.error_m

    def _lost_share(self, tactile: Uint16Array) -> float:
        """Return the share of the untouched frame's tactile depth that is missing now."""
        before = self._pixels.untouched
        seen = np.empty(0, np.bool_) if before is None else valid_depth(before.tactile_depth[_GRID])
        return float(np.mean(~valid_depth(tactile[_GRID])[seen])) if seen.any() else 0.0

    def _bias_measured(self, frame: SensorFrame, preset: Preset) -> tuple[bool, bool]:
        """Return whether the bias is known before a frame is seen, and whether it is known but not corrected."""
        known = rig_bias(preset.noise, self._pixels.rig)
        corrects = preset.contact_test == "membrane" and preset.membrane.bias
        if corrects or not preset.test.needs_proximity:
            return known.measured or not preset.test.needs_proximity, False
        counts = frame.tactile_depth[_GRID]
        distance_m = median(np.where(valid_depth(counts), counts * self._tactile_unit_m, np.float32(np.nan)))
        harmless = abs(known.mean_m) <= preset.test.bias_limits(preset, distance_m).good_m
        return known.measured and harmless, known.measured and not harmless

    def _moved_in(
        self, contact: Candidates, frame: SensorFrame, everywhere_m: Float32Array
    ) -> tuple[float, float, float]:
        """Return how far the membrane in contact has moved towards the camera, and elsewhere; nan if unseen.

        The third is how much farther what the proximity camera sees in contact has moved; large if it saw nothing.
        Elsewhere is outside the box around the contact in the tactile image.
        """
        pixels, before = self._pixels, self._pixels.untouched
        assert before is not None
        some = np.s_[:: max(len(contact) // _MAX_POINTS, 1)]
        where = pixels.alignment.tactile_pixels(contact.pixels[some], contact.points[some, 2], pixels.rig)
        height, width = frame.tactile_depth.shape
        u, v = np.rint(np.nan_to_num(where, nan=-1.0)).astype(np.int64)
        seen = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        if not seen.any():
            return math.nan, math.nan, math.nan
        u, v, elsewhere_m, places = u[seen], v[seen], everywhere_m.copy(), contact.pixels[some][seen]
        top, bottom, left, right = (int(side) // _STEP_PX for side in (v.min(), v.max(), u.min(), u.max()))
        elsewhere_m[top : bottom + 1, left : right + 1] = np.nan
        dent_m = self._dents_m(frame, (v, u))
        then, now = (each.proximity_depth.reshape(-1)[places] for each in (before, frame))
        behind_m = _moved_m(then, now, np.float32(pixels.rig.proximity.depth_unit_m)) - dent_m
        return median(dent_m), median(elsewhere_m), median(np.nan_to_num(behind_m, nan=1.0))

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


def _dent_evidence(
    dent_m: float, elsewhere_m: float, area_m2: float, facts: MembraneFacts | None, noise_m4: float
) -> float:
    """Return the logarithm of how much likelier a dent is of a touched membrane than of another one.

    A flat contact of area A dents a membrane of twice the mean curvature c by A c ln(R / r) / (2 pi) at least, where r
    is its radius and R the membrane's: the force is p A, the tension p / c.
    """
    curved = USUAL_PER_M if facts is None else facts.used_curvature_per_m
    expected_m = min(area_m2 * curved * math.log(_REACH) / (2 * math.pi), _MAX_DENT_M)
    elsewhere_m = 0.0 if math.isnan(elsewhere_m) else elsewhere_m
    sigma_m2 = noise_m4 / area_m2 + _DENT_FLOOR_M**2 + (_MOVED_SHARE * elsewhere_m) ** 2
    evidence = (dent_m - elsewhere_m - expected_m / 2) * expected_m / sigma_m2
    return min(max(evidence, -_MAX_EVIDENCE), _MAX_EVIDENCE)


def _pressure_evidence(contact: Candidates, facts: PressureFacts, dent: float) -> tuple[float, tuple[str, ...]]:
    """Return what the pressure in a contact adds to the evidence of its dent, and reasons for doubt."""
    sigmas = np.nan_to_num(facts.sigmas_at(contact.pixels))
    evidence, reasons = min(float(sigmas.max()) - _SURE_SIGMAS, 0.0), []
    if evidence < _MISSING:
        reasons.append("pressure hardly above the noise")
    # a dent in the same noise confirms nothing
    evidence += dent if evidence == 0 else min(dent, 0.0)
    if facts.at_rim:
        evidence, reasons = evidence + math.log(_WRONG_ODDS), [*reasons, "at the rim"]
    if not facts.agrees:
        reasons.append("force and pressure disagree")
    if not facts.noise_known:
        evidence, reasons = evidence + math.log(_WRONG_ODDS), [*reasons, "noise not measured"]
    return evidence, tuple(reasons)
