"""What a check looks at."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from ....model.clouds import valid_depth
from ....model.frames import Rig, SensorFrame
from ....model.patch import ContactPatch
from ....preset import Preset

_STRIDE: Final = 6


@dataclass(frozen=True, eq=False)
class Situation:
    """The present frame and preset.

    Attributes
    ----------
    frame : SensorFrame
    patch : ContactPatch
        That of the frame and preset.
    preset : Preset
    rig : Rig
    untouched : SensorFrame or None
        The stored untouched frame.
    untouched_patch : ContactPatch or None
        The patch of the preset in it.
    """

    frame: SensorFrame
    patch: ContactPatch
    preset: Preset
    rig: Rig
    untouched: SensorFrame | None = None
    untouched_patch: ContactPatch | None = None

    @property
    def one_camera(self) -> bool:
        """Whether the source has no tactile camera."""
        return self.rig.tactile.model == "none"

    @cached_property
    def distance_m(self) -> float:
        """Median distance of the membrane from the tactile camera, metres; nan without depth."""
        counts = self.frame.tactile_depth[::_STRIDE, ::_STRIDE]
        counts = counts[valid_depth(counts)]
        if not len(counts):
            return float("nan")
        alignment = self.preset.alignment
        return (
            float(np.median(counts)) * self.rig.tactile.depth_unit_m * alignment.depth_scale + alignment.depth_offset_m
        )
