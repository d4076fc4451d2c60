"""What of a calibration goes into the preset."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from ...core.calibration import CalibrationReport
from ...core.preset import Preset
from ...core.preset.calibration_record import SnapshotRecord
from .state import SessionState

_PATHS = (
    "alignment.model",
    "alignment.rigid.T_proximity_tactile",
    "alignment.homography.H_p_t",
    "alignment.depth_scale",
    "alignment.depth_offset_m",
    "alignment.calibration",
    "rig",
)


def preset_values(
    report: CalibrationReport, preset: Preset, state: SessionState, set_tolerance: bool
) -> dict[str, Any]:
    """Return the preset's fields that a calibration sets, by their paths."""
    membrane = report.apply_to(preset, snapshots=snapshot_records(state), set_tolerance=set_tolerance)
    values = {path: membrane.value(path) for path in (*_PATHS, "tolerance.t")}
    return {
        path: value.model_dump(mode="json") if isinstance(value, BaseModel) else value for path, value in values.items()
    }


def snapshot_records(state: SessionState) -> tuple[SnapshotRecord, ...]:
    """Return name, hash and number of averaged frames of each snapshot, in their order."""
    return tuple(
        SnapshotRecord(name=snapshot.name, sha256=snapshot.digest, frames=snapshot.averaged)
        for snapshot in state.snapshots
    )
