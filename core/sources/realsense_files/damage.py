"""Reading bytes that nobody vouches for: every step is checked, every failure is one exception."""

from __future__ import annotations

import struct

import numpy as np

from ...model.arrays import Uint8Array

#: No message or chunk of a camera is larger; a claim above is damage, and nothing is allocated for it.
LARGEST_BYTES = 128 * 2**20


class DamagedFileError(Exception):
    """What is wrong with the bytes, as a clause for the end of a sentence."""


def check_size(size: int | None, largest: int = LARGEST_BYTES) -> int:
    """Return a claimed size, or refuse it before anything of that size is allocated."""
    if size is None or size > largest:
        raise DamagedFileError(f"a part of it claims {size} bytes, more than any camera writes")
    return size


class Cursor:
    """Reads little-endian fields one after the other.

    Parameters
    ----------
    data : bytes
    aligned : bool
        Whether numbers start at multiples of their size (ROS 2's CDR, after its four first bytes).
    """

    def __init__(self, data: bytes, *, aligned: bool = False) -> None:
        self._data = data
        self._aligned = aligned
        self._start = self._at = 0
        if aligned:
            if self.take(4)[:2] != b"\x00\x01":
                raise DamagedFileError("a message is not little-endian CDR")
            self._start = 4

    @property
    def rest(self) -> int:
        """Number of bytes that are left."""
        return len(self._data) - self._at

    def take(self, size: int) -> bytes:
        """Return the next bytes."""
        if size > self.rest:
            raise DamagedFileError(f"a field of {size} bytes has only {self.rest} left")
        self._at += size
        return self._data[self._at - size : self._at]

    def u8(self) -> int:
        """Return one byte."""
        return self.take(1)[0]

    def u32(self) -> int:
        """Return an unsigned number of four bytes."""
        return int(self._number("<I", 4))

    def f32(self) -> float:
        """Return a float of four bytes."""
        return self._number("<f", 4)

    def f64s(self, count: int) -> tuple[float, ...]:
        """Return floats of eight bytes each."""
        return tuple(self._number("<d", 8) for _ in range(count))

    def text(self) -> str:
        """Return a string with its length in front."""
        data = self.take(self.u32())
        if self._aligned:
            data = data.removesuffix(b"\x00")
        return data.decode(errors="replace")

    def bytes(self) -> Uint8Array:
        """Return an array of bytes with its length in front, without a copy."""
        size = self.u32()
        if size > self.rest:
            raise DamagedFileError(f"an array of {size} bytes has only {self.rest} left")
        self._at += size
        return np.frombuffer(self._data, np.uint8, size, self._at - size)

    def _number(self, code: str, size: int) -> float:
        if self._aligned:
            self.take(-(self._at - self._start) % size)
        number: float = struct.unpack(code, self.take(size))[0]
        return number
