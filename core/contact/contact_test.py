"""The interface of a contact test: what it is called and depends on, and how it finds contact in a frame.

To add a test, write one file like `tolerance`, and add a line to `CONTACT_TESTS` and its name and sections to `Preset`.
The panel, the search and all messages read the class.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import numpy as np

from ..errors import counted
from ..model.arrays import Uint8Array
from ..model.frames import SensorFrame
from ..model.patch import Found, Provenance
from ..model.sections import Section

if TYPE_CHECKING:  # the preset reads this module to know its sections; kernels load with the first pipeline
    from ..preset import Preset
    from .pixels import Pixels

#: Fields that the first step of every test depends on: which pixels and depths are compared at all.
PIXEL_FIELDS: Final = ("alignment.geometry", "region", "range", "mask")
#: Share of a test's limit up to which a bias between the cameras does no harm.
HARMLESS_SHARE: Final = 1 / 3
_NEVER_RUN = object()


class DropReason(NamedTuple):
    """Why a step drops points: the step, what to change if it drops too many, and the window's action for that."""

    step: str
    remedy: str
    action: str = ""


MASK_REASON: Final = DropReason("the mask", "narrow the mask's colour ranges")


class BiasLimits(NamedTuple):
    """A bias between the cameras is harmless up to ``good_m``; up to ``fair_m`` contact is found."""

    good_m: float = math.inf
    fair_m: float = math.inf


class Steps:
    """Tells which steps of a frame are due, and times them.

    A step is due if the frame is new, one of its preset fields has changed, or an earlier step has run. Its time ends
    when the next step is asked for::

        if due("outliers"):
            self._inliers = drop_outliers(...)

    ``keys`` are the values of each step's preset fields, in the order of the steps; ``done`` those with which steps
    have run on this frame, which is updated.
    """

    def __init__(self, keys: dict[str, Any], done: dict[str, Any]) -> None:
        self._keys = keys
        self._done = done
        self._running = ""
        self._started_ns = 0
        self.stale = False  # Whether a step has run
        self.ms = dict.fromkeys(keys, 0.0)  # Milliseconds of each step; 0 for a step that was not due

    def __call__(self, name: str) -> bool:
        """Return whether a step is due; if so, start its clock."""
        self.finish()
        if not self.stale and self._done.get(name, _NEVER_RUN) == self._keys[name]:
            return False
        self.stale = True
        self._done.pop(name, None)  # until it has finished
        self._running, self._started_ns = name, time.perf_counter_ns()
        return True

    def finish(self) -> None:
        """End the time of the step that runs."""
        if self._running:
            self.ms[self._running] = (time.perf_counter_ns() - self._started_ns) / 1e6
            self._done[self._running] = self._keys[self._running]
            self._running = ""


class ContactTest(ABC):
    """A contact test. The class describes it; an object finds contact in frames, for one thread at a time.

    A new object is made when a field of the first step changes; later fields are read in `find`.

    Attributes
    ----------
    name : str
        As the preset's field ``contact_test`` has it.
    sections : dict of str to type of Section
        Sections of the preset that no other test reads.
    steps : dict of str to tuple of str
        Steps in order, as in `ContactPatch.stage_ms`. Each has the preset fields, sections or properties that decide
        its result, beyond those of the steps before it.
    summary, note : str
        One sentence for the tooltip of ``contact_test``, and one below the choice in the panel.
    looser_words : str
        What makes the test accept more points, for messages.
    drop_reasons : dict of Provenance to DropReason
        For verdicts on points that were near the object.
    frames_field : str
        The field with the number of averaged frames; empty for a test that uses single frames.
    smallest_field : str
        The field with the smallest contact, in mm2.
    unmasked_note, homography_note : str
        What to say of a preset that uses the test without the mask, or with a homography; empty for nothing.
    moves_points : bool
        Whether points lie elsewhere than the proximity depth says.
    needs_proximity, needs_untouched : bool
        Whether the test compares two cameras, and whether it compares with the untouched frame.
    """

    name: ClassVar[str]
    sections: ClassVar[Mapping[str, type[Section]]]
    steps: ClassVar[Mapping[str, tuple[str, ...]]]
    summary: ClassVar[str]
    note: ClassVar[str]
    looser_words: ClassVar[str]
    drop_reasons: ClassVar[Mapping[Provenance, DropReason]]
    frames_field: ClassVar[str] = ""
    smallest_field: ClassVar[str]
    unmasked_note: ClassVar[str] = ""
    homography_note: ClassVar[str] = ""
    moves_points: ClassVar[bool] = False
    needs_proximity: ClassVar[bool] = True
    needs_untouched: ClassVar[bool] = False

    def __init__(self, pixels: Pixels) -> None:
        self.pixels = pixels

    @abstractmethod
    def find(self, frame: SensorFrame, preset: Preset, due: Steps) -> Found:
        """Return the contact in a frame; run only the steps that are due."""

    @classmethod
    def accepted_share(cls, preset: Preset, distance_m: float) -> float:
        """Return the relative difference up to which both depths count as equal, at a distance in metres; 0: none."""
        return 0.0

    @classmethod
    def bias_limits(cls, preset: Preset, distance_m: float) -> BiasLimits:
        """Return the limits of a bias between the cameras for objects at a distance in metres; none by default."""
        return BiasLimits()

    @classmethod
    def why_no_contact(cls, provenance: Uint8Array) -> tuple[str, str]:
        """Say which step dropped most of the points near the object and what to change; name the window's action."""
        dropped = {verdict: int(np.count_nonzero(provenance == verdict)) for verdict in cls.drop_reasons}
        total, press = sum(dropped.values()), "No contact yet: press the object into the membrane"
        if total == 0:
            return f"{press}, or {cls.looser_words}", ""
        by = max(dropped, key=lambda verdict: dropped[verdict])
        reason = cls.drop_reasons[by]
        left_out = f"{dropped[by]:,} of {counted(total, 'point')} that could touch"
        return f"{press}. If something presses, {reason.remedy}: {reason.step} left out {left_out}", reason.action
