"""Decodes untrusted bytes: fields of records, and images as PNG. Every failure is a `DamagedFileError`."""

from __future__ import annotations

import struct

import cv2
import numpy as np

from ...model.arrays import AnyArray, Uint8Array, Uint16Array
from ...model.loading import decode_image, image_size
from ..ros_image import DamagedFileError, check_shape

#: Upper limit of a message or chunk; a larger claim is damage, and nothing is allocated for it.
LARGEST_BYTES = 128 * 2**20

#: OpenCV's conversion to RGB by the number of channels of a PNG.
_PNG_TO_RGB = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}


def check_size(size: int | None, largest: int = LARGEST_BYTES) -> int:
    """Return a claimed size; raise `DamagedFileError` if it is too large."""
    if size is None or size > largest:
        raise DamagedFileError(f"a part of it claims {size} bytes, more than any camera writes")
    return size


class Cursor:
    """Reads consecutive little-endian fields of a ROS 1 message or record."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def rest(self) -> int:
        """Number of remaining bytes."""
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
        """Return a string that follows its length."""
        return self.take(self.u32()).decode(errors="replace")

    def bytes(self) -> Uint8Array:
        """Return an array of bytes that follows its length, without a copy."""
        size = self.u32()
        if size > self.rest:
            raise DamagedFileError(f"an array of {size} bytes has only {self.rest} left")
        self._at += size
        return np.frombuffer(self._data, np.uint8, size, self._at - size)

    def _number(self, code: str, size: int) -> float:
        number: float = struct.unpack(code, self.take(size))[0]
        return number


def png_depth(data: Uint8Array, shape: tuple[int, int]) -> Uint16Array:
    """Return the counts of a 16 bit grey PNG: uint16, shape (H, W)."""
    image = _decoded(data, shape)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise DamagedFileError("it is no PNG with 16 bits of depth")
    counts: Uint16Array = image
    return counts


def png_color(data: Uint8Array, shape: tuple[int, int]) -> Uint8Array:
    """Return the colours of an 8 bit PNG: RGB uint8, shape (H, W, 3)."""
    image = _decoded(data, shape)
    channels = image.shape[2] if image.ndim == 3 else 1
    if image.dtype != np.uint8 or channels not in _PNG_TO_RGB:
        raise DamagedFileError("it is no PNG with 8 bits a colour")
    return np.asarray(cv2.cvtColor(image, _PNG_TO_RGB[channels]), np.uint8)


def _decoded(data: Uint8Array, shape: tuple[int, int]) -> AnyArray:
    raw = data.tobytes()
    try:
        width, height = image_size(raw)
        check_shape((height, width), shape)
        return decode_image(raw)
    except ValueError as error:
        raise DamagedFileError(f"its PNG data are damaged: {error}") from error
