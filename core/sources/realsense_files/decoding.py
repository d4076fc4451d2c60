"""Decodes untrusted bytes: fields of records, and images raw or as PNG. Every failure is one exception."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import cv2
import numpy as np

from ...model.arrays import AnyArray, Uint8Array, Uint16Array
from ...model.loading import decode_image, image_size

#: Upper limit of a message or chunk; a larger claim is damage, and nothing is allocated for it.
LARGEST_BYTES = 128 * 2**20

_DEPTH_ENCODINGS = ("mono16", "16UC1")

#: Bytes per pixel of each colour encoding that librealsense records and OpenCV's conversion to RGB.
_TO_RGB = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "YUYV": (2, cv2.COLOR_YUV2RGB_YUYV),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "UYVY": (2, cv2.COLOR_YUV2RGB_UYVY),
}

#: A PNG's signature and the fixed start of its first chunk, which holds the size.
_PNG_TO_RGB = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}


class DamagedFileError(Exception):
    """The bytes are damaged; the message is a clause for the end of a sentence."""


def check_size(size: int | None, largest: int = LARGEST_BYTES) -> int:
    """Return a claimed size; raise `DamagedFileError` if it is too large."""
    if size is None or size > largest:
        raise DamagedFileError(f"a part of it claims {size} bytes, more than any camera writes")
    return size


class Cursor:
    """Reads consecutive little-endian fields.

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
        data = self.take(self.u32())
        if self._aligned:
            data = data.removesuffix(b"\x00")
        return data.decode(errors="replace")

    def bytes(self) -> Uint8Array:
        """Return an array of bytes that follows its length, without a copy."""
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


@dataclass(frozen=True, eq=False)
class RawImage:
    """A ``sensor_msgs/Image``: rows of ``step`` bytes, in words of the recording."""

    height: int
    width: int
    encoding: str
    big_endian: bool
    step: int
    data: Uint8Array


def raw_depth(image: RawImage, shape: tuple[int, int]) -> Uint16Array:
    """Return raw counts: uint16, shape (H, W)."""
    if image.encoding not in _DEPTH_ENCODINGS:
        raise DamagedFileError(f"it is encoded as {image.encoding[:40]!r}, not as 16 bit depth")
    rows = _rows(image, shape, bytes_per_pixel=2)
    return rows.view(">u2" if image.big_endian else "<u2").astype(np.uint16)


def raw_color(image: RawImage, shape: tuple[int, int]) -> Uint8Array:
    """Return a colour image: RGB uint8, shape (H, W, 3)."""
    if image.encoding not in _TO_RGB:
        raise DamagedFileError(f"it is encoded as {image.encoding[:40]!r}; known are {', '.join(_TO_RGB)}")
    bytes_per_pixel, conversion = _TO_RGB[image.encoding]
    pixels = _rows(image, shape, bytes_per_pixel).reshape(*shape, bytes_per_pixel)
    return pixels.copy() if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)


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


def _rows(image: RawImage, shape: tuple[int, int], bytes_per_pixel: int) -> Uint8Array:
    """Return the image's bytes, shape (H, W * bytes per pixel), padding cut off."""
    height, width = shape
    _check_shape((image.height, image.width), shape)
    if image.step < width * bytes_per_pixel or len(image.data) != height * image.step:
        raise DamagedFileError(f"it has {len(image.data)} bytes, too few for its size")
    rows = image.data.reshape(height, image.step)[:, : width * bytes_per_pixel]
    return np.ascontiguousarray(rows)


def _decoded(data: Uint8Array, shape: tuple[int, int]) -> AnyArray:
    raw = data.tobytes()
    try:
        width, height = image_size(raw)
        _check_shape((height, width), shape)
        return decode_image(raw)
    except ValueError as error:
        raise DamagedFileError(f"its PNG data are damaged: {error}") from error


def _check_shape(found: tuple[int, int], stated: tuple[int, int]) -> None:
    if found != stated:
        raise DamagedFileError(
            f"it has {found[1]} x {found[0]} pixels, but its lens is said to have {stated[1]} x {stated[0]}"
        )
