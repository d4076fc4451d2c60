"""stub"""

from __future__ import annotations

from ...core.errors import CalibrationError
from ...core.frames import Rig
from .state import PointPair, Snapshot


def texture_pairs(snapshot: Snapshot, rig: Rig) -> list[PointPair]:
    """Stub."""
    raise CalibrationError("texture matching is not there yet")
