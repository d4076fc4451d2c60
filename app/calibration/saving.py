"""What a preset keeps of the wizard's snapshots."""

from __future__ import annotations

from ...core.calibration_record import SnapshotRecord
from .state import SessionState


def snapshot_records(state: SessionState) -> tuple[SnapshotRecord, ...]:
    """Return name, hash and number of averaged frames of each snapshot, in their order."""
    return tuple(
        SnapshotRecord(name=snapshot.name, sha256=snapshot.digest, frames=snapshot.averaged)
        for snapshot in state.snapshots
    )
