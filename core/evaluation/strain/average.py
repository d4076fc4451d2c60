"""Temporal average of frames in which the membrane is at rest, to measure strain with less noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from ...calibration.snapshots import take_snapshot
from ...model.arrays import Float64Array
from ...model.clouds import valid_depth
from ...model.frames import Rig, SensorFrame

#: Movement test: the mean depth of image tiles of this side length, pixels; its noise is a few tenths of a millimetre.
_TILE_PX: Final = 32
#: The membrane has moved if the mean depth of a tile changes by more than this share (1.2 mm at 300 mm).
_MOVED_SHARE: Final = 0.004


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
    """Tell whether the mean tactile depth of any tile has changed. Tiles need depth in half of their pixels."""
    before, now = frame.tactile_depth, newest.tactile_depth
    valid = valid_depth(before) & valid_depth(now)
    change = np.where(valid, before.astype(np.float64) - now, 0.0)
    known = _tile_sums(valid.astype(np.float64))
    depth = _tile_sums(np.where(valid, now, 0.0))
    judged = known >= _TILE_PX**2 / 2
    return bool((np.abs(_tile_sums(change)) > _MOVED_SHARE * depth)[judged].any())


def _tile_sums(image: Float64Array) -> Float64Array:
    height, width = (size // _TILE_PX * _TILE_PX for size in image.shape)
    tiles = image[:height, :width].reshape(height // _TILE_PX, _TILE_PX, width // _TILE_PX, _TILE_PX)
    return np.asarray(tiles.sum(axis=(1, 3)))
