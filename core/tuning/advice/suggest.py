"""Proposals for the sections of a preset, one at a time or all at once."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from ...contact.membrane.tension import LIMITS_PER_M, free_curvature_per_m
from ...contact.pipeline import ContactPipeline
from ...errors import AdviceError, FrameError, PresetError, RigMismatchError
from ...model.clouds import valid_depth
from ...preset import CONTACT_TESTS, Preset
from ...rig.bias import depth_differences, scene_bias
from ...sources.base import Progress, part_of
from .alignment import suggest_alignment
from .fields import suggest_fields
from .mask import suggest_mask
from .proposal import Evidence, Proposal

#: Smallest share of the tactile image with depth that tells whether a membrane is there.
_MIN_SEEN: Final = 0.1


def suggest_contact_test(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the membrane test where an inflated membrane is seen, else the tolerance test."""
    preset, rig, frame = evidence.preset, evidence.rig, evidence.untouched or evidence.frame
    if preset.alignment.model != "rigid":
        raise AdviceError(
            "contact test: the membrane test needs the rigid alignment, and this preset uses a homography; choose "
            "rigid, or calibrate it"
        )
    progress(0.2, "Looking for the membrane")
    seen = float(np.mean(valid_depth(frame.tactile_depth)))
    if seen < _MIN_SEEN:
        raise AdviceError(
            f"contact test: the tactile camera measures depth in {100 * seen:.0f} % of its image only, so nothing "
            "tells whether a membrane is there; check the camera"
        )
    bias = scene_bias(*depth_differences(frame, preset, rig))
    curvature_per_m = free_curvature_per_m(frame, preset.alignment, rig)
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
    if preset.contact_test == test:
        return Proposal("contact_test", {}, f"Keep the {test} test", why, "Nothing changes.")
    return Proposal("contact_test", {"contact_test": test}, f"Contact test: {test}", why, expected)


#: Makes the proposal of one section. Raises AdviceError if the evidence does not support one.
_SUGGEST: Final[dict[str, Callable[[Evidence, Progress], Proposal]]] = {
    "mask": suggest_mask,
    "contact_test": suggest_contact_test,
    "alignment": suggest_alignment,
    "tolerance": partial(suggest_fields, "tolerance"),
    "outliers": partial(suggest_fields, "outliers"),
    "membrane": partial(suggest_fields, "membrane"),
}
#: Sections of the preset that can be suggested, in the order in which they depend on each other.
SECTIONS: Final = tuple(_SUGGEST)


@dataclass(frozen=True)
class AllProposals:
    """Proposals for several sections, each computed with the earlier ones applied.

    ``refusals`` says by section why there is none; ``merged`` has all changes as one proposal.
    """

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
        The preset, its rig, one or more frames (uint16 depth images of the rig's size in raw counts), and if there are
        any, the untouched frame and examples of contact.
    progress : callable, optional
        Called with the finished share, 0 to 1, and a description. What it raises ends the computation.
    sections : collection of str, optional
        Some of ``"mask"``, ``"contact_test"``, ``"alignment"``, ``"tolerance"``, ``"outliers"`` and ``"membrane"``;
        default: all that the contact test reads, which may itself be proposed.

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
        raise AdviceError(
            f"there are no suggestions for {', '.join(sorted(unknown))}; choose from {', '.join(SECTIONS)}"
        )
    present, parts, refusals = evidence.preset, [], {}
    for number, section in enumerate(SECTIONS):
        if section not in (_read_sections(evidence.preset) if sections is None else sections):
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
    proposal = _SUGGEST[section](evidence, progress)
    if not proposal.changes:
        return proposal
    pipeline = ContactPipeline(evidence.preset, evidence.rig)
    before = pipeline.process(evidence.frame).area_mm2
    pipeline.update(proposal.apply(evidence.preset))
    after = pipeline.process(evidence.frame).area_mm2
    words = f"The patch of the present frame changes from {before / 100:.1f} to {after / 100:.1f} cm²."
    return replace(proposal, expected=f"{proposal.expected} {words}")


def _read_sections(preset: Preset) -> set[str]:
    """Return the sections that the preset's contact test reads."""
    of_tests = {name for test in CONTACT_TESTS.values() for name in test.sections}
    return set(SECTIONS) - of_tests | set(preset.test.sections)
