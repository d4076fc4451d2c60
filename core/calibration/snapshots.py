"""Snapshots: the pixelwise median of several frames, and the hash of its content."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..contact.kernels.compiling import kernel
from ..errors import CalibrationError
from ..model.alignment import SnapshotRecord
from ..model.arrays import AnyArray, Float64Array, Uint8Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import SensorFrame

#: Depths that differ from the click's by more than this belong to another surface, metres.
_SAME_SURFACE_M = 0.004
#: Two middle values of a pixel that differ by more than this share belong to two surfaces.
_SAME_SURFACE = 0.02
_ROWS_AT_ONCE = 32


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Pixelwise median of frames, on which points are clicked.

    Attributes
    ----------
    frame : SensorFrame
        Medians of all images, with sequence number and time stamps of the first frame.
    frames : int
        Number of frames.
    sha256 : str
        Hash of the four images.
    """

    frame: SensorFrame
    frames: int
    sha256: str

    def record(self, name: str = "") -> SnapshotRecord:
        """Return the record of the snapshot for a preset."""
        return SnapshotRecord(name=name, sha256=self.sha256, frames=self.frames)


def take_snapshot(frames: Iterable[SensorFrame]) -> Snapshot:
    """Return the pixelwise median of frames.

    Parameters
    ----------
    frames : iterable of SensorFrame
        All of one size. All are held in memory, about 3 MB each at 640 x 480.

    Raises
    ------
    CalibrationError
        There is no frame, or their sizes differ.
    """
    kept = list(frames)
    if not kept:
        raise CalibrationError("a snapshot needs at least one frame; the source gave none")
    first = kept[0]
    if len(kept) > 1:
        colors = [frame.tactile_color for frame in kept if frame.tactile_color is not None]
        first = SensorFrame(
            sequence=first.sequence,
            proximity_depth=median_counts([frame.proximity_depth for frame in kept]),
            tactile_depth=median_counts([frame.tactile_depth for frame in kept]),
            proximity_color=_median_color([frame.proximity_color for frame in kept]),
            tactile_color=_median_color(colors) if len(colors) == len(kept) else None,
            proximity_time_s=first.proximity_time_s,
            tactile_time_s=first.tactile_time_s,
        )
    return Snapshot(first, len(kept), content_hash(first))


def median_counts(images: Sequence[Uint16Array]) -> Uint16Array:
    """Return the median of raw depth images (H, W); 0 and 65535 are left out.

    For an even number of values it is the mean of the two middle ones, because the lower one alone is too near. Where
    these two belong to two surfaces, it is the nearer one; 0 if no image has depth.

    Raises
    ------
    CalibrationError
        There is no image, or their sizes differ.
    """
    _check_sizes(images)
    out = np.empty(images[0].shape, np.uint16)
    for top in range(0, len(out), _ROWS_AT_ONCE):
        band = slice(top, top + _ROWS_AT_ONCE)
        _median_rows(np.stack([image[band] for image in images], axis=2), out[band])
    return out


def content_hash(frame: SensorFrame) -> str:
    """Return the SHA-256 of a frame's images including their shapes and types."""
    digest = hashlib.sha256()
    for name in ("proximity_depth", "tactile_depth", "proximity_color", "tactile_color"):
        image = getattr(frame, name)
        digest.update(f"{name} {None if image is None else (image.shape, image.dtype.str)}\n".encode())
        if image is not None:
            digest.update(np.ascontiguousarray(image).tobytes())
    return digest.hexdigest()


def depth_under(counts: Uint16Array, unit_m: float, u: float, v: float, radius: int = 2) -> float | None:
    """Return the depth at a sub-pixel place, metres, or None without depth.

    A plane is fitted to the valid pixels around it on the same surface, which averages noise and follows the slope. A
    pixel within 1.5 pixels of the place must have depth.

    Parameters
    ----------
    counts : uint16, shape (H, W)
    unit_m : float
    u, v : float
    radius : int
        Half side of the square window, pixels.
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
    return _plane_at_origin(across[same], depth[same]) if same.sum() >= 6 else middle


def _plane_at_origin(across: Float64Array, depth: Float64Array) -> float:
    design = np.column_stack([np.ones(len(across)), across])
    return float(np.linalg.lstsq(design, depth, rcond=None)[0][0])


def _median_color(images: Sequence[Uint8Array]) -> Uint8Array:
    _check_sizes(images)
    out = np.empty_like(images[0])
    for top in range(0, len(out), _ROWS_AT_ONCE):
        band = slice(top, top + _ROWS_AT_ONCE)
        stack = np.stack([image[band] for image in images])
        middle = (len(images) - 1) // 2
        out[band] = np.partition(stack, middle, axis=0)[middle]
    return out


def _check_sizes(images: Sequence[AnyArray]) -> None:
    if not images:
        raise CalibrationError("a median needs at least one image; there is none")
    for image in images:
        if image.shape != images[0].shape:
            raise CalibrationError(
                f"images of {images[0].shape[1]} x {images[0].shape[0]} and {image.shape[1]} x {image.shape[0]} pixels "
                "cannot be averaged; take all from one rig"
            )


@partial(kernel, allocates=True)
def _median_rows(stack: Uint16Array, out: Uint16Array) -> None:
    """Write the median of the valid values of each pixel; ``stack`` is (rows, columns, images)."""
    height, width, count = stack.shape
    values = np.empty(count, np.uint16)
    for row in range(height):
        for column in range(width):
            kept = 0
            for i in range(count):
                value = stack[row, column, i]
                if value == 0 or value == 65535:  # noqa: PLR1714 - numba compiles comparisons best
                    continue
                place = kept
                while place > 0 and values[place - 1] > value:
                    values[place] = values[place - 1]
                    place -= 1
                values[place] = value
                kept += 1
            if kept == 0:
                out[row, column] = 0
                continue
            low = values[(kept - 1) // 2]
            gap = values[kept // 2] - low
            middle = low + gap // 2
            # halves are rounded to even values, so they add no bias
            out[row, column] = middle + (gap & middle & 1) if gap <= _SAME_SURFACE * low else low
