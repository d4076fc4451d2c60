"""What is wrong with the present frame or preset: plain functions, each of which looks for one thing."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

from ...contact.doubt import LOST_PRINTS, NO_UNTOUCHED
from ...contact.masking import masked_share
from ...contact.membrane.equilibrium import LIMITS_PER_M, measured_curvature_per_m
from ...contact.membrane.frame_bias import UNKNOWN_BIAS_M, rig_bias
from ...contact.membrane.section import USUAL_GAP_M
from ...contact.membrane.steps import firm_contact_bias
from ...contact.pipeline import ContactPipeline
from ...errors import AdviceError, FrameError, RigMismatchError, counted, minus
from ...model.arrays import BoolArray, median
from ...model.clouds import valid_depth
from ...model.frames import Rig, SensorFrame
from ...model.patch import ContactPatch
from ...preset import Preset
from ...rig.bias import MeasuredBias, pressed_bias, print_bias, scene_bias
from .mask import find_prints
from .proposal import Evidence, Finding, Proposal
from .suggest import propose_alignment, suggest_tolerance

#: Step between the rows and columns that are read where every pixel is not needed.
_STRIDE: Final = 4
#: A camera measures no depth if less than this share of its image has one. Distances of a membrane, metres.
_MIN_SEEN, _PLAUSIBLE_M = 0.05, (0.02, 2.0)
#: Largest share of the colour image that prints cover.
_MAX_MASKED: Final = 0.5
#: A bias of less than this number of standard deviations is not certain. For small contact the membrane test assumes a
#: bias of up to the second, metres; one of an uncalibrated depth offset is reported from the third on, as it displaces
#: the patch. The depth of a scene must vary by this multiple of the bias, or it may be a gap.
_CERTAIN, _MAX_ASSUMED_M, _MAX_OWN_M, _MIN_RELIEF = 3.0, 2 * UNKNOWN_BIAS_M, 0.003, 1.5
#: Prints: fewest groups of contact, fewest pixels of one, and share of a group's pixels with the prints' colour.
_MIN_PRINTS, _MIN_GROUP_PX, _MIN_COLORED = 3, 25, 0.8
#: False contact below this area is not reported; a smallest contact above the second would drop what people press; the
#: proposed one exceeds the largest false contact by the third, mm2.
_MIN_FALSE_MM2, _MAX_SMALLEST_MM2, _MARGIN = 10.0, 100.0, 1.2
#: An object in contact dents the membrane. Curvature of a slightly bulged membrane, 1/m, and the smallest dent that can
#: be told from noise, metres.
_BULGE_PER_M, _MIN_DENT_M = 10.0, 0.001
#: The tolerance fits the noise between these multiples of what it asks for; the largest gap up to this multiple.
_FIT, _FIT_GAP = (0.5, 3.0), 2.0


@dataclass(frozen=True, eq=False)
class Situation:
    """The present frame, its patch with the present preset, and the stored untouched frame with its patch."""

    frame: SensorFrame
    patch: ContactPatch
    preset: Preset
    rig: Rig
    untouched: SensorFrame | None = None
    untouched_patch: ContactPatch | None = None


def _distance_m(frame: SensorFrame, rig: Rig) -> float:
    """Return the median tactile depth as measured, metres; nan without depth."""
    counts = frame.tactile_depth[::_STRIDE, ::_STRIDE]
    counts = counts[valid_depth(counts)]
    return float(np.median(counts)) * rig.tactile.depth_unit_m if len(counts) else math.nan


def unusable_test(preset: Preset, rig: Rig, untouched: SensorFrame | None) -> Finding | None:
    """The contact test compares with a camera or a frame that is not there, so there is no patch."""
    if preset.test.needs_proximity and not rig.has_proximity:
        sentence = f"The contact test {preset.contact_test} compares two cameras; this rig has a tactile camera only."
        expected = "Contact is where the membrane is flatter than in the untouched frame."
        proposal = Proposal("contact_test", {"contact_test": "pressure"}, "Use the pressure test", sentence, expected)
        return Finding("one_camera", "contact_test", sentence, proposal, explains_empty=True)
    if preset.test.needs_untouched and untouched is None:
        sentence = (
            f"The contact test {preset.contact_test} compares with the untouched frame, and there is none: capture it "
            "while nothing touches the membrane."
        )
        return Finding("no_untouched", "contact_test", sentence, action="capture_untouched", explains_empty=True)
    return None


def depth_missing(frame: SensorFrame, rig: Rig) -> Finding | None:
    """Report a camera that measures hardly any depth, or implausible tactile depth. No patch is needed."""
    remedies = {
        "proximity": "raise its laser power or gain, and check that nothing covers its window",
        "tactile": "light the membrane evenly, and check that it has texture and that the lens is clean",
    }
    if not rig.has_proximity:
        remedies.pop("proximity")
    for role, remedy in remedies.items():
        counts = frame.proximity_depth if role == "proximity" else frame.tactile_depth
        share = float(np.mean(valid_depth(counts[::_STRIDE, ::_STRIDE])))
        if share < _MIN_SEEN:
            sentence = f"The {role} camera measures no depth in {100 * (1 - share):.0f} % of its image: {remedy}."
            return Finding("no_depth", "cameras", sentence, action="camera_settings", explains_empty=True)
    return wrong_unit(frame, rig)


def wrong_unit(frame: SensorFrame, rig: Rig) -> Finding | None:
    """The tactile camera sees the membrane at a distance that no sensor has."""
    distance_m = _distance_m(frame, rig)
    if math.isnan(distance_m) or _PLAUSIBLE_M[0] <= distance_m <= _PLAUSIBLE_M[1]:
        return None
    sentence = (
        f"The tactile camera sees the membrane at {distance_m:.2g} m in the median: check its depth_unit_m "
        f"{rig.tactile.depth_unit_m:g} in rig.json."
    )
    return Finding("depth_unit", "cameras", sentence, action="camera_settings", explains_empty=True)


def covering_mask(it: Situation) -> Finding | None:
    """The mask covers most of the colour image."""
    mask = it.preset.mask
    if not mask.enabled or (share := masked_share(it.frame.proximity_color, mask)) <= _MAX_MASKED:
        return None
    sentence = f"The mask covers {100 * share:.1f} % of the colour image, and nothing under it counts as contact."
    expected = "All colours count. Then pick the colour of the prints."
    proposal = Proposal("mask", {"mask.enabled": False}, "Mask off", sentence, expected)
    return Finding("covering_mask", "mask.hue", sentence, proposal, explains_empty=True)


def peak(it: Situation) -> Finding | None:
    """The bias between the cameras is larger than the contact test stands."""
    preset, section = it.preset, it.preset.alignment
    distance_m = _distance_m(it.frame, it.rig) * section.depth_scale + section.depth_offset_m
    if not preset.test.needs_proximity or not distance_m > 0 or (found := _bias(it)) is None:
        return None
    limits = preset.test.bias_limits(preset, distance_m)
    largest_m = min((limits.good_m + limits.fair_m) / 2, _MAX_ASSUMED_M)  # half of what leaves no contact
    noise = preset.noise
    corrects = preset.contact_test == "membrane" and preset.membrane.bias
    expected_m = noise.bias_m if corrects and noise is not None and noise.bias_from != "unknown" else 0.0
    own_m = 0.0 if preset.alignment.calibration is not None else preset.alignment.depth_offset_m
    excess_m = found.bias_m - expected_m
    if abs(excess_m + own_m) < abs(excess_m):  # the cameras agree better without the offset
        largest_m = min(largest_m, _MAX_OWN_M)
    if abs(excess_m) <= max(largest_m, _CERTAIN * found.sigma_m):
        return None
    proposal = propose_alignment(Evidence(preset, it.rig, (it.frame,), it.untouched), found)
    place = minus(f"{100 * found.bias_m / distance_m:+.1f} %, {1e3 * found.bias_m:+.1f} mm")
    sentence, field = f"Bias in this frame {place}: the cameras disagree.", "alignment.depth_offset_m"
    if proposal.changes:
        return Finding("peak", field, sentence, proposal, explains_empty=True)
    return Finding("peak", field, sentence, action="measure_noise", explains_empty=True)


def _bias(it: Situation) -> MeasuredBias | None:
    """Return the bias in the present frame, where it can be told from a gap."""
    preset, rig, aligned = it.preset, it.rig, it.patch.aligned
    difference_m = aligned.expected_m - aligned.measured_m
    if (scene := scene_bias(aligned.expected_m, difference_m, _MIN_RELIEF)) is not None:
        return scene
    known, facts = rig_bias(preset.noise, rig), it.patch.membrane
    if facts is not None and facts.bias_seen:  # the test has measured it on prints
        return MeasuredBias(facts.bias_m, facts.bias_sigma_m, "prints")
    try:
        if (prints := print_bias([it.frame], rig, preset, known.noise_m4, difference_m)) is not None:
            return prints
        if facts is not None:
            contact = (facts.bias_m, facts.firm_m2) if facts.firm_m2 > 0 and len(it.patch.points) else None
        elif LIMITS_PER_M[0] <= measured_curvature_per_m(it.frame, preset.alignment, rig) <= LIMITS_PER_M[1]:
            contact = firm_contact_bias(preset, rig)(it.frame)
        else:
            return None  # without an inflated membrane nothing tells firm contact from a flat gap
    except RigMismatchError:  # a homography without a pose
        return None
    return pressed_bias([contact], known.noise_m4, known.gap_sigma_m)


def _better_mask(it: Situation) -> tuple[Proposal, BoolArray] | None:
    """Return another mask of the prints in the frame and its pixels; None if there is none, or the preset's does."""
    with suppress(AdviceError, FrameError, RigMismatchError):
        found = find_prints(Evidence(it.preset, it.rig, (it.frame,)))
        return found if found[0].changes else None
    return None


def prints(it: Situation) -> Finding | None:
    """Several groups of contact have the colour of prints, and wherever it is, both cameras measure the membrane."""
    if not it.preset.test.needs_proximity:
        return None
    large = [contact.members for contact in it.patch.contacts if len(contact.members) >= _MIN_GROUP_PX]
    if len(large) < _MIN_PRINTS:
        return None
    mask = _better_mask(it)
    if mask is None:
        return None
    proposal, covered = mask
    found = sum(covered[it.patch.mask][members].mean() >= _MIN_COLORED for members in large)
    if found < 2:
        return None
    hue = proposal.apply(it.preset).mask.hue
    sentence = f"{found} groups of contact have one colour (hue {hue[0]} to {hue[1]}): probably prints."
    return Finding("prints", "mask.enabled", sentence, proposal)


def changed_bias(it: Situation) -> Finding | None:
    """Prints read another bias than the rig had when it was measured."""
    facts = it.patch.membrane
    if facts is None or facts.bias_change_m == 0.0 or it.preset.alignment.model == "homography":
        return None  # off its plane a homography looks like another bias
    change = minus(f"{1e3 * facts.bias_change_m:+.1f} mm")
    sentence = f"The bias has changed by {change} since it was measured; what the prints read now is used."
    return Finding("changed_bias", "membrane.bias", sentence, action="measure_noise")


def lost_prints(it: Situation) -> Finding | None:
    """The mask covers fewer prints than in the untouched frame, and no other light explains it."""
    if LOST_PRINTS not in it.patch.doubt.reasons:
        return None
    sentence = "The mask covers less than half of the prints that it covers in the untouched frame."
    mask = _better_mask(it)
    return Finding("lost_prints", "mask.hue", sentence, mask and mask[0])


def unknown_bias(it: Situation) -> Finding | None:
    """Contact is too small to tell the bias from a gap, on a rig whose bias was not measured."""
    facts = it.patch.membrane
    if facts is None or not it.preset.membrane.bias or facts.bias_known or not len(it.patch.points):
        return None
    sentence = "This contact is too small to tell a bias from a gap, and the bias of this rig is not measured."
    if not it.preset.mask.enabled and (mask := _better_mask(it)):
        return Finding("unknown_bias", "mask.enabled", f"{sentence} The mask is off; prints tell the bias.", mask[0])
    return Finding("unknown_bias", "membrane.bias", sentence, action="measure_noise")


def unknown_dent(it: Situation) -> Finding | None:
    """A patch is doubted because there is no untouched frame."""
    if NO_UNTOUCHED not in it.patch.doubt.reasons:
        return None
    sentence = "Without the untouched frame nothing tells this touch from a hover: capture it while nothing touches."
    return Finding("unknown_dent", "contact_test", sentence, action="capture_untouched")


def unfit_tolerance(it: Situation) -> Finding | None:
    """The tolerance is far from what noise and alignment ask for: it leaves holes, or passes what hovers."""
    preset = it.preset
    if preset.contact_test != "tolerance" or preset.noise is None:
        return None
    proposal = suggest_tolerance(Evidence(preset, it.rig, (it.frame,), it.untouched), lambda *_: None)
    due, present = float(proposal.changes.get("tolerance.t", preset.tolerance.t)), preset.tolerance.t
    if due * _FIT[0] <= present <= due * _FIT[1]:
        return None
    effect = "what hovers up to that distance counts as contact" if present > due else "contact has holes"
    sentence = f"The tolerance is {100 * present:g} %; noise and alignment ask for {100 * due:g} %: {effect}."
    return Finding("unfit_tolerance", "tolerance.t", sentence, proposal)


def wide_gap(it: Situation) -> Finding | None:
    """The membrane test's largest gap counts membrane that hovers as contact."""
    present_m = it.preset.membrane.gap_m
    if it.preset.contact_test != "membrane" or present_m <= _FIT_GAP * USUAL_GAP_M:
        return None
    sentence = f"The largest gap is {1e3 * present_m:g} mm: membrane that hovers up to there counts as contact."
    words = f"Largest gap {1e3 * USUAL_GAP_M:g} mm"
    expected = "The edge of contact is where the membrane leaves the object."
    proposal = Proposal("membrane", {"membrane.gap_m": USUAL_GAP_M}, words, sentence, expected)
    return Finding("wide_gap", "membrane.gap_m", sentence, proposal)


def bulge(it: Situation) -> Finding | None:
    """The membrane test uses another curvature of the free membrane than the measured one."""
    facts = it.patch.membrane
    if facts is None or LIMITS_PER_M[0] <= facts.curvature_per_m <= LIMITS_PER_M[1]:
        return None
    seen = "The tactile camera sees too little of the membrane to measure its bulge"
    if not math.isnan(facts.curvature_per_m):
        seen = f"The membrane has no usual bulge: its curvature measures {facts.curvature_per_m:.1f} per m"
    sentence = f"{seen}; the membrane test assumes {facts.used_curvature_per_m:g} per m."
    proposal = Proposal(
        "contact_test",
        {"contact_test": "tolerance"},
        "Use the tolerance test",
        "The membrane test needs the curvature of the free membrane, its pressure over its tension.",
        "Contact no longer depends on the curvature of the membrane.",
    )
    return Finding("bulge", "contact_test", sentence, proposal)


def false_contact(it: Situation) -> Finding | None:
    """The preset finds contact on the untouched membrane, or on one that is where it was in the untouched frame."""
    patch, where = it.untouched_patch, "The untouched frame has"
    if patch is None or patch.area_mm2 < _MIN_FALSE_MM2:
        patch, where = it.patch, "The membrane is where it was in the untouched frame, but there is"
        # A flat object that touches a membrane of twice the mean curvature c over the area A dents it by at least
        # A c / (4 pi), the height of a sphere's cap.
        dent_m = 1e-6 * patch.area_mm2 * _BULGE_PER_M / (4 * math.pi)
        if it.untouched_patch is None or patch.area_mm2 < _MIN_FALSE_MM2 or dent_m < _MIN_DENT_M:
            return None
        change_m = (patch.aligned.measured_m - it.untouched_patch.aligned.measured_m)[patch.mask]
        if not abs(median(change_m)) < dent_m / 2:
            return None
    lens, depth_m = it.rig.proximity.intrinsics, float(np.median(patch.points[:, 2]))
    largest_px, places = max(len(each.members) for each in patch.contacts), counted(len(patch.contacts), "place")
    largest_mm2 = 1e6 * largest_px * depth_m**2 / (lens.fx * lens.fy)
    sentence = f"{where} {patch.area_mm2:.0f} mm² of contact in {places} with this preset."
    field = it.preset.test.smallest_field
    smallest_mm2 = float(math.ceil(_MARGIN * largest_mm2))
    if smallest_mm2 > _MAX_SMALLEST_MM2:
        return Finding("false_contact", field, sentence, action="measure_noise")
    proposal = Proposal(
        field.partition(".")[0],
        {field: smallest_mm2},
        f"Smallest contact {smallest_mm2:g} mm²",
        f"The largest false contact has {largest_mm2:.0f} mm².",
        "The untouched membrane gives no contact. True contact below that area is dropped too.",
    )
    return Finding("false_contact", field, sentence, proposal)


#: The checks in the order in which their findings are shown: causes before consequences.
CHECKS: Final[tuple[Callable[[Situation], Finding | None], ...]] = (
    lambda it: depth_missing(it.frame, it.rig),
    covering_mask, peak, changed_bias, prints, lost_prints, unknown_bias, unknown_dent, unfit_tolerance, wide_gap,
    bulge, false_contact,
)  # fmt: skip


#: Whoever writes the findings of every frame examines one in this many; the others carry its findings.
EXAMINED_EVERY: Final = 15


class Examiner:
    """Runs all checks on frames of one rig. For one thread at a time."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._pipeline: ContactPipeline | None = None

    def findings(
        self, frame: SensorFrame, patch: ContactPatch, preset: Preset, untouched: SensorFrame | None = None
    ) -> tuple[Finding, ...]:
        """Return what is wrong with a frame, whose patch this is, and a preset.

        The preset is applied to the stored untouched frame again only after a change of either.
        """
        before: ContactPatch | None = None
        if untouched is not None:
            if self._pipeline is None or untouched is not self._pipeline.untouched:
                self._pipeline = ContactPipeline(preset, self._rig, untouched)
            elif self._pipeline.preset is not preset:
                self._pipeline.update(preset)
            before = self._pipeline.process(untouched)
        situation = Situation(frame, patch, preset, self._rig, untouched, before)
        return tuple(finding for check in CHECKS if (finding := check(situation)) is not None)
