"""Snapshots: the pixelwise median of several frames, and the hash of its content."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import CalibrationError
from ..model.arrays import Uint8Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import IMAGES, SensorFrame

#: Depths that differ from the click's by more than this belong to another surface, metres.
_SAME_SURFACE_M = 0.004
#: Two middle values of a pixel that differ by more than this share belong to two surfaces.
_SAME_SURFACE = 0.02


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Pixelwise median of frames, with number and times of the first one; their number, and the images' hash."""

    frame: SensorFrame
    frames: int
    sha256: str


def take_snapshot(frames: Iterable[SensorFrame]) -> Snapshot:
    """Return the pixelwise median of frames; all are held in memory, about 3 MB each at 640 x 480."""
    kept = list(frames)
    if not kept:
        raise CalibrationError("a snapshot needs at least one frame; the source gave none")
    first = kept[0]
    if len(kept) > 1:
        colors = [frame.tactile_color for frame in kept if frame.tactile_color is not None]
        first = SensorFrame(
            sequence=first.sequence,
            proximity_depth=_median_counts(np.stack([frame.proximity_depth for frame in kept])),
            tactile_depth=_median_counts(np.stack([frame.tactile_depth for frame in kept])),
            proximity_color=_median_color(np.stack([frame.proximity_color for frame in kept])),
            tactile_color=_median_color(np.stack(colors)) if len(colors) == len(kept) else None,
            proximity_time_s=first.proximity_time_s,
            tactile_time_s=first.tactile_time_s,
        )
    return Snapshot(first, len(kept), content_hash(first))


def _median_counts(stack: Uint16Array) -> Uint16Array:
    """Return the median of (N, H, W) over N, without 0 and 65535; of two middle surfaces the nearer, else the mean."""
    valid = valid_depth(stack)
    ordered = np.sort(np.where(valid, stack, np.uint16(65535)), axis=0)
    count = valid.sum(axis=0)[None]
    low, high = (
        np.take_along_axis(ordered, np.maximum(middle, 0), axis=0)[0] for middle in ((count - 1) // 2, count // 2)
    )
    gap = high - low
    middle = low + gap // 2 + (gap & low + gap // 2 & 1)  # halves are rounded to even values, so they add no bias
    return np.where(count[0] == 0, 0, np.where(gap <= _SAME_SURFACE * low, middle, low)).astype(np.uint16)


def _median_color(stack: Uint8Array) -> Uint8Array:
    middle = (len(stack) - 1) // 2
    images: list[Uint8Array] = list(stack)
    for first in range(middle + 1):  # whole images change places: a tenth of the time of a sort along the first axis
        for n in range(len(images) - 1, first, -1):
            below, above = images[n - 1], images[n]
            images[n - 1], images[n] = np.minimum(below, above), np.maximum(below, above)
    return images[middle]


def content_hash(frame: SensorFrame) -> str:
    """Return the SHA-256 of a frame's images including their shapes and types."""
    digest = hashlib.sha256()
    for name in IMAGES:
        image = getattr(frame, name)
        digest.update(f"{name} {None if image is None else (image.shape, image.dtype.str)}\n".encode())
        if image is not None:
            digest.update(np.ascontiguousarray(image).tobytes())
    return digest.hexdigest()


def depth_under(counts: Uint16Array, unit_m: float, u: float, v: float, radius: int = 2) -> float | None:
    """Return the depth at a sub-pixel place, metres, or None without depth.

    A plane is fitted to the valid pixels around it on the same surface, which averages noise and follows the slope. A
    pixel within 1.5 pixels of the place must have depth.

    ``radius`` is half the side of the square window, pixels.
    """
    height, width = counts.shape
    column, row = round(u), round(v)
    if not (0 <= column < width and 0 <= row < height):
        return None
    top, left = max(row - radius, 0), max(column - radius, 0)
    window = counts[top : row + radius + 1, left : column + radius + 1]
    rows, columns = np.nonzero(valid_depth(window))
    if len(rows) == 0:
        return None
    depth = window[rows, columns] * unit_m
    across = np.column_stack([columns + left - u, rows + top - v])
    nearest = int(np.argmin((across**2).sum(axis=1)))
    if np.hypot(*across[nearest]) > 1.5:
        return None
    middle = float(np.median(depth[(across**2).sum(axis=1) <= 1.5**2]))
    same = np.abs(depth - middle) <= _SAME_SURFACE_M
    if same.sum() < 6:
        return middle
    design = np.column_stack([np.ones(same.sum()), across[same]])
    return float(np.linalg.lstsq(design, depth[same], rcond=None)[0][0])
