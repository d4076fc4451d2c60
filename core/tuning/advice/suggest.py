"""Proposals for the sections of a preset: contact test, depth offset, limits that follow from noise, all at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from ...calibration.report import patch_effect
from ...contact.membrane.equilibrium import LIMITS_PER_M, measured_curvature_per_m, usable_curvature_per_m
from ...contact.membrane.frame_bias import rig_bias
from ...contact.membrane.section import LARGEST_BIAS_M
from ...contact.membrane.steps import firm_contact_bias
from ...contact.pipeline import ContactPipeline
from ...contact.pressure.test import PRESSURE_SIGMAS
from ...errors import AdviceError, FrameError, PresetError, RigMismatchError, minus
from ...model.clouds import valid_depth
from ...preset import CONTACT_TESTS, Preset
from ...rig.bias import MeasuredBias, depth_differences, describe_bias, pressed_bias, print_bias, scene_bias
from ...sources.base import Progress, part_of
from .mask import suggest_mask
from .proposal import Evidence, Proposal

#: Smallest share of the tactile image with depth that tells whether a membrane is there.
_MIN_SEEN: Final = 0.1
#: A bias is mended beyond this number of standard deviations, and from this size on, metres.
_CERTAIN, _SMALLEST_M = 3.0, 0.0005
#: t covers this number of standard deviations of the noise of both depths: 95 % of the pixels.
_T_SIGMAS: Final = 2.0


def suggest_contact_test(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose membrane where an inflated membrane is seen, else tolerance; pressure for one camera."""
    preset, rig, frame = evidence.preset, evidence.rig, evidence.untouched or evidence.frame
    if not rig.has_proximity:
        return _propose_test(
            preset,
            "pressure",
            "The other contact tests compare two cameras, and this rig has one.",
            "Contact is where the membrane is flatter than in the untouched frame.",
        )
    if preset.alignment.model != "rigid":
        raise AdviceError("contact test: the membrane test needs the rigid alignment; choose it, or calibrate it")
    progress(0.2, "Looking for the membrane")
    seen = float(np.mean(valid_depth(frame.tactile_depth)))
    if seen < _MIN_SEEN:
        raise AdviceError(
            f"contact test: the tactile camera measures depth in only {100 * seen:.0f} % of its image; check the camera"
        )
    bias = scene_bias(*depth_differences(frame, preset, rig))
    curvature_per_m = usable_curvature_per_m(measured_curvature_per_m(frame, preset.alignment, rig))
    test, expected = "tolerance", "Pixels count as contact where both depths agree within t."
    if bias is not None:
        why = f"Both cameras see the same surface {bias.place}, so there is no membrane."
    elif curvature_per_m <= LIMITS_PER_M[0]:
        why = (
            "The tactile camera sees no inflated membrane: twice the mean curvature is at most "
            f"{LIMITS_PER_M[0]:g} per metre."
        )
    else:
        why = (
            "The pose of the cameras is known, and the tactile camera sees an inflated membrane (twice its mean "
            f"curvature is {curvature_per_m:.1f} per metre), so its equilibrium tells contact from a gap."
        )
        test = "membrane"
        expected = "Contact ends where a membrane in equilibrium leaves the object; tolerance and outliers are ignored."
    return _propose_test(preset, test, why, expected)


def _propose_test(preset: Preset, test: str, why: str, expected: str) -> Proposal:
    if preset.contact_test == test:
        return Proposal("contact_test", {}, f"Keep the {test} test", why, "Nothing changes.")
    return Proposal("contact_test", {"contact_test": test}, f"Contact test: {test}", why, expected)


def suggest_alignment(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the depth offset with which both cameras agree.

    The membrane test takes the tactile depth for true and subtracts a bias from the proximity depth, in each frame. For
    this test an offset that was not calibrated is proposed to be 0, unless the bias is larger than the test corrects.
    """
    preset, rig = evidence.preset, evidence.rig
    progress(0.1, "Comparing both depths")
    found = [scene_bias(*depth_differences(evidence.frame, preset, rig))]
    if found[0] is None:
        density_m4 = rig_bias(preset.noise, rig).noise_m4
        free = [frame for frame in (evidence.untouched, *evidence.frames) if frame is not None]
        progress(0.3, "Measuring the bias on prints")
        found.append(print_bias(free, rig, preset, density_m4))
        progress(0.6, "Measuring the bias in contact")
        found.append(pressed_bias(map(firm_contact_bias(preset, rig), evidence.frames), density_m4))
    best = min((bias for bias in found if bias is not None), key=lambda bias: bias.sigma_m, default=None)
    if found[0] is None and (noise := preset.noise) is not None and noise.bias_from != "unknown":
        # a few frames tell less than what was measured with the rig, unless they contradict it
        known = MeasuredBias(noise.bias_m, noise.bias_sigma_m, noise.bias_from, noise.bias_per_m)
        if best is None or abs(best.bias_m - known.bias_m) <= _CERTAIN * math.hypot(best.sigma_m, known.sigma_m):
            best = known
    if best is None:
        raise AdviceError(
            "alignment: a bias between the cameras can't be told from a gap here; set the mask to the colour of prints "
            "that reflect infrared, or press an object firmly (1,000 mm² or more)"
        )
    return propose_alignment(evidence, best)


def propose_alignment(evidence: Evidence, bias: MeasuredBias) -> Proposal:
    preset, section = evidence.preset, evidence.preset.alignment
    counts = evidence.frame.tactile_depth[valid_depth(evidence.frame.tactile_depth)]
    raw_m = float(np.median(counts)) * evidence.rig.tactile.depth_unit_m if len(counts) else 0.0
    without_m = bias.bias_m + section.depth_offset_m + (section.depth_scale - 1) * raw_m
    sentence = describe_bias(bias)
    if abs(bias.bias_m) <= max(_CERTAIN * bias.sigma_m, _SMALLEST_M):
        return _keep(sentence, "The cameras agree within the uncertainty; nothing changes.")
    corrects = preset.contact_test == "membrane" and preset.membrane.bias and abs(without_m) < LARGEST_BIAS_M
    if corrects and section.calibration is None and bias.origin != "scene":
        words = f"the membrane test corrects the remaining {_mm(without_m)} by itself."
        if section.depth_offset_m == 0 and section.depth_scale == 1:
            return _keep(sentence, f"Nothing changes: {words}")
        neutral = {"alignment.depth_offset_m": 0.0, "alignment.depth_scale": 1.0}
        return _propose_offset(evidence, neutral, raw_m, sentence, f"Tactile depth is used as measured; {words}")
    changes = {"alignment.depth_offset_m": section.depth_offset_m + bias.bias_m}
    try:
        preset.with_values(changes)
    except PresetError:
        return _keep(sentence, "No depth offset that a preset allows corrects it; check both depth units.")
    expected = f"Both depths agree within {1e3 * bias.sigma_m:.1f} mm on the same surface."
    return _propose_offset(evidence, changes, raw_m, sentence, expected)


def _propose_offset(
    evidence: Evidence, changes: dict[str, Any], raw_m: float, sentence: str, expected: str
) -> Proposal:
    """Round the values to 0.1 mm and four digits, and name those that change."""
    present = evidence.preset
    rounded = {path: round(float(value), 4) for path, value in changes.items()}
    changed: dict[str, Any] = {path: value for path, value in rounded.items() if value != present.value(path)}
    parts = []
    if (offset_m := changed.get("alignment.depth_offset_m")) is not None:
        parts.append(f"Depth offset {_mm(offset_m)}")
    if (scale := changed.get("alignment.depth_scale")) is not None:
        parts.append(f"Depth scale {scale:.4f}")
    if changed and (noise := present.noise) is not None and noise.bias_from != "unknown":
        # the bias that was measured with the rig holds after offset and scale, so it changes with them
        after = present.with_values(changed).alignment
        change_m = after.depth_offset_m - present.alignment.depth_offset_m
        change_m += (after.depth_scale - present.alignment.depth_scale) * raw_m
        changed["noise"] = noise.model_dump(mode="json") | {"bias_m": noise.bias_m - change_m}
    return Proposal("alignment", changed, ", ".join(parts), sentence, expected)


def _keep(sentence: str, expected: str) -> Proposal:
    return Proposal("alignment", {}, "Keep the depth offset", sentence, expected)


def _mm(metres: float) -> str:
    rounded = round(1e3 * metres, 1)
    return minus(f"{rounded:+.1f} mm") if rounded else "0 mm"


def suggest_tolerance(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the tolerance that the measured noise and the calibration's error ask for."""
    noise, section = evidence.preset.noise, evidence.preset.alignment
    if noise is None:
        raise AdviceError("tolerance: measure the noise of both cameras (F6, tactune preset measure-rig)")
    sigma_m = math.hypot(noise.proximity.total_m, noise.tactile.total_m)
    distance_m = noise.tactile.distance_m
    t = _T_SIGMAS * sigma_m / distance_m
    why = (
        f"The difference of both depths has a noise of {1e3 * sigma_m:.1f} mm at {1e3 * distance_m:.0f} mm distance; t "
        f"covers {_T_SIGMAS:g} standard deviations"
    )
    if (calibration := section.calibration) is not None and calibration.model == section.model:
        of_noise = patch_effect([0.0], [0.0], [distance_m])[1]  # the part of it that stands for both cameras' noise
        of_alignment = math.sqrt(max(calibration.quality.supported_tolerance**2 - of_noise**2, 0.0))
        t = math.hypot(t, of_alignment)
        if of_alignment > 0:
            why += f", and {100 * of_alignment:.2g} % of the distance that the calibrated alignment is off"
    expected = "Nearly all contact passes, and no larger gap than that requires."
    return _proposal(evidence, "tolerance.t", min(float(f"{t:.2g}"), 1.0), f"{why}.", expected)


def suggest_pressure(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the smallest pressure that the measured noise allows, as a share of the inflation."""
    preset, untouched = evidence.preset, evidence.untouched
    if preset.noise is None or untouched is None:
        lacks = ["capture the untouched frame"] if untouched is None else []
        lacks += ["measure the noise (F6, tactune preset measure-rig)"] if preset.noise is None else []
        raise AdviceError(f"pressure: {'; '.join(lacks)}")
    in_use = preset.with_value("contact_test", "pressure")
    facts = ContactPipeline(in_use, evidence.rig, untouched).process(untouched).pressure
    if facts is None or not math.isfinite(facts.relative_sigma):
        raise AdviceError("pressure: the untouched frame shows too little of the membrane; capture it again")
    limit = max(math.ceil(100 * PRESSURE_SIGMAS * facts.relative_sigma), 1) / 100
    return _proposal(
        evidence,
        "pressure.limit",
        limit,
        f"Noise explains pressures up to {limit:.2f} of the inflation, averaged over {2e3 * facts.window_m:.0f} mm.",
        "Nothing but noise is left out.",
    )


def _proposal(evidence: Evidence, path: str, value: float, sentence: str, expected: str) -> Proposal:
    section, name = path.partition(".")[0], {"tolerance.t": "tolerance t", "pressure.limit": "pressure limit"}[path]
    if value == evidence.preset.value(path):
        return Proposal(section, {}, f"Keep {name}", sentence, expected)
    return Proposal(section, {path: value}, f"{name[:1].upper()}{name[1:]} {100 * value:g} %", sentence, expected)


#: Makes the proposal of one section. Raises AdviceError if the evidence does not support one.
_SUGGEST: Final[dict[str, Callable[[Evidence, Progress], Proposal]]] = {
    "mask": suggest_mask,
    "contact_test": suggest_contact_test,
    "alignment": suggest_alignment,
    "tolerance": suggest_tolerance,
    "pressure": suggest_pressure,
}
#: Sections that a rig with one camera does not need.
_OF_TWO_CAMERAS: Final = ("mask", "alignment")
#: Sections of the preset that can be suggested, in the order in which they depend on each other.
SECTIONS: Final = tuple(_SUGGEST)


@dataclass(frozen=True)
class AllProposals:
    """Proposals for several sections, each with the earlier ones applied; why others have none; all changes in one."""

    parts: tuple[Proposal, ...]
    refusals: dict[str, str]
    merged: Proposal


def suggest_all(
    evidence: Evidence,
    progress: Progress = lambda share, words: None,
    sections: Collection[str] | None = None,
) -> AllProposals:
    """Propose new values for several sections of a preset, each with the earlier ones applied.

    Parameters
    ----------
    evidence : Evidence
        The preset, its rig, one or more frames (uint16 depth images of the rig's size in raw counts), and if there is
        one, the untouched frame.
    progress : callable, optional
        Called with the finished share, 0 to 1, and a description. What it raises ends the computation.
    sections : collection of str, optional
        Some of ``"mask"``, ``"contact_test"``, ``"alignment"``, ``"tolerance"`` and ``"pressure"``; default:
        all that the contact test reads, which may itself be proposed.

    Returns
    -------
    AllProposals
        ``result.merged.apply(preset)`` is the preset with all of them. A section that the evidence does not support is
        in ``result.refusals`` with the reason. Lengths in the changes are metres, areas mm^2.

    Raises
    ------
    AdviceError
        A section is unknown.
    FrameError
        The present frame has another size than the rig's.
    """
    evidence.frame.check_against(evidence.rig)
    if unknown := set(sections or ()) - set(SECTIONS):
        raise AdviceError(f"nothing is suggested for {', '.join(sorted(unknown))}; choose from {', '.join(SECTIONS)}")
    present, parts, refusals = evidence.preset, [], {}
    of_tests = {name for test in CONTACT_TESTS.values() for name in test.sections}
    unread = of_tests if evidence.rig.has_proximity else of_tests | set(_OF_TWO_CAMERAS)
    for number, section in enumerate(SECTIONS):
        is_read = section not in unread or section in evidence.preset.test.sections  # by the test proposed so far
        if not (is_read if sections is None else section in sections):
            continue
        try:
            proposal = _suggest(section, evidence, part_of(progress, number, len(SECTIONS)))
            evidence = replace(evidence, preset=proposal.apply(evidence.preset))
        except (AdviceError, FrameError, PresetError, RigMismatchError) as error:
            refusals[section] = str(error)
        else:
            parts.append(proposal)
    changes = {path: value for part in parts for path, value in part.changes.items() if present.value(path) != value}
    changed = [part for part in parts if part.changes]
    merged = Proposal(
        section="all",
        changes=changes,
        label=changed[0].label if len(changed) == 1 else f"All {len(changed)} suggestions" if changed else "No change",
        evidence=" ".join(part.evidence for part in changed),
        expected=" ".join(part.expected for part in changed),
    )
    progress(1.0, "The suggestions are ready")
    return AllProposals(tuple(parts), refusals, merged)


def _suggest(section: str, evidence: Evidence, progress: Progress) -> Proposal:
    """Make a proposal, and say how it changes the patch of the present frame."""
    if section in _OF_TWO_CAMERAS and not evidence.rig.has_proximity:
        raise AdviceError(f"{section}: it serves to compare two cameras, and this rig has one")
    proposal = _SUGGEST[section](evidence, progress)
    after_it = proposal.apply(evidence.preset)
    compared = evidence.rig.has_proximity or not evidence.preset.test.needs_proximity
    if not proposal.changes or not compared or (after_it.test.needs_untouched and evidence.untouched is None):
        return proposal
    pipeline = ContactPipeline(evidence.preset, evidence.rig, evidence.untouched)
    before = pipeline.process(evidence.frame).area_mm2
    pipeline.update(after_it)
    after = pipeline.process(evidence.frame).area_mm2
    words = f"The patch of the present frame changes from {before:,.0f} to {after:,.0f} mm²."
    return replace(proposal, expected=f"{proposal.expected} {words}")
