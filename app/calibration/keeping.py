"""A calibration on disk: one file per rig, which outlives closing and crashing."""

from __future__ import annotations

import json
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from PyQt6.QtCore import QObject

from ...core.calibration.snapshots import content_hash
from ...core.errors import TactuneError
from ...core.model.alignment import PointPair
from ...core.model.files import atomic_path
from ...core.model.loading import frame_bytes, frame_from_bytes, read_file
from ..document.recovery import KeptState, lock_of, write_json
from .session import Choices, Session, SessionState, Snapshot, renumbered, rig_key

_VERSION = 3
#: Windows on one rig that keep files of their own.
_SLOTS = 8


class Keeper(KeptState[SessionState]):
    """Keeps a session's state in a folder, snapshots as files named by digest; a lock gives two windows two files."""

    file: Path

    def __init__(self, session: Session, folder: Path, parent: QObject | None = None) -> None:
        self._session = session
        super().__init__(folder, "calibration", parent)
        self._stored: set[str] = set()
        self._missing: list[str] = []
        folder.mkdir(parents=True, exist_ok=True)
        key = rig_key(session.rig)
        for slot in range(1, _SLOTS + 1):
            file = folder / f"calibration-{key}{'' if slot == 1 else f'-{slot}'}.json"
            self._lock = lock_of(file)
            if self._lock.tryLock(0):
                break
        self.follow(file, session.state)
        session.changed.connect(self.schedule)

    def present(self) -> SessionState:
        return self._session.state

    def restore(self) -> datetime | None:
        """Restore this rig's last session. Return when it was saved, or None if there is none."""
        found = self.read(self.file, self._parse)
        if found is None or found[0].empty:
            return None
        state, kept_at = found
        self._stored = {snapshot.digest for snapshot in state.snapshots}
        self.follow(self.file, state)
        self._session.show(state)
        if self._missing:
            self.failed.emit(f"The images of {len(self._missing)} snapshots are missing; their points remain.")
        return kept_at

    def close(self) -> None:
        self.flush()
        self.finish()
        with suppress(OSError):  # a state that cannot be read may name any of them
            named = b"".join(map(read_file, self.folder.glob("calibration-*")))
            for digest in self._stored:
                if digest.encode() not in named:
                    _images_file(self.folder, digest).unlink(missing_ok=True)
        self._lock.unlock()

    def write(self, state: SessionState, file: Path) -> None:
        for snapshot in state.snapshots:
            images = _images_file(self.folder, snapshot.digest)
            if snapshot.digest not in self._stored or not images.exists():  # another window may have removed it
                with atomic_path(images) as temporary:
                    temporary.write_bytes(frame_bytes(snapshot.frame))
                self._stored.add(snapshot.digest)
        content = {
            "version": _VERSION,
            "snapshots": [
                {"digest": snap.digest, "name": snap.name, "averaged": snap.averaged, "source": snap.source}
                for snap in state.snapshots
            ],
            "pairs": [pair.model_dump(mode="json") for pair in state.pairs],
            "choices": state.choices.model_dump(mode="json"),
        }
        write_json(file, content)

    def _parse(self, content: dict[str, Any]) -> SessionState:
        """Return the saved state without the snapshots whose images are missing."""
        if content["version"] != _VERSION:
            raise ValueError(f"version {content['version']} is not supported")
        snapshots = []
        self._missing = []
        for entry in content["snapshots"]:
            try:
                images = _images_file(self.folder, entry["digest"])
                frame = frame_from_bytes(read_file(images))
                if images != _images_file(self.folder, content_hash(frame)):
                    raise ValueError(f"{images} has been changed")
                frame.check_against(self._session.rig)
            except (OSError, ValueError, TypeError, TactuneError):  # missing, damaged or of another rig
                self._missing.append(entry["name"])
                continue
            snapshots.append(Snapshot(entry["digest"], entry["name"], frame, entry["averaged"], entry["source"]))
        digests = [entry["digest"] for entry in content["snapshots"]]
        pairs = [PointPair.model_validate_json(json.dumps(entry)) for entry in content["pairs"]]
        state = SessionState(
            tuple(snapshots),
            renumbered(pairs, digests, [snapshot.digest for snapshot in snapshots]),
            Choices.model_validate_json(json.dumps(content["choices"])),
        )
        if state.snapshot is None:
            state = state.with_choices(snapshot=snapshots[-1].digest if snapshots else "")
        return state


def _images_file(folder: Path, digest: str) -> Path:
    return folder / f"snapshot-{digest[:24]}.npz"
