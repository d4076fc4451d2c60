"""The contact pipeline: one frame and a preset in, the contact patch out."""

from __future__ import annotations

from dataclasses import dataclass, field
from pkgutil import resolve_name
from typing import Any

from ..model.frames import Rig, SensorFrame
from ..model.patch import ContactPatch, Lazy
from ..preset import Preset
from ..preset.checks import check_rig, rig_in_use
from ..preset.contact_test import AVERAGE
from .alignment import make_alignment
from .finder import ContactFinder, Steps, Workspace
from .membrane.average import AveragedDepth

__all__ = ["ContactPatch", "ContactPipeline"]

#: Value of `ContactPatch.skipped` where no step was due.
UNCHANGED = "nothing changed"


class ContactPipeline:
    """Finds the contact patch of one frame after another, by the contact test that the preset chooses.

    Steps are cached: processing the same frame again, or a preset that differs in a late step only, repeats nothing
    that comes before. Each thread needs a pipeline of its own.

    Parameters
    ----------
    preset : Preset
    rig : Rig
        The rig that records the frames; a lens distortion that the preset's calibration estimated is added to it.

    Raises
    ------
    RigMismatchError
        The preset was made for images of another size, or neither it nor the rig has a pose.
    """

    def __init__(self, preset: Preset, rig: Rig) -> None:
        self._recording_rig = rig
        self._start(preset)

    def _start(self, preset: Preset) -> None:
        """Start with a preset. Where the rig states no lens distortion, the one that the preset estimated is used."""
        rig = rig_in_use(preset, self._recording_rig)
        warnings, alignment = check_rig(preset, self._recording_rig), make_alignment(preset.alignment, rig)  # may raise
        self.rig, self.warnings, self._alignment, self._preset = rig, warnings, alignment, preset
        self._workspace = Workspace(rig)
        self._keys = _step_keys(preset)
        self._finder: ContactFinder | None = None
        self._finder_key: Any = None
        self._memory = _Memory()
        self._average: AveragedDepth | None = None
        self._average_over(preset)

    @property
    def preset(self) -> Preset:
        """The current preset; change it with `update`."""
        return self._preset

    def update(self, preset: Preset) -> None:
        """Use another preset from the next frame on.

        Raises
        ------
        RigMismatchError
            As the constructor does; the old preset then stays in use.
        """
        if rig_in_use(preset, self._recording_rig) != self.rig:  # other lenses: nothing computed so far can be kept
            self._start(preset)
            return
        warnings = check_rig(preset, self._recording_rig)
        if preset.alignment.geometry != self._preset.alignment.geometry:
            self._alignment = make_alignment(preset.alignment, self.rig)
        self._average_over(preset)
        self._keys = _step_keys(preset)
        self.warnings = warnings
        self._preset = preset

    def process(self, frame: SensorFrame) -> ContactPatch:
        """Return the contact patch of a frame.

        Raises
        ------
        FrameError
            An image does not have the rig's size.
        """
        memory = self._memory
        if frame is not memory.frame:
            frame.check_against(self.rig)
            memory = self._memory = _Memory(frame)
        due = Steps(self._keys, memory.done)
        if self._average is not None:
            if due(AVERAGE):
                memory.averaged = self._average.add(frame)
            frame = memory.averaged or frame
        found = self._finder_now().find(frame, self._preset, due)
        due.finish()
        if memory.patch is not None and not due.stale:
            return memory.patch.again(frame.sequence, due.ms, (UNCHANGED,))
        alignment, region = self._alignment, self._preset.region
        memory.patch = ContactPatch(
            frame.sequence,
            found.contact.points,
            Lazy(found.make_provenance),
            Lazy(lambda: self._workspace.aligned(frame, alignment, region)),
            self.rig,
            due.ms,
            found.skipped,
            mask=Lazy(lambda: found.contact.mask(self.rig.proximity.intrinsics.shape)),
            averaged_frames=self._average.count if self._average is not None else 1,
            membrane=found.membrane,
        )
        return memory.patch

    def _finder_now(self) -> ContactFinder:
        """Return the finder of the preset's contact test; a new one if a field of its first step has changed."""
        key = self._keys[self._preset.test.steps[0].name]
        if self._finder is None or key != self._finder_key:
            make = resolve_name(self._preset.test.implementation)
            self._finder = make(self._preset, self.rig, self._alignment, self._workspace)
            self._finder_key = key
            for name in self._preset.test.step_names:  # the finder that was replaced kept their results
                self._memory.done.pop(name, None)
        return self._finder

    def _average_over(self, preset: Preset) -> None:
        """Average depth over the preset's number of frames; the frames so far are kept unless it is 1."""
        frames = preset.averaged_frames
        if frames == 1:
            if self._average is not None:
                self._average, self._memory = None, _Memory()
        elif self._average is None:
            self._average = AveragedDepth(self.rig, frames, preset.noise)
        else:
            self._average.max_frames = frames
            self._average.expect(preset.noise)


@dataclass
class _Memory:
    """The present frame, which steps have run on it with which fields, and its patch."""

    frame: SensorFrame | None = None
    averaged: SensorFrame | None = None
    done: dict[str, Any] = field(default_factory=dict)
    patch: ContactPatch | None = None


def _step_keys(preset: Preset) -> dict[str, Any]:
    """Return the values of the fields that each step of the preset's contact test depends on."""
    keys: dict[str, Any] = {AVERAGE: None} if preset.averaged_frames > 1 else {}
    for step in preset.test.steps:
        keys[step.name] = preset.contact_test, *(preset.value(path) for path in step.fields)
    return keys
