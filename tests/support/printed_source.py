"""A tiny recording of a membrane with prints that reflect infrared, with an untouched frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fakes import CONTACT_RGB, FakeSource, tiny_frame, tiny_rig
from tactune.core.model.arrays import BoolArray, Uint16Array
from tactune.core.model.frames import Rig, SensorFrame

PRINT_RGB = (214, 40, 160)
#: Rows and columns of the prints.
PRINTS = ((slice(8, 28), slice(8, 28)), (slice(90, 112), slice(130, 152)))


def printed(frame: SensorFrame, rig: Rig) -> SensorFrame:
    """Return a frame with prints, on which the proximity camera measures the membrane."""
    depth, color = frame.proximity_depth.copy(), frame.proximity_color.copy()
    for place in PRINTS:
        depth[place], color[place] = behind_membrane(frame, rig, 0.0)[place], PRINT_RGB
    return replace(frame, proximity_depth=depth, proximity_color=color)


def behind_membrane(frame: SensorFrame, rig: Rig, gap_m: float) -> Uint16Array:
    """Return the proximity depth of a surface behind the membrane, counts."""
    membrane_m = frame.tactile_depth * rig.tactile.depth_unit_m
    return np.rint((membrane_m + gap_m) / rig.proximity.depth_unit_m).astype(np.uint16)


class PrintedSource(FakeSource):
    """Frames of 160 x 120 pixels; a disc of 2 mm gap grows with the frame number."""

    def __init__(self, with_untouched: bool = True) -> None:
        super().__init__(rig=tiny_rig(160, 120))
        self.name = "printed" if with_untouched else "printed, no untouched frame"
        self._with_untouched = with_untouched

    def read(self, index: int) -> SensorFrame:
        frame = tiny_frame(index, self.rig)
        wall = behind_membrane(frame, self.rig, 0.06)
        depth = np.where(touching(frame), frame.proximity_depth, wall)
        return printed(replace(frame, proximity_depth=depth), self.rig)

    def untouched(self) -> SensorFrame | None:
        return untouched_frame(self.rig) if self._with_untouched else None


def touching(frame: SensorFrame) -> BoolArray:
    """Return where the disc touches the membrane."""
    return (frame.proximity_color == CONTACT_RGB).all(axis=2)


def untouched_frame(rig: Rig) -> SensorFrame:
    """Return the frame without an object; the wall is 60 mm behind the membrane."""
    frame = tiny_frame(-4, rig)
    return printed(replace(frame, proximity_depth=behind_membrane(frame, rig, 0.06)), rig)
