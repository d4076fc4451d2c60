"""Two cameras side by side in front of scenes with known depths."""

from side_by_side import make_frame, rig

__all__ = ["make_frame", "rig"]
