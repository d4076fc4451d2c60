"""A camera without depth, or a tactile camera whose depth unit is wrong."""

from __future__ import annotations

from typing import Final

import numpy as np

from ....model.clouds import valid_depth
from ....model.frames import Rig, SensorFrame
from ..proposal import Finding
from .situation import Situation

#: A camera measures no depth if less than this share of its image has one.
_MIN_SHARE: Final = 0.05
_STRIDE: Final = 4
#: Median distances between which a tactile camera sees a membrane, metres.
_PLAUSIBLE_M: Final = (0.02, 2.0)
_REMEDIES: Final = {
    "proximity": "raise its laser power or gain, and check that nothing covers its window",
    "tactile": "light the membrane evenly, and check that it has texture and that the lens is clean",
}


def find(situation: Situation) -> Finding | None:
    """Return a finding if a camera measures hardly any depth, or if the tactile depth is implausible."""
    return find_in_frame(situation.frame, situation.rig)


def find_in_frame(frame: SensorFrame, rig: Rig) -> Finding | None:
    """Return the finding of `find`; it needs no patch."""
    if rig.tactile.model == "none":
        return None
    for role, remedy in _REMEDIES.items():
        counts = frame.proximity_depth if role == "proximity" else frame.tactile_depth
        share = float(np.mean(valid_depth(counts[::_STRIDE, ::_STRIDE])))
        if share < _MIN_SHARE:
            return Finding(
                name="no_depth",
                field="cameras",
                sentence=f"The {role} camera measures no depth in {100 * (1 - share):.0f} % of its image: {remedy}.",
                action="check_cameras",
                explains_empty=True,
            )
    return find_wrong_unit(frame, rig)


def find_wrong_unit(frame: SensorFrame, rig: Rig) -> Finding | None:
    """Return a finding if the tactile camera sees the membrane at a distance that no sensor has."""
    counts = frame.tactile_depth[::_STRIDE, ::_STRIDE]
    counts = counts[valid_depth(counts)]
    if rig.tactile.model == "none" or not len(counts):
        return None
    unit_m = rig.tactile.depth_unit_m
    distance_m = float(np.median(counts)) * unit_m
    if _PLAUSIBLE_M[0] <= distance_m <= _PLAUSIBLE_M[1]:
        return None
    return Finding(
        name="depth_unit",
        field="cameras",
        sentence=f"The tactile camera sees the membrane at {distance_m:.2g} m in the median: check its depth_unit_m "
        f"{unit_m:g} in rig.json.",
        action="check_cameras",
        explains_empty=True,
    )
