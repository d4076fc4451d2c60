"""The contact pipeline: one frame and a preset in, the contact patch out.

Follow a frame: `ContactPipeline.process` calls `find` of the preset's contact test (`tolerance`, `membrane.test`),
whose steps call the kernels.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

from ..model.frames import Rig, SensorFrame
from ..model.patch import ContactPatch, Lazy
from .alignment import make_alignment
from .average import AveragedDepth
from .checks import check_rig, check_test
from .contact_test import ContactTest, Steps
from .doubt import DoubtEstimator
from .pixels import Pixels, Workspace

if TYPE_CHECKING:
    from ..preset import Preset

__all__ = ["ContactPatch", "ContactPipeline"]

#: Name of the step that averages depth over frames; it precedes the test's own steps.
AVERAGE: Final = "average"
#: Value of `ContactPatch.skipped` where no step was due.
UNCHANGED: Final = "nothing changed"


class ContactPipeline:
    """Finds the contact patch of one frame after another, by the contact test that the preset chooses.

    Steps are cached: processing the same frame again, or a preset that differs in a late step only, repeats nothing
    that comes before. Each thread needs a pipeline of its own.

    Parameters
    ----------
    preset : Preset
    rig : Rig
        The rig that records the frames.
    untouched : SensorFrame, optional
        The untouched membrane, for a contact test that compares with it, for the doubt about contact, and to find the
        prints again in other light.

    Raises
    ------
    RigMismatchError
        The preset was made for images of another size, or neither it nor the rig has a pose.
    FrameError
        The untouched frame does not have the rig's size.

    Attributes
    ----------
    rig : Rig
    preset : Preset
        The current one; change it with `update`.
    untouched : SensorFrame or None
    cameras_moved : bool
        Whether a check for drift found that a camera has moved: the patches' doubt then says so. Set it at any time.
    warnings : list of str
        Sentences on differences between the preset's rig and this one.
    """

    def __init__(self, preset: Preset, rig: Rig, untouched: SensorFrame | None = None) -> None:
        if untouched is not None:
            untouched.check_against(rig)
        check_test(preset, rig)
        self.warnings, self._alignment = check_rig(preset, rig), make_alignment(preset.alignment, rig)
        self.rig, self.preset, self.untouched, self.cameras_moved = rig, preset, untouched, False
        self._workspace, self._memory = Workspace(rig), _Memory()
        self._average: AveragedDepth | None = None
        self._test_key: Any = None
        self._use(preset)

    def update(self, preset: Preset) -> None:
        """Use another preset from the next frame on.

        Raises
        ------
        RigMismatchError
            As the constructor does; the old preset then stays in use.
        """
        check_test(preset, self.rig)
        warnings = check_rig(preset, self.rig)
        if preset.alignment.geometry != self.preset.alignment.geometry:
            self._alignment = make_alignment(preset.alignment, self.rig)
        self.warnings, self.preset = warnings, preset
        self._use(preset)

    def _use(self, preset: Preset) -> None:
        """Keep the average and the test as far as the preset allows."""
        frames = preset.averaged_frames
        if frames == 1 and self._average is not None:
            self._average, self._memory = None, _Memory()
        elif frames > 1 and self._average is None:
            self._average = AveragedDepth(self.rig, frames, preset.noise)
        elif self._average is not None:
            self._average.max_frames = frames
            self._average.expect(preset.noise)
        steps = preset.test.steps
        self._keys: dict[str, Any] = {AVERAGE: None} if frames > 1 else {}
        self._keys |= {name: (preset.contact_test, *map(preset.value, fields)) for name, fields in steps.items()}
        first_key = self._keys[next(iter(steps))]
        if first_key != self._test_key:
            self._test: ContactTest = preset.test(
                Pixels(preset, self.rig, self._alignment, self._workspace, self.untouched)
            )
            self._test_key = first_key
            for name in steps:  # the test that was replaced kept their results
                self._memory.done.pop(name, None)

    def process(self, frame: SensorFrame) -> ContactPatch:
        """Return the contact patch of a frame.

        Raises
        ------
        FrameError
            An image does not have the rig's size.
        """
        if frame is not self._memory.frame:
            frame.check_against(self.rig)
            self._memory = _Memory(frame)
        memory, test, due = self._memory, self._test, Steps(self._keys, self._memory.done)
        if self._average is not None:
            if due(AVERAGE):
                memory.averaged = self._average.add(frame)
            frame = memory.averaged or frame
        found = test.find(frame, self.preset, due)
        due.finish()
        estimator = DoubtEstimator(test.pixels, self.cameras_moved)
        doubt_of = estimator.doubts(frame, self.preset, found.membrane, found.pressure)
        if memory.patch is not None and not due.stale:
            return replace(
                memory.patch, sequence=frame.sequence, stage_ms=due.ms, skipped=(UNCHANGED,), doubt_of=doubt_of
            )
        memory.patch = ContactPatch(
            frame.sequence,
            found.contact.points,
            Lazy(found.make_provenance),
            Lazy(lambda: test.pixels.aligned(frame)),
            self.rig,
            due.ms,
            found.skipped,
            made_mask=Lazy(lambda: found.contact.mask(self.rig.proximity.intrinsics.shape)),
            averaged_frames=self._average.count if self._average is not None else 1,
            membrane=found.membrane,
            pressure=found.pressure,
            mask_colors=Lazy(lambda: test.pixels.mask_colors(frame)),
            doubt_of=doubt_of,
        )
        return memory.patch


@dataclass
class _Memory:
    """The present frame, which steps have run on it with which fields, and its patch."""

    frame: SensorFrame | None = None
    averaged: SensorFrame | None = None
    done: dict[str, Any] = field(default_factory=dict)
    patch: ContactPatch | None = None
