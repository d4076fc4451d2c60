"""The protocol of the two processes: pickled messages over a socket pair, images in shared memory.

The memory is cut into slots; each slot holds the images of one frame. It has no name: it is an anonymous or unlinked
file whose descriptor the capture process inherits, so the system frees it when both processes have ended. Messages
pass the ownership of a slot: the capture process announces it after writing, and the parent returns it after copying.
No slot is therefore read while it is being written.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from ... import errors
from ...errors import FrameError, SourceError, TactuneError
from ...model.arrays import AnyArray
from ...model.frames import GroundTruth, Rig, SensorFrame, rigid_transform
from ..base import FrameSource, Health, Progress

#: Opens a source in the capture process; a function of a module, or `functools.partial` of one.
Opener = Callable[[Progress], FrameSource]

#: Number of slots: the queued frames, one that is being written and one that is being copied.
SLOTS = 8

#: Interval of the capture process's heartbeats, seconds.
HEARTBEAT_S = 0.2
_ALIGNMENT: Final = 64
_POSE_BYTES: Final = 16 * 8


@dataclass(frozen=True)
class Start:
    """To the capture process, first: what to open, and whether to wait instead of dropping a frame."""

    opener: Opener
    lossless: bool


@dataclass(frozen=True)
class GiveBack:
    """To the capture process: this slot has been copied."""

    slot: int


@dataclass(frozen=True)
class Call:
    """To the capture process: call this method of the source and reply."""

    number: int
    method: str
    arguments: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Opening:
    """From the capture process: progress of opening, 0 to 1."""

    fraction: float
    text: str


@dataclass(frozen=True)
class Opened:
    """From the capture process: the source is open and the shared memory is allocated."""

    name: str
    rig: Rig
    frame_rate_hz: float
    health: Health
    slot_bytes: int


class ArrayPlace(NamedTuple):
    """Where one array lies in a slot: byte offset, type and shape."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    offset: int


@dataclass(frozen=True)
class FrameReady:
    """From the capture process: a slot holds a frame; ``dropped`` counts frames without a free slot."""

    slot: int
    places: tuple[ArrayPlace, ...]
    sequence: int
    proximity_time_s: float
    tactile_time_s: float
    dropped: int


@dataclass(frozen=True)
class Heartbeat:
    """From the capture process, regularly: the source's health, and how long its present call has lasted."""

    health: Health
    busy_s: float


@dataclass(frozen=True)
class Reply:
    """From the capture process: what a call returned, or how it failed."""

    number: int
    value: Any = None
    failure: Failure | None = None


@dataclass(frozen=True)
class Ended:
    """From the capture process, last: the source has no more frames."""


@dataclass(frozen=True)
class Failure:
    """From the capture process: an error. As a message of its own, it is the last one."""

    kind: str
    sentence: str

    @classmethod
    def of(cls, error: Exception, what: str) -> Failure:
        """Describe an error; ``what`` introduces one that is no `TactuneError`."""
        if isinstance(error, TactuneError):
            return cls(type(error).__name__, str(error))
        return cls(SourceError.__name__, f"{what} ({type(error).__name__}: {error})")

    def error(self) -> TactuneError:
        """Return an error of the same class and sentence."""
        kind = getattr(errors, self.kind, SourceError)
        made: TactuneError = kind(self.sentence)
        return made


def arrays_of(frame: SensorFrame) -> dict[str, AnyArray]:
    """Return the arrays of a frame by name; those of its truth as ``truth.NAME``."""
    arrays: dict[str, AnyArray | None] = {
        "proximity_depth": frame.proximity_depth,
        "tactile_depth": frame.tactile_depth,
        "proximity_color": frame.proximity_color,
        "tactile_color": frame.tactile_color,
    }
    if frame.truth is not None:
        pose = frame.truth.T_proximity_object
        arrays |= {
            "truth.contact": frame.truth.contact,
            "truth.depth_m": frame.truth.depth_m,
            "truth.T_proximity_object": None if pose is None else np.array(pose),
        }
    return {name: array for name, array in arrays.items() if array is not None}


def frame_of(ready: FrameReady, arrays: dict[str, AnyArray]) -> SensorFrame:
    """Return the frame of these arrays; the inverse of `arrays_of`."""
    truth = None
    if "truth.contact" in arrays:
        for name in ("truth.contact", "truth.depth_m"):
            if name in arrays:
                arrays[name].flags.writeable = False
        pose = arrays.get("truth.T_proximity_object")
        truth = GroundTruth(
            arrays["truth.contact"],
            arrays.get("truth.depth_m"),
            T_proximity_object=None if pose is None else rigid_transform(pose),
        )
    return SensorFrame(
        sequence=ready.sequence,
        proximity_depth=arrays["proximity_depth"],
        tactile_depth=arrays["tactile_depth"],
        proximity_color=arrays["proximity_color"],
        tactile_color=arrays.get("tactile_color"),
        proximity_time_s=ready.proximity_time_s,
        tactile_time_s=ready.tactile_time_s,
        truth=truth,
    )


def create_memory() -> int:
    """Return the descriptor of an empty, nameless file in memory."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("tactune-frames", os.MFD_CLOEXEC)
    with tempfile.TemporaryFile(prefix="tactune-frames-") as file:
        return os.dup(file.fileno())


def reserve_memory(descriptor: int, size: int) -> None:
    """Allocate the file's memory, so that a lack of memory is an error here and not a crash later.

    Raises
    ------
    SourceError
        There is not enough memory.
    """
    try:
        os.ftruncate(descriptor, size)
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(descriptor, 0, size)
    except OSError as error:
        raise SourceError(
            f"there are no {size / 1e6:.0f} MB of shared memory for the frames ({error.strerror}); close other programs"
        ) from error


def slot_bytes(rig: Rig) -> int:
    """Return the size of a slot that holds every array of a frame of this rig."""
    proximity, tactile = math.prod(rig.proximity.intrinsics.shape), math.prod(rig.tactile.intrinsics.shape)
    color = math.prod(rig.proximity_color_shape)
    sizes = (2 * proximity, 2 * tactile, 3 * color, 3 * tactile, proximity, 4 * proximity, _POSE_BYTES)
    return sum(_aligned(size) for size in sizes)


class Ring:
    """The slots, mapped into one process; the memory is released with the object."""

    def __init__(self, descriptor: int, slots: int, size: int) -> None:
        memory = mmap.mmap(descriptor, slots * size)
        self._slots = np.frombuffer(memory, np.uint8).reshape(slots, size)

    def write(self, slot: int, arrays: dict[str, AnyArray]) -> tuple[ArrayPlace, ...]:
        """Copy arrays into a slot.

        Raises
        ------
        FrameError
            They are larger than the rig's images.
        """
        places = []
        offset = 0
        for name, array in arrays.items():
            end = offset + array.nbytes
            if end > self._slots.shape[1]:
                raise FrameError(f"{name} is too large for a frame of this rig ({array.shape}); leave it out")
            target = self._slots[slot, offset:end].view(array.dtype).reshape(array.shape)
            np.copyto(target, array)
            places.append(ArrayPlace(name, array.dtype.str, array.shape, offset))
            offset = _aligned(end)
        return tuple(places)

    def read(self, slot: int, places: tuple[ArrayPlace, ...]) -> dict[str, AnyArray]:
        """Copy a slot and return its arrays."""
        last = places[-1]
        size = last.offset + math.prod(last.shape) * np.dtype(last.dtype).itemsize
        copied = self._slots[slot, :size].copy()
        return {
            place.name: np.ndarray(place.shape, place.dtype, buffer=copied.data, offset=place.offset)
            for place in places
        }


def _aligned(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT
