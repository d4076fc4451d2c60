"""The description of a contact test for presets, the panel, the search, messages and the Compare tab.

To add a test, write one file like `tolerance` with a subclass of `ContactTest`, and add one line to `_TESTS` in
`preset`. Preset files, their schema, the panel, the search, Compare and all messages read the object.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Generic, TypeVar

import numpy as np

from ..errors import counted
from ..model.arrays import Uint8Array
from ..model.provenance import Provenance
from .sections import Section

S = TypeVar("S", bound=Section)

#: Fields that the first step of every test depends on: which pixels and depths are compared at all.
PIXEL_FIELDS: Final = ("alignment.geometry", "region", "range", "mask")
#: Name of the step that averages depth over frames; it precedes the test's own steps.
AVERAGE: Final = "average"
#: Share of a test's limit up to which a bias between the cameras does no harm.
HARMLESS_SHARE: Final = 1 / 3


@dataclass(frozen=True)
class Step:
    """One step of a contact test.

    Attributes
    ----------
    name : str
        As in `ContactPatch.stage_ms`.
    fields : tuple of str
        Preset fields, sections or properties that decide its result, beyond those of the steps before it.
    """

    name: str
    fields: tuple[str, ...]


@dataclass(frozen=True)
class TestSection:
    """A section of the preset that only one contact test reads.

    Attributes
    ----------
    name : str
        Its field in the preset.
    title : str
        Its heading in the parameter panel.
    model : type of Section
    """

    name: str
    title: str
    model: type[Section]


@dataclass(frozen=True)
class DropReason:
    """Why a step drops points: the step, what to change if it drops too many, and the window's action for that."""

    step: str
    remedy: str
    action: str = ""


@dataclass(frozen=True)
class FusionVariant:
    """A choice of preset fields that Compare and tables offer as a method of its own.

    Attributes
    ----------
    name : str
        The method's name.
    fields : dict of str to object
        What it sets in a preset.
    tip : str
        One sentence for tooltips.
    rgb, dark_rgb : tuple of int
        Its colour on a light and on a dark background; without the latter they are the same.
    """

    name: str
    fields: Mapping[str, Any]
    tip: str
    rgb: tuple[int, int, int]
    dark_rgb: tuple[int, int, int] | None = None


@dataclass(frozen=True)
class BiasLimits:
    """Limits of a bias between the cameras, metres.

    Attributes
    ----------
    good_m : float
        Up to here it does no harm.
    fair_m : float
        Up to here contact is still found.
    reason : str
        Where the first limit comes from, in words.
    """

    good_m: float
    fair_m: float
    reason: str


class ContactTest(ABC, Generic[S]):
    """A contact test.

    Attributes
    ----------
    name : str
        As the preset's field ``contact_test`` has it; also the name of the test's first section.
    implementation : str
        ``"module:class"`` of the `ContactFinder` that computes it; imported when a pipeline is built.
    sections : tuple of TestSection
        Sections of the preset that no other test reads.
    steps : tuple of Step
        In order.
    summary : str
        One sentence for the tooltip of ``contact_test``.
    note : str
        One sentence below the choice in the panel.
    near_words, looser_words : str
        How messages call a point that reached the drop reasons' steps, and what makes the test accept more points.
    drop_reasons : dict of Provenance to DropReason
        For verdicts on points that were near the object.
    variants : tuple of FusionVariant
    frames_field : str
        The field with the number of averaged frames; empty for a test that uses single frames.
    unmasked_note, homography_note : str
        What to say of a preset that uses the test without the mask, or with a homography; empty for nothing.
    moves_points : bool
        Whether points lie elsewhere than the proximity depth says.
    """

    name: ClassVar[str]
    implementation: ClassVar[str]
    sections: ClassVar[tuple[TestSection, ...]]
    steps: ClassVar[tuple[Step, ...]]
    summary: ClassVar[str]
    note: ClassVar[str]
    near_words: ClassVar[str] = "passed the contact test"
    looser_words: ClassVar[str]
    drop_reasons: ClassVar[Mapping[Provenance, DropReason]]
    variants: ClassVar[tuple[FusionVariant, ...]] = ()
    frames_field: ClassVar[str] = ""
    unmasked_note: ClassVar[str] = ""
    homography_note: ClassVar[str] = ""
    moves_points: ClassVar[bool] = False

    @abstractmethod
    def accepted_share(self, section: S, distance_m: float) -> float:
        """Return the relative difference up to which both depths count as equal, at a distance in metres."""

    @abstractmethod
    def bias_limits(self, section: S, distance_m: float) -> BiasLimits:
        """Return the limits of a bias between the cameras for objects at a distance in metres."""

    def why_no_contact(self, provenance: Uint8Array) -> str:
        """Return which step dropped most of the points that were near the object, and what to change."""
        dropped = {verdict: int(np.count_nonzero(provenance == verdict)) for verdict in self.drop_reasons}
        total = sum(dropped.values())
        if total == 0:
            return f"No contact yet: press the object into the membrane, or {self.looser_words}"
        by = max(dropped, key=lambda verdict: dropped[verdict])
        reason = self.drop_reasons[by]
        share = f"{dropped[by]:,} of {total:,}" if dropped[by] < total else "all" if total > 1 else "it"
        points = counted(total, "point")
        return f"{points} {self.near_words}, but {reason.step} dropped {share}: {reason.remedy}"

    def remedy_action(self, provenance: Uint8Array) -> str:
        """Return the window's action that helps against the step that dropped most; empty if there is none."""
        dropped = {verdict: int(np.count_nonzero(provenance == verdict)) for verdict in self.drop_reasons}
        by = max(dropped, key=lambda verdict: dropped[verdict])
        return self.drop_reasons[by].action if dropped[by] else ""

    @property
    def step_names(self) -> tuple[str, ...]:
        """The names of the steps, in order."""
        return tuple(step.name for step in self.steps)

    @property
    def section_names(self) -> tuple[str, ...]:
        """The names of the sections."""
        return tuple(section.name for section in self.sections)


MASK_REASON: Final = DropReason("the mask", "correct if nothing touches; otherwise narrow its colour ranges")
