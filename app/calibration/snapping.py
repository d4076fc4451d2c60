"""Clicks jump to the corner or dot nearby."""

from __future__ import annotations

from ...core.calibration.detect import snap_to_feature
from .pictures import Picture
from .state import Place

#: How far, in image pixels, a click may jump.
REACH_PX = 6.0


def snap(picture: Picture, place: Place) -> Place | None:
    """Return the sub-pixel corner or blob centre near a place, or None."""
    found = snap_to_feature(picture.gray, *place, radius=REACH_PX)
    return None if found is None else (found.u, found.v)
