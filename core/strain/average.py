"""Frames of a membrane at rest become one with less noise, from which strain is measured better."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from ..calibration.snapshots import take_snapshot
from ..model.arrays import Float64Array
from ..model.clouds import valid_depth
from ..model.frames import Rig, SensorFrame

#: Movement is looked for in the means over squares of so many pixels, whose noise is some tenths of a millimetre.
_TILE_PX: Final = 32
#: Frames differ where a square has moved by more than this share of its depth, 1.2 mm at 300 mm.
_MOVED_SHARE: Final = 0.004


def average_still(frames: Sequence[SensorFrame], rig: Rig) -> tuple[SensorFrame, int]:
    """Take the median of the newest frame and of those before it in which the membrane had the same shape.

    Parameters
    ----------
    frames : sequence of SensorFrame
        In the order of time, at least one.
    rig : Rig

    Returns
    -------
    frame : SensorFrame
        With the number, time stamps and truth of the newest.
    count : int
        How many frames are in it.

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
    quiet = take_snapshot(same).frame
    return (
        SensorFrame(
            newest.sequence,
            quiet.proximity_depth,
            quiet.tactile_depth,
            quiet.proximity_color,
            quiet.tactile_color,
            newest.proximity_time_s,
            newest.tactile_time_s,
            newest.truth,
        ),
        len(same),
    )


def _moved(frame: SensorFrame, newest: SensorFrame) -> bool:
    """Whether the tactile depth has changed, on the mean over any square of which half has depth in both."""
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
