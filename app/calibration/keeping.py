"""Work on a calibration outlives closing, cancelling and crashing: it is kept on disk and offered again."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from PyQt6.QtCore import QLockFile, QObject, QTimer, pyqtSignal

from ...core.calibration.snapshots import content_hash
from ...core.errors import TactuneError
from ...core.model.files import atomic_path
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import now
from .session import Session
from .state import Choices, PointPair, SessionState, Snapshot, rig_key

DELAY_MS = 600
_VERSION = 1
_SLOTS = 8
_IMAGES = ("proximity_depth", "tactile_depth", "proximity_color", "tactile_color")


class Keeper(QObject):
    """Keeps a session's state in a folder, one file per rig; snapshots lie beside it under their digest.

    A lock keeps two windows on the same rig apart. The disk is touched on a thread of its own, in order.

    Signals
    -------
    failed(sentence: str)
        The state could not be kept; said once.
    """

    failed = pyqtSignal(str)

    def __init__(self, session: Session, folder: Path, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._session, self._folder = session, folder
        self._stored: set[str] = set()
        self._kept = session.state
        self._said = False
        self._disk = ThreadPoolExecutor(max_workers=1, thread_name_prefix="calibration")
        folder.mkdir(parents=True, exist_ok=True)
        self.file, self._lock = _free_slot(folder, rig_key(session.rig))
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(DELAY_MS)
        self._timer.timeout.connect(self.flush)
        session.changed.connect(self._timer.start)

    def restore(self) -> datetime | None:
        """Show what was kept of this rig's last session; returns when that was, None where there is nothing."""
        try:
            content = json.loads(self.file.read_text(encoding="utf-8"))
            state, missing = _state_of(content, self._folder, self._session.rig)
            kept_at = datetime.fromisoformat(content["kept"])
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, TactuneError) as error:
            with suppress(OSError):
                self.file.replace(self.file.with_suffix(".damaged"))
            self.failed.emit(f"The kept calibration in {self.file.parent} cannot be read ({error}); it was set aside.")
            return None
        if state.empty:
            return None
        self._stored = {snapshot.digest for snapshot in state.snapshots}
        self._kept = state
        self._session.show(state)
        if missing:
            self.failed.emit(f"Images of {len(missing)} snapshots are gone; their points are kept without them.")
        return kept_at

    def flush(self) -> None:
        """Have the file brought up to date, soon and in order."""
        self._timer.stop()
        state = self._session.state
        if state == self._kept:
            return
        self._kept = state
        fresh = [snapshot for snapshot in state.snapshots if snapshot.digest not in self._stored]
        self._stored |= {snapshot.digest for snapshot in fresh}
        self._disk.submit(self._write, state, fresh)

    def close(self) -> None:
        """Write the last state, tidy up, and let go of the file."""
        self.flush()
        self._disk.submit(_tidy, self._folder)
        self._disk.shutdown(wait=True)
        self._lock.unlock()

    def _write(self, state: SessionState, fresh: list[Snapshot]) -> None:
        try:
            for snapshot in fresh:
                _write_images(_images_file(self._folder, snapshot.digest), snapshot.frame)
            with atomic_path(self.file) as temporary:
                temporary.write_text(json.dumps(_content(state)), encoding="utf-8")
        except (OSError, TactuneError) as error:
            if not self._said:
                self._said = True
                self.failed.emit(f"The calibration cannot be kept safe in {self._folder} ({error}).")


def _free_slot(folder: Path, key: str) -> tuple[Path, QLockFile]:
    """Return the first file of a rig that no living window holds, locked."""
    for slot in range(1, _SLOTS + 1):
        file = folder / f"calibration-{key}{'' if slot == 1 else f'-{slot}'}.json"
        lock = QLockFile(str(file.with_suffix(".lock")))
        lock.setStaleLockTime(0)
        if lock.tryLock(0) or slot == _SLOTS:
            break
    return file, lock


def _content(state: SessionState) -> dict[str, Any]:
    return {
        "version": _VERSION,
        "kept": now().isoformat(),
        "snapshots": [
            {"digest": snap.digest, "name": snap.name, "averaged": snap.averaged, "moved_m": snap.moved_m,
             "sequence": snap.frame.sequence}
            for snap in state.snapshots
        ],
        "pairs": [pair.model_dump(mode="json") for pair in state.pairs],
        "choices": state.choices.model_dump(mode="json"),
    }  # fmt: skip


def _state_of(content: dict[str, Any], folder: Path, rig: Rig) -> tuple[SessionState, list[str]]:
    if content["version"] != _VERSION:
        raise ValueError(f"version {content['version']} is not known here")
    snapshots, missing = [], []
    for entry in content["snapshots"]:
        try:
            frame = _read_images(_images_file(folder, entry["digest"]), entry["sequence"])
            frame.check_against(rig)
        except (OSError, ValueError, KeyError, TactuneError):
            missing.append(entry["name"])
            continue
        snapshots.append(Snapshot(entry["digest"], entry["name"], frame, entry["averaged"], entry["moved_m"]))
    pairs = tuple(PointPair.model_validate_json(json.dumps(entry)) for entry in content["pairs"])
    state = SessionState(tuple(snapshots), pairs, Choices.model_validate_json(json.dumps(content["choices"])))
    if state.snapshot is None:
        state = state.with_choices(snapshot=snapshots[-1].digest if snapshots else "")
    return state, missing


def _images_file(folder: Path, digest: str) -> Path:
    return folder / f"snapshot-{digest[:24]}.npz"


def _write_images(path: Path, frame: SensorFrame) -> None:
    images = {name: image for name in _IMAGES if (image := getattr(frame, name)) is not None}
    with atomic_path(path) as temporary:
        np.savez(temporary, **images)


def _read_images(path: Path, sequence: int) -> SensorFrame:
    with np.load(path) as stored:
        images = {name: stored[name] for name in _IMAGES if name in stored}
    frame = SensorFrame(sequence=sequence, **images)
    if not path.name.startswith(f"snapshot-{content_hash(frame)[:24]}"):
        raise ValueError(f"{path} has been changed")
    return frame


def _tidy(folder: Path) -> None:
    """Remove images that no kept session mentions."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        wanted = set()
        for file in folder.glob("calibration-*.json"):
            for entry in json.loads(file.read_text(encoding="utf-8"))["snapshots"]:
                wanted.add(_images_file(folder, entry["digest"]).name)
        for file in folder.glob("snapshot-*.npz"):
            if file.name not in wanted:
                file.unlink()
