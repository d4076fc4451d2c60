"""Depth averaged over frames while the membrane keeps still, in which noise that changes from frame to frame fades.

Both cameras begin anew at once when the membrane moves, so both depths lag alike: where it touches, their difference
is the same before and after. What moves behind a membrane at rest begins anew by itself.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from ...model.arrays import Uint16Array
from ...model.frames import Rig, SensorFrame
from ..kernels import membrane as kernels
from ..kernels.threads import by_rows

#: Side of the squares over which depth is compared with what is remembered, pixels.
_SIDE_PX: Final = 32
#: A square has moved if its mean depth has changed by more than this share, 0.6 and 0.9 mm at 300 mm. Where membrane
#: and object move together slowly the membrane's is the first, and both cameras begin anew.
_TACTILE_MOVED, _PROXIMITY_MOVED = np.float32(0.002), np.float32(0.003)
#: One pixel begins anew if it differs by more, 6 mm at 300 mm, which is several standard deviations of either camera.
_JUMP_SHARE = np.float32(0.02)


class SteadyDepth:
    """Remembers the mean of both depth images over the last frames.

    Parameters
    ----------
    rig : Rig
    frames : int
        A frame weighs no less than one of so many; older ones fade.

    Attributes
    ----------
    most : int
        As ``frames``; may be changed.
    """

    def __init__(self, rig: Rig, frames: int) -> None:
        self.most = frames
        self._count = 0
        self._proximity = _Means(rig.proximity.intrinsics.shape, _PROXIMITY_MOVED)
        self._tactile = _Means(rig.tactile.intrinsics.shape, _TACTILE_MOVED)

    def add(self, frame: SensorFrame) -> SensorFrame:
        """Return a frame with the mean depths up to it; a pixel without depth takes the one it had before."""
        if self._tactile.moved(frame.tactile_depth):
            self._tactile.forget()
            self._proximity.forget()
            self._count = 0
        else:
            self._proximity.moved(frame.proximity_depth)
        self._count += 1
        return replace(
            frame,
            proximity_depth=self._proximity.add(frame.proximity_depth, self.most),
            tactile_depth=self._tactile.add(frame.tactile_depth, self.most),
        )

    @property
    def full(self) -> bool:
        """Whether as many frames as shall be have come since the membrane last moved."""
        return self._count >= self.most

    @property
    def count(self) -> int:
        """Over how many frames the mean goes, as far as they weigh alike."""
        return min(self._count, self.most)


class _Means:
    """The mean of one camera's depth, in counts, and over how many frames it goes; 0 where there is none."""

    def __init__(self, shape: tuple[int, int], moved_share: np.float32) -> None:
        self._moved_share = moved_share
        self._mean, self._frames = np.zeros(shape, np.float32), np.zeros(shape, np.float32)

    def moved(self, counts: Uint16Array) -> bool:
        """Forget the squares that have moved, and tell whether any has."""
        return bool(kernels.forget_moved(counts, self._mean, self._frames, _SIDE_PX, self._moved_share, _JUMP_SHARE))

    def forget(self) -> None:
        self._frames[:] = 0

    def add(self, counts: Uint16Array, most: int) -> Uint16Array:
        mean = np.empty_like(counts)

        def add_rows(first: int, last: int) -> None:
            parts = (image[first:last] for image in (counts, self._mean, self._frames, mean))
            kernels.add_to_means(*parts, np.float32(most), _JUMP_SHARE)

        by_rows(add_rows, len(counts))
        return mean
