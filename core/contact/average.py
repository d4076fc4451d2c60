"""Temporal average of both depth images while the membrane is still, which reduces temporal noise."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from ..model.arrays import Uint16Array
from ..model.frames import Rig, SensorFrame
from ..model.rig_noise import CameraNoise, RigNoise
from .kernels import membrane as kernels
from .kernels.threads import in_parallel

#: Side of the image blocks whose mean depth is compared with the average, pixels.
_SIDE_PX: Final = 32
#: A block has moved if its mean depth has changed by more than this share: 0.6 and 0.9 mm at 300 mm. The tactile limit
#: is the smaller one, so that a membrane and object that move together slowly restart both averages.
_TACTILE_MOVED, _PROXIMITY_MOVED = np.float32(0.002), np.float32(0.003)
#: Change of a block's mean that counts as noise, standard deviations of the noise of one frame.
_NOISE_SIGMAS: Final = 5.0
#: A single pixel restarts if it differs by more: 6 mm at 300 mm, several standard deviations of either camera.
_JUMP_SHARE = np.float32(0.02)


class AveragedDepth:
    """The running mean of both depth images, in which each new frame weighs at least 1 / ``max_frames``.

    The averages of both cameras restart together when the membrane moves, so both depths lag equally and their
    difference in contact stays unchanged. Objects that move behind a still membrane restart the proximity average
    alone. Where the measured noise is large, a larger change counts as movement.
    """

    def __init__(self, rig: Rig, frames: int, noise: RigNoise | None = None) -> None:
        self.max_frames = frames
        self._count = 0
        self._rig = rig
        self._proximity, self._tactile = _Means(rig.proximity.intrinsics.shape), _Means(rig.tactile.intrinsics.shape)
        self.expect(noise)

    def expect(self, noise: RigNoise | None) -> None:
        """Tell movement from this noise, or from the usual noise for None; the averages are kept."""
        self._proximity.moved_share, self._tactile.moved_share = _PROXIMITY_MOVED, _TACTILE_MOVED
        if noise is not None:
            proximity_px, tactile_px = self._rig.proximity.intrinsics.fx, self._rig.tactile.intrinsics.fx
            self._proximity.moved_share = max(_PROXIMITY_MOVED, _largest_change(noise.proximity, proximity_px))
            self._tactile.moved_share = max(_TACTILE_MOVED, _largest_change(noise.tactile, tactile_px))

    def add(self, frame: SensorFrame) -> SensorFrame:
        """Return the frame with mean depths; a pixel without depth keeps its earlier mean."""
        if self._tactile.moved(frame.tactile_depth):
            self._tactile.forget()
            self._proximity.forget()
            self._count = 0
        else:
            self._proximity.moved(frame.proximity_depth)
        self._count += 1
        return replace(
            frame,
            proximity_depth=self._proximity.add(frame.proximity_depth, self.max_frames),
            tactile_depth=self._tactile.add(frame.tactile_depth, self.max_frames),
        )

    @property
    def count(self) -> int:
        """Number of averaged frames."""
        return min(self._count, self.max_frames)


def _largest_change(noise: CameraNoise, focal_px: float) -> np.float32:
    """Return the largest change of a block's mean depth that noise explains, as a share of the depth."""
    side_m = _SIDE_PX * noise.distance_m / focal_px
    sigma_m = math.sqrt(noise.changing_share * noise.density_m4(focal_px)) / side_m
    return np.float32(min(_NOISE_SIGMAS * sigma_m / noise.distance_m, 1.0))


class _Means:
    """The mean of one camera's depth, in counts, and its number of frames per pixel; 0 without depth."""

    moved_share: np.float32  # A block has moved if its mean depth has changed by more than this share

    def __init__(self, shape: tuple[int, int]) -> None:
        self._mean, self._frames = np.zeros(shape, np.float32), np.zeros(shape, np.float32)

    def moved(self, counts: Uint16Array) -> bool:
        """Forget the blocks that have moved; return whether any has."""
        return bool(kernels.forget_moved(counts, self._mean, self._frames, _SIDE_PX, self.moved_share, _JUMP_SHARE))

    def forget(self) -> None:
        self._frames[:] = 0

    def add(self, counts: Uint16Array, max_frames: int) -> Uint16Array:
        mean = np.empty_like(counts)

        def add_rows(first: int, last: int) -> None:
            parts = (image[first:last] for image in (counts, self._mean, self._frames, mean))
            kernels.add_to_means(*parts, np.float32(max_frames), _JUMP_SHARE)

        in_parallel(add_rows, len(counts))
        return mean
