"""Simple rigs, also as files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tactune.core.model.frames import DepthCamera, Rig
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.model.rig_file import json_text, rig_to_json


def one_place_rig(
    width: int, height: int, focal_px: float, unit_m: float = 0.00025, tactile_unit_m: float = 0.0001, serial: str = "1"
) -> Rig:
    """Both cameras in one place, so that pixels match one to one."""
    lens = Intrinsics(width=width, height=height, fx=focal_px, fy=focal_px, cx=(width - 1) / 2, cy=(height - 1) / 2)
    return Rig(
        proximity=DepthCamera(model="L515", serial=f"p{serial}", intrinsics=lens, depth_unit_m=unit_m),
        tactile=DepthCamera(model="D405", serial=f"t{serial}", intrinsics=lens, depth_unit_m=tactile_unit_m),
        T_proximity_tactile=np.eye(4).tolist(),
    )


def save_rig(rig: Rig, path: Path) -> Path:
    """Write a rig file, and return its path."""
    path.write_text(json_text(rig_to_json(rig)), encoding="utf-8")
    return path
