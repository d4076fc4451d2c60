"""State that outlives a crash, such as an unsaved preset: saved soon after each change and read back later."""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Generic, TypeVar

from PyQt6.QtCore import QLockFile, QObject, pyqtSignal

from ...core.errors import TactuneError
from ...core.model.files import atomic_path, remove_leftovers
from ...core.model.loading import read_json
from ...core.preset import Preset, now
from ...core.preset.file import preset_and_note, preset_json
from ...widgets.basics.controls import timer
from .document import Document

T = TypeVar("T")

#: What reading a damaged JSON file, or one of another program, can raise.
DAMAGE = (OSError, ValueError, KeyError, TypeError, TactuneError)


class KeptState(QObject, Generic[T]):
    """Writes a state (`present`) to a file (`write`) ``delay_ms`` after a change, in order, on a thread of its own."""

    failed = pyqtSignal(str)  # the state cannot be written, which is told once, or a saved one cannot be read
    #: Advice at the end of the sentence that writing failed.
    advice = ""

    def __init__(self, folder: Path, noun: str, parent: QObject | None = None, delay_ms: int = 600) -> None:
        super().__init__(parent)
        self.folder = folder
        #: The file to keep up to date; None writes nothing.
        self.file: Path | None = None
        self._noun = noun
        self._written = self.present()
        self._reported = self._unwritten = False
        self._disk = ThreadPoolExecutor(max_workers=1, thread_name_prefix=f"keep {noun}")
        self._timer = timer(self, delay_ms, self.flush, once=True)

    def present(self) -> T:
        """Return the present state, immutable and comparable."""
        raise NotImplementedError

    def write(self, state: T, file: Path) -> None:
        """Write a state; called on the disk's thread. Raise `OSError` or `TactuneError` where that fails."""
        raise NotImplementedError

    def schedule(self, *_: object) -> None:
        """Write soon; connect the signals of changes to it."""
        if not self._timer.isActive():  # not anew: a person who edits without a pause would keep nothing
            self._timer.start()

    def follow(self, file: Path | None, written: T) -> None:
        """Keep another file up to date from now on, which holds the state ``written`` already."""
        self.file, self._written = file, written

    def flush(self) -> None:
        """Start writing the present state now, unless the file holds it already."""
        self._timer.stop()
        state = self.present()
        if self.file is not None and (state != self._written or self._unwritten):
            self._written = state
            self.on_disk(self._write, state, self.file)

    def on_disk(self, work: Callable[..., object], *arguments: object) -> None:
        """Do something on the disk's thread, after everything that was scheduled before."""
        self._disk.submit(work, *arguments)

    def wait(self) -> None:
        """Wait until everything that was scheduled is on the disk."""
        with suppress(RuntimeError):  # finished
            self._disk.submit(lambda: None).result()

    def finish(self) -> None:
        """Wait for the disk; nothing is written afterwards."""
        self._timer.stop()
        self._disk.shutdown(wait=True)

    def read(self, file: Path, parse: Callable[[dict[str, Any]], T]) -> tuple[T, datetime] | None:
        """Return the state that `write_json` saved, and when; None without a file. A damaged file is renamed."""
        try:
            content = read_json(file)
            kept_at = datetime.fromisoformat(content["kept"])
            return parse(content), kept_at
        except (FileNotFoundError, NotADirectoryError):
            return None
        except DAMAGE as error:
            aside = file.with_name(f"{file.stem}-{now():%Y%m%d-%H%M%S}.damaged")
            with suppress(OSError):
                file.replace(aside)
            self.failed.emit(f"The saved {self._noun} {file} cannot be read ({error}); set aside as {aside.name}.")
            return None

    def _write(self, state: T, file: Path) -> None:
        try:
            self.write(state, file)
            self._unwritten = False
        except (OSError, TactuneError) as error:
            self._unwritten = True  # the next flush tries again
            if not self._reported:
                self._reported = True
                self.failed.emit(f"The {self._noun} cannot be kept safe in {file.parent} ({error}){self.advice}.")


def write_json(file: Path, content: dict[str, Any]) -> None:
    """Write a JSON file as a whole or not at all, with the time for `KeptState.read`."""
    with atomic_path(file) as temporary:
        temporary.write_text(json.dumps({"kept": now().isoformat(), **content}), encoding="utf-8")


def lock_of(file: Path) -> QLockFile:
    """Return the lock beside a file, which tells a window that is running from one that has died."""
    lock = QLockFile(str(file.with_suffix(".lock")))
    lock.setStaleLockTime(0)
    return lock


def clean_up(folder: Path) -> None:
    """Remove what killed windows left in a folder and below: temporary files, and locks that nobody holds."""
    remove_leftovers(folder)
    for path in folder.rglob("*.lock"):
        lock_of(path).tryLock(0)  # where nobody holds it, trying removes the file


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
            preset = preset_and_note(json.dumps(content["preset"]), str(file))[0]
            found.append((content["kept"], UnsavedWork(file, preset, path)))
    return [work for _, work in sorted(found, key=lambda kept: kept[0], reverse=True)]
