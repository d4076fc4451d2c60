"""Temporal average of frames in which the membrane is at rest, to measure strain with less noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from ...calibration.snapshots import take_snapshot
from ...model.arrays import Float64Array, Uint16Array
from ...model.clouds import valid_depth
from ...model.frames import Rig, SensorFrame
from ...model.robust import spread

#: Movement test: mean inverse depths of image tiles of this side length, pixels.
_TILE_PX: Final = 32
#: The membrane has moved if two tiles change by more than this number of standard deviations of their noise (one may,
#: at a depth step), or if the mean square of all tiles exceeds that of noise by this factor.
_MOVED_SIGMAS, _MOVED_FACTOR = 6.0, 2.0


def average_still(frames: Sequence[SensorFrame], rig: Rig) -> tuple[SensorFrame, int]:
    """Return the pixelwise median of the newest frame and the frames before it in which the membrane is at rest.

    Parameters
    ----------
    frames : sequence of SensorFrame
        At least one, oldest first.
    rig : Rig

    Returns
    -------
    frame : SensorFrame
        With the sequence number, time stamps and truth of the newest frame.
    count : int
        Number of averaged frames.

    Raises
    ------
    FrameError
        A frame belongs to another rig.
    """
    newest = frames[-1]
    for frame in frames:
        frame.check_against(rig)
    same = [newest]
    for frame in reversed(frames[:-1]):
        if _moved(frame, newest) or (frame.tactile_color is None) != (newest.tactile_color is None):
            break
        same.append(frame)
    if len(same) == 1:
        return newest, 1
    median = take_snapshot(same).frame
    return (
        SensorFrame(
            newest.sequence,
            median.proximity_depth,
            median.tactile_depth,
            median.proximity_color,
            median.tactile_color,
            newest.proximity_time_s,
            newest.tactile_time_s,
            newest.truth,
        ),
        len(same),
    )


def _moved(frame: SensorFrame, newest: SensorFrame) -> bool:
    """Tell whether the membrane has moved between two frames by more than the noise of tiles.

    Movement is smooth, noise is not: a tile minus the mean of its neighbours on either side contains noise only.
    """
    change = _tile_changes(frame.tactile_depth, newest.tactile_depth)
    noise = [change[1:-1] - (change[:-2] + change[2:]) / 2, change[:, 1:-1] - (change[:, :-2] + change[:, 2:]) / 2]
    noise_m = np.concatenate([part[np.isfinite(part)] for part in noise])
    change = change[np.isfinite(change)]
    if not noise_m.size:
        return bool(change.any())
    sigmas = change / max(spread(noise_m) / math.sqrt(1.5), np.finfo(float).tiny)
    return bool(np.count_nonzero(np.abs(sigmas) > _MOVED_SIGMAS) > 1 or np.mean(sigmas**2) > _MOVED_FACTOR)


def _tile_changes(before: Uint16Array, now: Uint16Array) -> Float64Array:
    """Return the mean change of inverse depth of each tile, 1/counts; nan where half of its pixels have no depth."""
    known = valid_depth(before) & valid_depth(now)
    change = np.where(known, 1.0 / np.maximum(now, 1) - 1.0 / np.maximum(before, 1), 0.0)
    count = _tile_sums(known.astype(np.float64))
    return np.where(count >= _TILE_PX**2 / 2, _tile_sums(change) / np.maximum(count, 1), np.nan)


def _tile_sums(image: Float64Array) -> Float64Array:
    height, width = (size // _TILE_PX * _TILE_PX for size in image.shape)
    tiles = image[:height, :width].reshape(height // _TILE_PX, _TILE_PX, width // _TILE_PX, _TILE_PX)
    return np.asarray(tiles.sum(axis=(1, 3)))
