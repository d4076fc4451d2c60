"""Depth averaged over frames while the membrane keeps still, in which noise that changes from frame to frame fades.

Both cameras begin anew at once when the membrane moves, so that both depths are as old as each other: where it
touches, their difference is the same before and after.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from ..frames import Rig, SensorFrame
from ..threads import by_rows
from . import kernels

Counts = npt.NDArray[np.uint16]

#: Side of the squares over which depth is compared with what is remembered, pixels.
_SIDE_PX: Final = 32
#: A square has moved if its mean depth has changed by more than this share, 0.6 mm at 300 mm; one pixel begins anew
#: if it differs by more than that share, 6 mm at 300 mm, which is several standard deviations of either camera.
_MOVED_SHARE, _JUMP_SHARE = np.float32(0.002), np.float32(0.02)


class SteadyDepth:
    """Remembers the mean of both depth images over the last frames.

    Parameters
    ----------
    rig : Rig
    frames : int
        A mean weighs at most so many frames; older ones fade.
    """

    def __init__(self, rig: Rig, frames: int) -> None:
        self._most = np.float32(frames)
        self._proximity, self._tactile = (_Means(camera.intrinsics.shape) for camera in (rig.proximity, rig.tactile))

    def add(self, frame: SensorFrame) -> SensorFrame:
        """Return a frame with the mean depths up to it; a pixel without depth takes the one it had before."""
        if self._tactile.moved(frame.tactile_depth):
            self._tactile.forget()
            self._proximity.forget()
        else:
            self._proximity.moved(frame.proximity_depth)
        return replace(
            frame,
            proximity_depth=self._proximity.add(frame.proximity_depth, self._most),
            tactile_depth=self._tactile.add(frame.tactile_depth, self._most),
        )


class _Means:
    """The mean of one camera's depth, in counts, and over how many frames it goes; 0 where there is none."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._mean, self._frames = np.zeros(shape, np.float32), np.zeros(shape, np.float32)

    def moved(self, counts: Counts) -> bool:
        """Forget the squares that have moved, and tell whether any has."""
        return bool(kernels.forget_moved(counts, self._mean, self._frames, _SIDE_PX, _MOVED_SHARE, _JUMP_SHARE))

    def forget(self) -> None:
        self._frames[:] = 0

    def add(self, counts: Counts, most: np.float32) -> Counts:
        mean = np.empty_like(counts)

        def add_rows(first: int, last: int) -> None:
            rows = slice(first, last)
            kernels.add_to_means(counts[rows], self._mean[rows], self._frames[rows], most, _JUMP_SHARE, mean[rows])

        by_rows(add_rows, len(counts))
        return mean
