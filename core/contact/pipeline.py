"""The contact pipeline: one frame and a preset in, the contact patch out.

Follow a frame: `ContactPipeline.process` calls `find` of the preset's contact test (`tolerance`, `membrane.test`),
whose steps call the kernels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ..model.arrays import Uint16Array
from ..model.frames import Rig, SensorFrame
from ..model.patch import ContactPatch, Lazy
from ..model.rig_noise import CameraNoise, RigNoise
from .alignment import make_alignment
from .checks import check_rig, check_test, rig_in_use
from .contact_test import ContactTest, Steps
from .doubt import Judge
from .kernels import membrane as kernels
from .kernels.threads import in_parallel
from .pixels import Pixels, Workspace

if TYPE_CHECKING:
    from ..preset import Preset

__all__ = ["ContactPatch", "ContactPipeline"]

#: Side of the image blocks whose mean depth is compared with the average, pixels.
_SIDE_PX: Final = 32
#: A block has moved if its mean depth has changed by more than this share: 0.6 and 0.9 mm at 300 mm. The tactile limit
#: is the smaller one, so that a membrane and object that move together slowly restart both averages.
_TACTILE_MOVED, _PROXIMITY_MOVED = np.float32(0.002), np.float32(0.003)
#: Change of a block's mean that counts as noise, standard deviations of the noise of one frame.
_NOISE_SIGMAS: Final = 5.0
#: A single pixel restarts if it differs by more: 6 mm at 300 mm, several standard deviations of either camera.
_JUMP_SHARE = np.float32(0.02)


class AveragedDepth:
    """The running mean of both depth images, in which each new frame weighs at least 1 / ``max_frames``.

    The averages of both cameras restart together when the membrane moves, so both depths lag equally and their
    difference in contact stays unchanged. Objects that move behind a still membrane restart the proximity average
    alone. Where the measured noise is large, a larger change counts as movement.
    """

    def __init__(self, rig: Rig, frames: int, noise: RigNoise | None = None) -> None:
        self.max_frames = frames
        self._count = 0
        self._rig = rig
        self._proximity, self._tactile = _Means(rig.proximity.intrinsics.shape), _Means(rig.tactile.intrinsics.shape)
        self.expect(noise)

    def expect(self, noise: RigNoise | None) -> None:
        """Tell movement from this noise, or from the usual noise for None; the averages are kept."""
        self._proximity.moved_share, self._tactile.moved_share = _PROXIMITY_MOVED, _TACTILE_MOVED
        if noise is not None:
            proximity_px, tactile_px = self._rig.proximity.intrinsics.fx, self._rig.tactile.intrinsics.fx
            self._proximity.moved_share = max(_PROXIMITY_MOVED, _largest_change(noise.proximity, proximity_px))
            self._tactile.moved_share = max(_TACTILE_MOVED, _largest_change(noise.tactile, tactile_px))

    def add(self, frame: SensorFrame) -> SensorFrame:
        """Return the frame with mean depths; a pixel without depth keeps its earlier mean."""
        if self._tactile.moved(frame.tactile_depth):
            self._tactile.forget()
            self._proximity.forget()
            self._count = 0
        else:
            self._proximity.moved(frame.proximity_depth)
        self._count += 1
        return replace(
            frame,
            proximity_depth=self._proximity.add(frame.proximity_depth, self.max_frames),
            tactile_depth=self._tactile.add(frame.tactile_depth, self.max_frames),
        )

    @property
    def count(self) -> int:
        """Number of averaged frames."""
        return min(self._count, self.max_frames)


def _largest_change(noise: CameraNoise, focal_px: float) -> np.float32:
    """Return the largest change of a block's mean depth that noise explains, as a share of the depth."""
    side_m = _SIDE_PX * noise.distance_m / focal_px
    sigma_m = math.sqrt(noise.changing_share * noise.density_m4(focal_px)) / side_m
    return np.float32(min(_NOISE_SIGMAS * sigma_m / noise.distance_m, 1.0))


class _Means:
    """The mean of one camera's depth, in counts, and its number of frames per pixel; 0 without depth."""

    moved_share: np.float32  # A block has moved if its mean depth has changed by more than this share

    def __init__(self, shape: tuple[int, int]) -> None:
        self._mean, self._frames = np.zeros(shape, np.float32), np.zeros(shape, np.float32)

    def moved(self, counts: Uint16Array) -> bool:
        """Forget the blocks that have moved; return whether any has."""
        return bool(kernels.forget_moved(counts, self._mean, self._frames, _SIDE_PX, self.moved_share, _JUMP_SHARE))

    def forget(self) -> None:
        self._frames[:] = 0

    def add(self, counts: Uint16Array, max_frames: int) -> Uint16Array:
        mean = np.empty_like(counts)

        def add_rows(first: int, last: int) -> None:
            parts = (image[first:last] for image in (counts, self._mean, self._frames, mean))
            kernels.add_to_means(*parts, np.float32(max_frames), _JUMP_SHARE)

        in_parallel(add_rows, len(counts))
        return mean


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
        The rig that records the frames; a lens distortion that the preset's calibration estimated is added to it.
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
        With the preset's lens distortion.
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
        self._recording_rig, self.untouched, self.cameras_moved = rig, untouched, False
        self._start(preset, rig_in_use(preset, rig))

    def _start(self, preset: Preset, rig: Rig) -> None:
        check_test(preset, rig)
        self.warnings, self._alignment = check_rig(preset, self._recording_rig), make_alignment(preset.alignment, rig)
        self.rig, self.preset = rig, preset
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
        rig = rig_in_use(preset, self._recording_rig)
        if rig != self.rig:  # other lenses: nothing computed so far can be kept
            self._start(preset, rig)
            return
        check_test(preset, rig)
        warnings = check_rig(preset, self._recording_rig)
        if preset.alignment.geometry != self.preset.alignment.geometry:
            self._alignment = make_alignment(preset.alignment, rig)
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
        doubt_of = Judge(test.pixels, self.cameras_moved).doubts(frame, self.preset, found.membrane, found.pressure)
        if memory.patch is not None and not due.stale:
            return memory.patch.again(frame.sequence, due.ms, (UNCHANGED,), doubt_of)
        memory.patch = ContactPatch(
            frame.sequence,
            found.contact.points,
            Lazy(found.make_provenance),
            Lazy(lambda: test.pixels.aligned(frame)),
            self.rig,
            due.ms,
            found.skipped,
            mask=Lazy(lambda: found.contact.mask(self.rig.proximity.intrinsics.shape)),
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
