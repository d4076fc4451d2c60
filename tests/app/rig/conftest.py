"""Two cameras side by side in front of scenes with known depths."""

from __future__ import annotations

import os

if not any(os.environ.get(name) for name in ("QT_QPA_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY")):
    os.environ["QT_QPA_PLATFORM"] = "offscreen"

from side_by_side import make_frame, rig

__all__ = ["make_frame", "rig"]
