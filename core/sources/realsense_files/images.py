"""Images as librealsense stores them, raw or as PNG, to arrays."""

from __future__ import annotations

import struct
import zlib
from contextlib import suppress
from dataclasses import dataclass

import cv2
import numpy as np

from ...model.arrays import AnyArray, Uint8Array, Uint16Array
from .damage import DamagedFileError

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
_PNG_START = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"
_PNG_TO_RGB = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}


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
    # Size and checksums are looked at first: the decoder allocates whatever the file claims, and
    # complains about damage on the terminal.
    raw = data.tobytes()
    if len(raw) < len(_PNG_START) + 8 or not raw.startswith(_PNG_START):
        raise DamagedFileError("it is no PNG image")
    width, height = struct.unpack_from(">II", raw, len(_PNG_START))
    _check_shape((height, width), shape)
    image = None
    if _checksums_are_right(raw):
        with suppress(cv2.error):
            image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None or image.shape[:2] != shape:
        raise DamagedFileError("its PNG data are damaged")
    return image


def _checksums_are_right(png: bytes) -> bool:
    at = 8
    while at + 12 <= len(png):
        (size,) = struct.unpack_from(">I", png, at)
        end = at + 8 + size
        if end + 4 > len(png) or zlib.crc32(memoryview(png)[at + 4 : end]) != struct.unpack_from(">I", png, end)[0]:
            return False
        if png[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False


def _check_shape(found: tuple[int, int], stated: tuple[int, int]) -> None:
    if found != stated:
        raise DamagedFileError(
            f"it has {found[1]} x {found[0]} pixels, but its lens is said to have {stated[1]} x {stated[0]}"
        )
