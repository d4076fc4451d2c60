"""Findings that need no patch: a camera without depth, or a tactile camera whose depth unit is wrong."""

from __future__ import annotations

from typing import Final

import numpy as np

from ...model.clouds import valid_depth
from ...model.frames import Rig, SensorFrame
from .proposal import Finding

_STRIDE: Final = 4
#: A camera measures no depth if less than this share of its image has one. Distances of a membrane, metres.
_MIN_SEEN, _PLAUSIBLE_M = 0.05, (0.02, 2.0)


def depth_missing(frame: SensorFrame, rig: Rig) -> Finding | None:
    """Return the finding of `no_depth`; it needs no patch."""
    remedies = {
        "proximity": "raise its laser power or gain, and check that nothing covers its window",
        "tactile": "light the membrane evenly, and check that it has texture and that the lens is clean",
    }
    if rig.tactile.model == "none":
        return None
    for role, remedy in remedies.items():
        counts = frame.proximity_depth if role == "proximity" else frame.tactile_depth
        share = float(np.mean(valid_depth(counts[::_STRIDE, ::_STRIDE])))
        if share < _MIN_SEEN:
            sentence = f"The {role} camera measures no depth in {100 * (1 - share):.0f} % of its image: {remedy}."
            return Finding("no_depth", "cameras", sentence, action="check_cameras", explains_empty=True)
    return wrong_unit(frame, rig)


def wrong_unit(frame: SensorFrame, rig: Rig) -> Finding | None:
    """The tactile camera sees the membrane at a distance that no sensor has."""
    counts = frame.tactile_depth[::_STRIDE, ::_STRIDE]
    counts = counts[valid_depth(counts)]
    if rig.tactile.model == "none" or not len(counts):
        return None
    unit_m = rig.tactile.depth_unit_m
    distance_m = float(np.median(counts)) * unit_m
    if _PLAUSIBLE_M[0] <= distance_m <= _PLAUSIBLE_M[1]:
        return None
    sentence = (
        f"The tactile camera sees the membrane at {distance_m:.2g} m in the median: check its depth_unit_m "
        f"{unit_m:g} in rig.json."
    )
    return Finding("depth_unit", "cameras", sentence, action="check_cameras", explains_empty=True)
