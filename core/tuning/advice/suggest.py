"""Proposals for the sections of a preset, one at a time or all at once."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Final

from ...contact.pipeline import ContactPipeline
from ...errors import AdviceError, FrameError, PresetError, RigMismatchError
from ...preset import CONTACT_TESTS, Preset
from ...sources.base import Progress, part_of
from .alignment import suggest_alignment
from .contact_test import suggest_contact_test
from .fields import suggest_membrane, suggest_outliers, suggest_tolerance
from .mask import suggest_mask
from .proposal import Evidence, Proposal

#: Makes the proposal of one section. Raises AdviceError if the evidence does not support one.
Suggest = Callable[[Evidence, Progress], Proposal]

_SUGGEST: Final[dict[str, Suggest]] = {
    "mask": suggest_mask,
    "contact_test": suggest_contact_test,
    "alignment": suggest_alignment,
    "tolerance": suggest_tolerance,
    "outliers": suggest_outliers,
    "membrane": suggest_membrane,
}
#: Sections of the preset that can be suggested, in the order in which they depend on each other.
SECTIONS: Final = tuple(_SUGGEST)


@dataclass(frozen=True)
class AllProposals:
    """Proposals for every section that the contact test reads.

    Attributes
    ----------
    parts : tuple of Proposal
        In order; each is computed with the earlier ones applied. Parts without changes keep the present values.
    refusals : dict of str to str
        Why there is no proposal, by section.
    merged : Proposal
        All changes as one proposal; without changes if no part has any.
    """

    parts: tuple[Proposal, ...]
    refusals: dict[str, str]
    merged: Proposal


def suggest(section: str, evidence: Evidence, progress: Progress = lambda share, words: None) -> Proposal:
    """Propose new values for one section of the preset.

    Parameters
    ----------
    section : str
        One of `SECTIONS`.
    evidence : Evidence
    progress : callable, optional
        Called with the finished share, 0 to 1, and a description. What it raises ends the computation.

    Raises
    ------
    AdviceError
        The section is unknown, or the evidence does not support a proposal; the message says why and what to do.
    FrameError, RigMismatchError
        A frame has another size than the rig's, or neither preset nor rig has a pose.
    """
    _check(evidence, (section,))
    proposal = _suggest(section, evidence, progress)
    progress(1.0, "The suggestion is ready")
    return proposal


def suggest_all(
    evidence: Evidence,
    progress: Progress = lambda share, words: None,
    sections: Collection[str] | None = None,
) -> AllProposals:
    """Propose new values for several sections, each with the earlier ones applied.

    Parameters
    ----------
    evidence : Evidence
    progress : callable, optional
        As for `suggest`.
    sections : collection of str, optional
        Some of `SECTIONS`; default: all that the contact test reads, which may itself be proposed.

    Raises
    ------
    AdviceError
        A section is unknown.
    FrameError
        The present frame has another size than the rig's.
    """
    _check(evidence, sections or ())
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
        weak=any(part.weak for part in changed),
    )
    progress(1.0, "The suggestions are ready")
    return AllProposals(tuple(parts), refusals, merged)


def _check(evidence: Evidence, sections: Collection[str]) -> None:
    evidence.frame.check_against(evidence.rig)
    if unknown := set(sections) - set(SECTIONS):
        raise AdviceError(
            f"there are no suggestions for {', '.join(sorted(unknown))}; choose from {', '.join(SECTIONS)}"
        )


def _suggest(section: str, evidence: Evidence, progress: Progress) -> Proposal:
    proposal = _SUGGEST[section](evidence, progress)
    if not proposal.changes:
        return proposal
    return replace(proposal, expected=f"{proposal.expected} {_patch_change(evidence, proposal)}")


def _read_sections(preset: Preset) -> set[str]:
    """Return the sections that the preset's contact test reads."""
    of_tests = {name for test in CONTACT_TESTS.values() for name in test.sections}
    return set(SECTIONS) - of_tests | set(preset.test.sections)


def _patch_change(evidence: Evidence, proposal: Proposal) -> str:
    """Return how the patch of the present frame changes, as a sentence."""
    pipeline = ContactPipeline(evidence.preset, evidence.rig)
    before = pipeline.process(evidence.frame).area_mm2
    pipeline.update(proposal.apply(evidence.preset))
    after = pipeline.process(evidence.frame).area_mm2
    return f"The patch of the present frame changes from {before / 100:.1f} to {after / 100:.1f} cm²."
