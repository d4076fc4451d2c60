"""A camera without depth."""

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
_REMEDIES: Final = {
    "proximity": "raise its laser power or gain, and check that nothing covers its window",
    "tactile": "light the membrane evenly, and check that it has texture and that the lens is clean",
}


def find(situation: Situation) -> Finding | None:
    """Return a finding if a camera measures hardly any depth."""
    return find_in_frame(situation.frame, situation.rig)


def find_in_frame(frame: SensorFrame, rig: Rig) -> Finding | None:
    """Return a finding if a camera measures hardly any depth; it needs no patch."""
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
    return None
