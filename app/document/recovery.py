"""Crash recovery: each window keeps its unsaved preset in a file, and a lock beside it while it runs.

Files of windows that have died are offered at the next start.
"""

from __future__ import annotations

import json
import uuid
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from PyQt6.QtCore import QObject

from ...core.model.loading import read_json
from ...core.preset import Preset
from ...core.preset.file import preset_from_text, preset_json
from .document import Document
from .keeping import DAMAGE, KeptState, clean_up, lock_of, write_json


@dataclass(frozen=True)
class UnsavedWork:
    """A preset that was not saved when its window died."""

    file: Path
    preset: Preset
    path: Path | None


class Autosave(KeptState[tuple[Preset, Path | None] | None]):
    """Keeps a document's unsaved preset and its path in ``folder``; removes the file once the preset is saved."""

    file: Path
    advice = "; save it soon"

    def __init__(self, document: Document, folder: Path, parent: QObject | None = None) -> None:
        self._document = document
        super().__init__(folder, "unsaved preset", parent, delay_ms=800)
        folder.mkdir(parents=True, exist_ok=True)
        self.follow(folder / f"unsaved-{uuid.uuid4().hex}.json", None)
        self._lock = lock_of(self.file)
        self._lock.tryLock(0)
        self.on_disk(clean_up, folder)
        document.presetChanged.connect(self.schedule)
        document.fileChanged.connect(self.schedule)

    def present(self) -> tuple[Preset, Path | None] | None:
        return (self._document.preset, self._document.path) if self._document.dirty else None

    def write(self, state: tuple[Preset, Path | None] | None, file: Path) -> None:
        if state is None:
            file.unlink(missing_ok=True)
        else:
            preset, path = state
            write_json(file, {"path": str(path) if path else None, "preset": json.loads(preset_json(preset))})

    def take_over(self, work: UnsavedWork) -> None:
        """Keep restored work in this window's own file, and only then remove the old one."""
        self.flush()
        self.on_disk(lambda: work.file.unlink(missing_ok=True) if self.file.exists() else None)

    def close(self, keep: bool = False) -> None:
        """Finish; the file is removed unless ``keep``."""
        if not keep:
            self.on_disk(lambda: self.file.unlink(missing_ok=True))
        self.finish()
        self._lock.unlock()


def unsaved_work(folder: Path) -> list[UnsavedWork]:
    """Return the unsaved work of windows that died, newest first. Damaged files are left alone."""
    found = []
    for file in folder.glob("unsaved-*.json"):
        lock = lock_of(file)
        if not lock.tryLock(0):
            continue
        lock.unlock()
        with suppress(*DAMAGE):
            content = read_json(file)
            path = Path(content["path"]) if content["path"] else None
            preset = preset_from_text(json.dumps(content["preset"]), origin=str(file))
            found.append((content["kept"], UnsavedWork(file, preset, path)))
    return [work for _, work in sorted(found, key=lambda kept: kept[0], reverse=True)]
