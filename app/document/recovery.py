"""Unsaved work outlives a crash: it is kept on disk while it is unsaved, and offered again.

Each window keeps one file. A lock beside it tells a window that is still running from one that
has died; only the files of dead ones are offered.
"""

from __future__ import annotations

import json
import uuid
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from PyQt6.QtCore import QLockFile, QObject, QTimer, pyqtSignal

from ...core.errors import PresetError, TactuneError
from ...core.model.files import atomic_path
from ...core.preset import Preset
from ...core.preset.file import preset_from_text, preset_json
from .document import Document

DELAY_MS = 800


@dataclass(frozen=True)
class UnsavedWork:
    """A preset that was not saved when its window died."""

    file: Path
    preset: Preset
    path: Path | None


class Autosave(QObject):
    """Keeps a document's unsaved state in ``folder`` and removes it once it is saved.

    The disk is touched on a thread of its own, in order, so a slow disk never stalls the window.

    Signals
    -------
    failed(sentence: str)
        The state could not be kept; said once.
    """

    failed = pyqtSignal(str)

    def __init__(self, document: Document, folder: Path, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._document = document
        self._file = folder / f"unsaved-{uuid.uuid4().hex}.json"
        self._said = False
        self._kept: Preset | None = None
        self._disk = ThreadPoolExecutor(max_workers=1, thread_name_prefix="autosave")
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = _lock(self._file)
        self._lock.tryLock(0)
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(DELAY_MS)
        self._timer.timeout.connect(self.flush)
        document.presetChanged.connect(self._timer.start)
        document.fileChanged.connect(self._timer.start)

    @property
    def file(self) -> Path:
        """Where the unsaved state is kept."""
        return self._file

    def flush(self) -> None:
        """Bring the file up to date now: written while there is unsaved work, absent otherwise."""
        self._timer.stop()
        preset = self._document.preset if self._document.dirty else None
        if preset is self._kept:
            return
        self._kept = preset
        if preset is None:
            self._disk.submit(self._file.unlink, missing_ok=True)
        else:
            self._disk.submit(self._write, preset, self._document.path)

    def take_over(self, work: UnsavedWork) -> None:
        """Keep restored work in this window's own file, and only then remove the old one."""
        self.flush()
        self._disk.submit(work.file.unlink, missing_ok=True)

    def close(self, keep: bool = False) -> None:
        """Finish; the kept state goes with the window unless ``keep``."""
        self._timer.stop()
        if not keep:
            self._disk.submit(self._file.unlink, missing_ok=True)
        self._disk.shutdown(wait=True)
        self._lock.unlock()

    def _write(self, preset: Preset, path: Path | None) -> None:
        content = {"path": str(path) if path else None, "preset": json.loads(preset_json(preset))}
        try:
            with atomic_path(self._file) as temporary:
                temporary.write_text(json.dumps(content), encoding="utf-8")
        except (OSError, TactuneError) as error:
            if not self._said:
                self._said = True
                self.failed.emit(f"Unsaved work cannot be kept safe in {self._file.parent} ({error}); save it soon.")


def unsaved_work(folder: Path) -> list[UnsavedWork]:
    """Return what windows that died left behind, newest first. Damaged files are left alone."""
    found = []
    for file in sorted(folder.glob("unsaved-*.json"), key=_modified, reverse=True):
        lock = _lock(file)
        if not lock.tryLock(0):
            continue
        lock.unlock()
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            path = Path(content["path"]) if content["path"] else None
            found.append(UnsavedWork(file, preset_from_text(json.dumps(content["preset"]), origin=str(file)), path))
        except (OSError, ValueError, KeyError, TypeError, PresetError):
            continue
    return found


def _modified(file: Path) -> float:
    try:
        return file.stat().st_mtime
    except OSError:
        return 0.0


def _lock(file: Path) -> QLockFile:
    lock = QLockFile(str(file.with_suffix(".lock")))
    lock.setStaleLockTime(0)
    return lock
