"""Images of ROS messages from untrusted recordings: encodings, padded rows, byte order, damage."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from ..errors import SourceError, TactuneError, foreign
from ..model.arrays import AnyArray, Uint8Array, Uint16Array
from ..model.loading import decode_image

#: Bytes per pixel of each colour encoding and OpenCV's conversion to RGB; it names Bayer patterns by their second row.
_TO_RGB: Final[dict[str, tuple[int, int | None]]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "8UC3": (3, cv2.COLOR_BGR2RGB),  # OpenCV's order, as RViz shows it
    "8UC4": (4, cv2.COLOR_BGRA2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    **dict.fromkeys(("YUYV", "yuyv", "yuv422_yuy2", "yuy2"), (2, cv2.COLOR_YUV2RGB_YUYV)),
    **dict.fromkeys(("UYVY", "uyvy", "yuv422"), (2, cv2.COLOR_YUV2RGB_UYVY)),
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2RGB),
}
#: The same with 16 bits, of which the upper 8 are shown.
_WIDE: Final = {"rgb16": "rgb8", "bgr16": "bgr8", "rgba16": "rgba8", "bgra16": "bgra8", "16UC1": "mono8"} | {
    name[:-1] + "16": name for name in _TO_RGB if name.startswith(("bayer", "mono"))
}
#: Brightness in full size, then colour of each 2 x 2 pixels.
_PLANES: Final = {"nv12": cv2.COLOR_YUV2RGB_NV12, "nv21": cv2.COLOR_YUV2RGB_NV21}
_DEPTH: Final = ("16UC1", "mono16", "32FC1")
#: All encodings of colour.
COLORS: Final = (*_TO_RGB, *_WIDE, *_PLANES, "nv24")
#: The encoding of what OpenCV decodes, by type and number of channels.
_DECODED: Final = {
    ("uint16", 1): "16UC1",
    ("uint8", 1): "mono8",
    ("uint8", 3): "bgr8",
    ("uint8", 4): "bgra8",
    ("uint16", 3): "bgr16",
}
#: compressed_depth_image_transport puts its settings in front of a PNG: an enumeration and two float32.
_DEPTH_HEADER_BYTES: Final = 12
#: More than any depth camera has; a damaged size must not fill the memory.
_MOST_PIXELS: Final = 1 << 24
_MOST_DIGITS: Final = 10  # of 3 bits each
#: Unit of the counts to which depth in metres is brought.
FLOAT_UNIT_M: Final = 1e-4


class DamagedFileError(ValueError):
    """The bytes are damaged; the message is a clause for the end of a sentence."""


@contextmanager
def damage_told(path: Path, what: str) -> Iterator[None]:
    """Turn damage, in whichever way a library reports it, into a `SourceError` of one sentence."""
    try:
        yield
    except TactuneError:  # also of a progress callable that cancels
        raise
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; check the path and the disk") from error
    except Exception as error:
        detail = foreign(f"{error} is missing" if isinstance(error, KeyError) else error) or type(error).__name__
        raise SourceError(f"{path}: {what} ({detail}); copy it again if it is damaged") from error


@dataclass(frozen=True, eq=False)
class RawImage:
    """A ``sensor_msgs/Image``: rows of ``step`` bytes, in words of the recording."""

    height: int
    width: int
    encoding: str
    big_endian: bool
    step: int
    data: Uint8Array

    @classmethod
    def of(cls, message: Any) -> RawImage:
        """Return the image of a ``sensor_msgs/Image`` or ``CompressedImage``; `DamagedFileError` if it is none."""
        if hasattr(message, "format"):
            return _unpacked(message.format, message.data)
        return cls(
            message.height, message.width, message.encoding, bool(message.is_bigendian), message.step, message.data
        )

    @classmethod
    def of_pixels(cls, image: AnyArray, encoding: str) -> RawImage:
        rows = np.ascontiguousarray(image).reshape(len(image), -1).view(np.uint8)
        return cls(image.shape[0], image.shape[1], encoding, sys.byteorder == "big", rows.shape[1], rows.reshape(-1))

    @property
    def is_depth(self) -> bool:
        """Whether the encoding can be that of depth; mono16 may also be an infrared image."""
        return self.encoding in _DEPTH

    def counts(self, shape: tuple[int, int], *, copy: bool = True) -> Uint16Array:
        return self.channel(shape, ("mono16", "16UC1"), np.dtype(np.uint16), copy=copy)

    def depth(self, shape: tuple[int, int], *, copy: bool = True) -> Uint16Array:
        """Return counts, uint16 (H, W), metres in `FLOAT_UNIT_M`; without ``copy`` maybe memory that is read only."""
        if self.encoding != "32FC1":
            return self.counts(shape, copy=copy)
        counts = self.channel(shape, ("32FC1",), np.dtype(np.float32)) / FLOAT_UNIT_M
        counts[~((counts > 0) & (counts < np.iinfo(np.uint16).max))] = 0  # also nan and infinity
        return np.rint(counts).astype(np.uint16)

    def channel(
        self, shape: tuple[int, int], encodings: Sequence[str], dtype: np.dtype[Any], *, copy: bool = True
    ) -> AnyArray:
        """Return an image of one channel, shape (H, W), in one of some encodings, all of this type."""
        if self.encoding not in encodings:
            raise DamagedFileError(f"it is encoded as {foreign(self.encoding, 40)!r}; known are {', '.join(encodings)}")
        rows = self._rows(shape, dtype.itemsize)
        return rows.view(dtype.newbyteorder(">" if self.big_endian else "<")).astype(dtype, copy=copy)

    def color(self, shape: tuple[int, int], *, copy: bool = True) -> Uint8Array:
        """Return a colour image: RGB uint8, shape (H, W, 3); ``copy`` as of `depth`, errors as of `channel`."""
        if self.encoding in _WIDE:
            upper = self.data[: len(self.data) // 2 * 2].reshape(-1, 2)[:, 0 if self.big_endian else 1]
            narrow = replace(self, encoding=_WIDE[self.encoding], step=self.step // 2, data=np.ascontiguousarray(upper))
            return narrow.color(shape)
        if self.encoding in _PLANES:
            return np.asarray(cv2.cvtColor(self._rows(shape, 1, 1.5), _PLANES[self.encoding]), np.uint8)
        if self.encoding == "nv24":
            luma, chroma = np.split(self._rows(shape, 1, 3), [shape[0]])  # colour of each pixel: a quarter is shown
            pixels = np.vstack([luma, chroma.reshape(*shape, 2)[::2, ::2].reshape(-1, shape[1])])
            return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_YUV2RGB_NV12), np.uint8)
        if self.encoding not in COLORS:
            raise DamagedFileError(f"it is encoded as {foreign(self.encoding, 40)!r}; known are {', '.join(COLORS)}")
        bytes_per_pixel, conversion = _TO_RGB[self.encoding]
        pixels = self._rows(shape, bytes_per_pixel).reshape(*shape, bytes_per_pixel)
        if conversion is None:
            return pixels.copy() if copy else pixels
        return np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)

    def _rows(self, shape: tuple[int, int], bytes_per_pixel: int, planes: float = 1) -> Uint8Array:
        """Return the image's bytes without padding, (planes * H, W * bytes per pixel); planes lie below each other."""
        width, count = shape[1], round(shape[0] * planes)
        if (self.height, self.width) != shape:
            raise DamagedFileError(f"it has {self.width} x {self.height} pixels, its lens {width} x {shape[0]}")
        is_padded = planes > 1 and self.step != width  # a driver may pad the rows of neither plane
        if is_padded or self.step < width * bytes_per_pixel or len(self.data) < count * self.step:
            raise DamagedFileError(f"it has {len(self.data)} bytes, too few for its size")
        rows = self.data[: count * self.step].reshape(count, self.step)[:, : width * bytes_per_pixel]
        return np.ascontiguousarray(rows)


def _unpacked(words: str, data: Uint8Array) -> RawImage:
    """Return a compressed image; ``words`` is its format, such as ``"16UC1; compressedDepth png"``."""
    encoding, _, how = (part.strip() for part in words.partition(";"))
    if "compressedDepth" not in words:
        image = decode_image(data.tobytes())
        kind = _DECODED.get((image.dtype.name, 1 if image.ndim == 2 else image.shape[2]))
        if kind is None:
            raise DamagedFileError(f"it is compressed with {image.dtype} and the shape {image.shape}")
        return RawImage.of_pixels(image, kind)
    packed = data[_DEPTH_HEADER_BYTES:]
    image = _unpack_rvl(packed) if "rvl" in how.lower() else decode_image(packed.tobytes())
    if image.dtype != np.uint16 or image.ndim != 2:
        raise DamagedFileError(f"its depth is compressed with {image.dtype} and the shape {image.shape}")
    if encoding != "32FC1":
        return RawImage.of_pixels(image, "16UC1")
    # image_transport keeps metres as A / depth + B, rounded, and A and B in front of the PNG.
    scale, offset = np.frombuffer(data[4:_DEPTH_HEADER_BYTES].tobytes(), "<f4").astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = np.where(image > 0, scale / (image - offset), np.nan)
    return RawImage.of_pixels(metres.astype(np.float32), "32FC1")


def _unpack_rvl(data: Uint8Array) -> Uint16Array:
    """Return depth, uint16 (H, W), that is compressed as RVL (Wilson 2017), with width and height in front.

    It is a list of numbers: how many pixels are zero, how many are not, and the differences of the latter. A number is
    written 3 bits at a time, the lowest first; the fourth bit says that more follow.
    """
    width, height = np.frombuffer(data[:8].tobytes(), "<u4").tolist()
    if not 0 < width * height <= _MOST_PIXELS:
        raise DamagedFileError(f"its depth is said to have {width} x {height} pixels")
    words = np.frombuffer(data[8 : len(data) // 4 * 4].tobytes(), "<u4")
    parts = (words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32) & 15).ravel().astype(np.int64)
    starts = np.flatnonzero(np.concatenate([[True], parts[:-1] < 8]))
    digit = np.arange(len(parts)) - np.repeat(starts, np.diff(np.append(starts, len(parts))))
    if digit.max(initial=0) > _MOST_DIGITS:
        raise DamagedFileError("its depth has a number that is too large")
    numbers = np.add.reduceat((parts & 7) << 3 * digit, starts)
    steps = (numbers >> 1) ^ -(numbers & 1)
    seen = np.zeros(width * height, np.bool_)
    differences = []
    place = at = 0
    while place < len(seen):
        if at + 2 > len(numbers):
            raise DamagedFileError("its depth ends too early")
        place, count, at = place + int(numbers[at]), int(numbers[at + 1]), at + 2
        if max(place, place + count) > len(seen) or at + count > len(numbers):
            raise DamagedFileError("its depth has more pixels than its size")
        seen[place : place + count] = True
        differences.append(steps[at : at + count])
        place, at = place + count, at + count
    depth = np.zeros(len(seen), np.uint16)
    depth[seen] = np.cumsum(np.concatenate(differences))
    return depth.reshape(height, width)
