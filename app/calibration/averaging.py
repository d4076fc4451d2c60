"""Several frames become one snapshot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.calibration.snapshots import take_snapshot as take_median
from ...core.model.clouds import valid_depth
from ...core.model.frames import SensorFrame
from ..worker.jobs import Progress
from ..worker.results import SourceInfo
from .state import Snapshot


def take_snapshot(frames: Sequence[SensorFrame], number: int, info: SourceInfo, progress: Progress) -> Snapshot:
    """Average frames to one snapshot, named by the number of its first frame, from 1."""
    progress(0.0, "Averaging")
    taken = take_median(frames)
    last = number + frames[-1].sequence - frames[0].sequence
    name = f"Frame {number}" if len(frames) == 1 else f"Frames {number} to {last}"
    return Snapshot(taken.sha256, name, taken.frame, len(frames), moved_m(frames, info.rig.tactile.depth_unit_m))


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
