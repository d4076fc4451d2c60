"""Memory that two processes share, cut into slots; each slot holds the images of one frame.

The memory has no name: it is an anonymous file, or an unlinked one, whose descriptor the capture
process inherits. So it vanishes with the last of the two processes, however that ends.
Who may touch a slot is told by messages alone (`messages`): a slot is announced when it is written
and given back when it is copied, so nobody ever reads one that is half written.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
from typing import Final, NamedTuple

import numpy as np

from ...errors import FrameError, SourceError
from ...model.arrays import AnyArray
from ...model.frames import Rig

_ALIGNMENT: Final = 64


class ArrayPlace(NamedTuple):
    """Where one array lies in a slot: byte offset, type and shape."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    offset: int


def create_memory() -> int:
    """Return the descriptor of an empty file in memory that has no name."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("tactune-frames", os.MFD_CLOEXEC)
    with tempfile.TemporaryFile(prefix="tactune-frames-") as file:
        return os.dup(file.fileno())


def reserve_memory(descriptor: int, size: int) -> None:
    """Give the file its size now, so that a machine out of memory says so here and not with a crash later.

    Raises
    ------
    SourceError
        There is not so much memory.
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
    sizes = (2 * proximity, 2 * tactile, 3 * color, 3 * tactile, proximity, 4 * proximity)
    return sum(_aligned(size) for size in sizes)


class Ring:
    """The slots, seen from one process; the memory is let go with the object."""

    def __init__(self, descriptor: int, slots: int, size: int) -> None:
        memory = mmap.mmap(descriptor, slots * size)
        self._slots = np.frombuffer(memory, np.uint8).reshape(slots, size)

    def write(self, slot: int, arrays: dict[str, AnyArray]) -> tuple[ArrayPlace, ...]:
        """Copy arrays into a slot.

        Raises
        ------
        FrameError
            They are larger than the rig's own images.
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
        """Copy a slot out, all at once, and return its arrays."""
        last = places[-1]
        size = last.offset + math.prod(last.shape) * np.dtype(last.dtype).itemsize
        copied = self._slots[slot, :size].copy()
        return {
            place.name: np.ndarray(place.shape, place.dtype, buffer=copied.data, offset=place.offset)
            for place in places
        }


def _aligned(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT
