"""Taking snapshots: waits for frames and averages them on another thread."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ...core.calibration.snapshots import take_snapshot as take_median
from ...core.errors import counted
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from ..context import Context
from ..worker.jobs import Work
from ..worker.results import SourceInfo
from .measuring_step import MeasuringStep
from .session import Snapshot

#: Frames averaged for a snapshot: noise falls to a third.
FRAMES = 10
#: Movement of the membrane that would blur an averaged frame, metres; the noise of real cameras stays below.
MOVED_LIMIT_M = 0.0025


def take_snapshot(frames: Sequence[SensorFrame], number: int, info: SourceInfo) -> Snapshot:
    """Average frames into one snapshot, named after its first frame."""
    taken = take_median(frames)
    last = number + frames[-1].sequence - frames[0].sequence
    name = f"Frame {number}" if len(frames) == 1 else f"Frames {number} to {last}"
    return Snapshot(taken.sha256, name, taken.frame, len(frames), info.name)


def moved_m(before: SensorFrame, after: SensorFrame, unit_m: float) -> float:
    """Return the 95th percentile of the tactile depth's change, metres: a small moving object shows, noise does not."""
    first, last = before.tactile_depth[::4, ::4], after.tactile_depth[::4, ::4]
    valid = valid_depth(first) & valid_depth(last)
    if not valid.any():
        return 0.0
    return float(np.percentile(np.abs(first[valid].astype(np.float64) - last[valid]) * unit_m, 95))


class SnapshotStep(MeasuringStep):
    """Averages the next frames, also of a recording, into a snapshot while the membrane stands still."""

    _tip = f"Average {FRAMES} frames, or as many as show the membrane standing still (Ctrl+T)"
    button = "Ta&ke snapshot", _tip, "Ctrl+T"
    at_rest = False
    wanted = FRAMES

    def __init__(self, context: Context, rig: Rig) -> None:
        super().__init__(context)
        self._rig = rig
        self._number = 0  # of the first frame
        self._end = ""

    def begin(self) -> None:
        result = self._context.result
        if result is not None and result.source.rig != self._rig:
            self._fail("Another rig is open now: close the wizard, and calibrate that one.")
            return
        self._number = 0 if result is None else result.frame_number
        super().begin()

    def share(self, kept: Sequence[SensorFrame]) -> float:
        return 1.0 if self._still(kept) < len(kept) else super().share(kept)

    def work(self, kept: list[SensorFrame], info: SourceInfo) -> Work:
        still, number = self._still(kept), self._number
        self._end = "then the membrane moved" if still < len(kept) else "the source has no more"
        return lambda _: take_snapshot(kept[: min(still, self.wanted)], number, info)

    def _still(self, kept: Sequence[SensorFrame]) -> int:
        """Return the number of frames before the membrane moves or the recording starts again."""
        unit_m = self._rig.tactile.depth_unit_m
        for number, (before, frame) in enumerate(pairwise(kept), 1):
            if frame.sequence < before.sequence or moved_m(kept[0], frame, unit_m) > MOVED_LIMIT_M:
                return number
        return len(kept)

    def show_found(self, found: Snapshot) -> None:
        few = f"Averaged {counted(found.averaged, 'frame')} instead of {FRAMES}: {self._end}."
        words = few if found.averaged < FRAMES else "Snapshot taken."
        self.sentence.setText(f"{words} Add another inflation level, or continue with the points.")
