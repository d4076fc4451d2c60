"""Images of ROS messages from untrusted recordings: encodings, padded rows, byte order, damage, nearest times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..errors import SourceError, TactuneError
from ..model.arrays import AnyArray, IndexArray, Uint8Array, Uint16Array

#: Bytes per pixel of each colour encoding and OpenCV's conversion to RGB.
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


class DamagedFileError(Exception):
    """The bytes are damaged; the message is a clause for the end of a sentence."""


@contextmanager
def damage_told(path: Path, what: str) -> Iterator[None]:
    """Turn damage, in whichever way a library reports it, into a `SourceError` of one sentence."""
    try:
        yield
    except TactuneError:  # also of a progress callable that cancels
        raise
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; check the disk") from error
    except Exception as error:
        detail = " ".join(str(error).split())[:300] or type(error).__name__
        raise SourceError(f"{path}: {what} ({detail}); copy or record it again") from error


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
        return cls(
            message.height, message.width, message.encoding, bool(message.is_bigendian), message.step, message.data
        )

    def depth(self, shape: tuple[int, int]) -> Uint16Array:
        """Return raw counts: uint16, shape (H, W)."""
        return self.channel(shape, ("mono16", "16UC1"), np.dtype(np.uint16))

    def channel(self, shape: tuple[int, int], encodings: Sequence[str], dtype: np.dtype[Any]) -> AnyArray:
        """Return an image of one channel, shape (H, W), in one of some encodings, all of this type."""
        if self.encoding not in encodings:
            raise DamagedFileError(f"it is encoded as {self.encoding[:40]!r}; known are {', '.join(encodings)}")
        rows = self._rows(shape, dtype.itemsize)
        return rows.view(dtype.newbyteorder(">" if self.big_endian else "<")).astype(dtype)

    def color(self, shape: tuple[int, int]) -> Uint8Array:
        """Return a colour image: RGB uint8, shape (H, W, 3); errors as of `channel`."""
        if self.encoding not in _TO_RGB:
            raise DamagedFileError(f"it is encoded as {self.encoding[:40]!r}; known are {', '.join(_TO_RGB)}")
        bytes_per_pixel, conversion = _TO_RGB[self.encoding]
        pixels = self._rows(shape, bytes_per_pixel).reshape(*shape, bytes_per_pixel)
        return pixels.copy() if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)

    def _rows(self, shape: tuple[int, int], bytes_per_pixel: int) -> Uint8Array:
        """Return the image's bytes, shape (H, W * bytes per pixel), padding cut off."""
        height, width = shape
        if (self.height, self.width) != shape:
            raise DamagedFileError(
                f"it has {self.width} x {self.height} pixels, but its lens is said to have {width} x {height}"
            )
        if self.step < width * bytes_per_pixel or len(self.data) != height * self.step:
            raise DamagedFileError(f"it has {len(self.data)} bytes, too few for its size")
        rows = self.data.reshape(height, self.step)[:, : width * bytes_per_pixel]
        return np.ascontiguousarray(rows)


def nearest(times: AnyArray, candidates: AnyArray) -> IndexArray:
    """Return for each time the index of the nearest candidate; the earlier of two that are as near."""
    order = np.argsort(candidates, kind="stable")
    ordered = candidates[order]
    after = np.searchsorted(ordered, times).clip(1, max(len(ordered) - 1, 1))
    before = after - 1
    after = after.clip(max=len(ordered) - 1)
    later_is_nearer = ordered[after] - times < times - ordered[before]
    return order[np.where(later_is_nearer, after, before)]
