"""Simple rigs, also as files, and their noise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tactune.core.model.alignment import CalibrationRecord, ModelSummary
from tactune.core.model.frames import DepthCamera, Rig
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.model.rig_file import json_text, rig_to_json
from tactune.core.preset import CameraNoise, Preset, RigNoise, now


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


def rig_noise(white_m: float = 0.0002, correlated_m: float = 0.0, distance_m: float = 0.3, **bias: Any) -> RigNoise:
    """The noise of a rig whose cameras are equal; its bias is unknown unless it is given."""
    camera = CameraNoise(
        white_m=white_m, correlated_m=correlated_m, length_px=4.0, changing_share=1.0, distance_m=distance_m
    )
    return RigNoise(proximity=camera, tactile=camera, measured=now(), frames=60, **bias)


def save_rig(rig: Rig, path: Path) -> Path:
    path.write_text(json_text(rig_to_json(rig)), encoding="utf-8")
    return path


def calibrated(preset: Preset, supported_tolerance: float) -> Preset:
    errors = dict.fromkeys(("alignment_px", "alignment_bound_95_px", "boundary_error_mm"), 1.0)
    quality = ModelSummary(**errors, supported_tolerance=supported_tolerance)
    record = CalibrationRecord(date=now(), model=preset.alignment.model, quality=quality)
    return preset.model_copy(update={"alignment": preset.alignment.model_copy(update={"calibration": record})})
