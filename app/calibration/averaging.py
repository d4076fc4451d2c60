"""Several frames become one snapshot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ...core.clouds import valid_depth
from ...core.frames import SensorFrame
from ..results import SourceInfo
from .jobs import Progress
from .state import Snapshot, digest_of

_ROWS_AT_ONCE = 40
_IMAGES = ("proximity_depth", "tactile_depth", "proximity_color", "tactile_color")


def take_snapshot(frames: Sequence[SensorFrame], info: SourceInfo, progress: Progress) -> Snapshot:
    """Average frames to one snapshot, pixel by pixel by the median; pixels without depth are left out."""
    first = frames[0]
    averaged = first if len(frames) == 1 else _median_frame(frames, progress)
    name = f"Frame {first.sequence}" + (f", mean of {len(frames)}" if len(frames) > 1 else "")
    unit_m = info.rig.tactile.depth_unit_m
    return Snapshot(digest_of(averaged), name, averaged, len(frames), moved_m(frames, unit_m))


def moved_m(frames: Sequence[SensorFrame], unit_m: float) -> float:
    """Return how much the tactile depth changed from the first to the last frame, metres.

    The 95th percentile over the pixels, so a small moving object shows and noise hardly does.
    """
    before, after = frames[0].tactile_depth[::4, ::4], frames[-1].tactile_depth[::4, ::4]
    valid = valid_depth(before) & valid_depth(after)
    if not valid.any() or len(frames) == 1:
        return 0.0
    change = np.abs(before[valid].astype(np.float64) - after[valid]) * unit_m
    return float(np.percentile(change, 95))


def _median_frame(frames: Sequence[SensorFrame], progress: Progress) -> SensorFrame:
    images: dict[str, Any] = {}
    for number, name in enumerate(_IMAGES):
        progress(number / len(_IMAGES), "Averaging")
        stack = [getattr(frame, name) for frame in frames]
        if stack[0] is not None:
            images[name] = _median(stack)
    return SensorFrame(sequence=frames[0].sequence, **images)


def _median(stack: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    """Return the median over images, band by band; counts that mean no depth are left out."""
    out = np.empty_like(stack[0])
    for top in range(0, len(out), _ROWS_AT_ONCE):
        rows = np.stack([image[top : top + _ROWS_AT_ONCE] for image in stack])
        if rows.dtype != np.uint16:
            out[top : top + _ROWS_AT_ONCE] = np.median(rows, axis=0)
            continue
        values = np.sort(np.where(valid_depth(rows), rows, np.uint16(65535)), axis=0)
        count = valid_depth(rows).sum(axis=0)
        low, high = np.maximum(count - 1, 0) // 2, count // 2
        middle = sum(
            np.take_along_axis(values, np.minimum(at, len(stack) - 1)[None], axis=0)[0].astype(np.uint32)
            for at in (low, high)
        )
        out[top : top + _ROWS_AT_ONCE] = np.where(count > 0, (middle + 1) // 2, 0)
    return out
