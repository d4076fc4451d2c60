"""File actions: open and save presets, open recordings, export patches; asks before unsaved changes are lost."""

from __future__ import annotations

import re
from collections.abc import Callable
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any

from PyQt6.QtCore import QObject, QRunnable, QThreadPool, pyqtSignal

from ...core.errors import TactuneError
from ...core.preset import Preset, now
from ...core.recording.cloud_files import patch_cloud, write_cloud
from ...core.sources.presets import load_preset
from ...core.sources.registry import source_kinds
from ...widgets.basics.message_bar import MessageBar, Severity
from ..context import Context
from ..document.recovery import Autosave, UnsavedWork, unsaved_work
from ..worker.results import Result
from .actions import Actions

#: Kinds of recordings that may consist of two files, one for each camera.
_IN_TWO_FILES = ("bag",)
PRESET_FILTER = "Presets (*.json)"
EXPORT_FILTERS = ["PLY, binary (*.ply)", "PCD, binary (*.pcd)", "NumPy (*.npz)", "Table (*.csv)"]


class FileFlows(QObject):
    """Opens, saves and exports, with dialogs and messages.

    Parameters
    ----------
    context : Context
    autosave : Autosave
        Takes over unsaved work that is restored.
    """

    def __init__(self, context: Context, autosave: Autosave) -> None:
        super().__init__(context)
        self._context, self._autosave = context, autosave
        context.saveRequested.connect(self.save)
        self._document, self._dialogs = context.document, context.dialogs
        self._settings, self._messages = context.settings, context.messages

    def connect_actions(self, actions: Actions) -> None:
        """Connect the file actions."""
        actions.new_preset.triggered.connect(lambda _: self.new())
        actions.open_preset.triggered.connect(self.open_preset_dialog)
        actions.save.triggered.connect(lambda _: self.save())
        actions.save_as.triggered.connect(lambda _: self.save_as())
        actions.details.triggered.connect(self.details)
        actions.open_folder.triggered.connect(self.open_folder_dialog)
        actions.open_recording.triggered.connect(self.open_recording_dialog)
        actions.export_patch.triggered.connect(self.export_dialog)

    # Presets

    def guarded(self, then: Callable[[], object]) -> None:
        """Call ``then``, which replaces the preset, after asking about unsaved changes."""
        if not self._document.dirty:
            then()
            return
        self._dialogs.ask_unsaved(self._document.preset.name, save=lambda: self.save(then), discard=then)

    def new(self, shipped: str = "default") -> None:
        """Start a new preset from a shipped one."""

        def begin() -> None:
            created = now()
            preset = load_preset(shipped)
            self._document.new(preset.model_copy(update={"name": "untitled", "created": created, "modified": created}))

        self.guarded(partial(self._told, begin))

    def offer_preset(self, preset: Preset | None) -> None:
        """Offer the preset in a recording, unless it is already in use."""
        if preset is None or preset == self._document.preset:
            self._messages.clear("recorded preset")
            return
        self._messages.show_message(
            "recorded preset",
            Severity.INFO,
            f"This recording contains the preset {preset.name!r}; {self._document.preset.name!r} is in use.",
            [("Use recorded preset", lambda: self.guarded(lambda: self._document.new(preset)))],
        )

    def open_preset_dialog(self) -> None:
        """Ask for a preset file and open it."""
        self.guarded(
            lambda: self._dialogs.open_file("Open preset", self._folder("preset"), PRESET_FILTER, self._read_preset)
        )

    def open_preset(self, path: Path) -> None:
        """Open a preset file, after asking about unsaved changes."""
        self.guarded(lambda: self._read_preset(path))

    def save(self, then: Callable[[], object] | None = None) -> None:
        """Save to the document's file, or ask for one; ``then`` runs only after success."""
        if self._document.path is None:
            self.save_as(then)
        else:
            self._write_preset(self._document.path, then)

    def save_as(self, then: Callable[[], object] | None = None) -> None:
        """Ask where to save."""
        suggestion = self._document.path or self._folder("preset") / f"{file_name(self._document.preset.name)}.json"
        self._dialogs.save_file("Save preset", suggestion, [PRESET_FILTER], lambda path: self._write_preset(path, then))

    def details(self) -> None:
        """Ask for the preset's name and notes."""
        preset = self._document.preset
        self._dialogs.ask_details(
            preset.name,
            preset.notes,
            lambda name, notes: self._document.edit_many({"name": name, "notes": notes}),
        )

    # Recordings

    def open_folder_dialog(self) -> None:
        """Ask for a recording stored as a folder."""
        self._dialogs.open_folder(
            "Open a recorded folder", self._folder("source"), lambda path: self._open_recording(f"folder:{path}", path)
        )

    def open_recording_dialog(self) -> None:
        """Ask for one recording, or for the two files of two cameras."""
        self._dialogs.open_files("Open a recording", self._folder("source"), recording_filters(), self.open_recordings)

    def open_recordings(self, paths: list[Path]) -> None:
        """Open one recording, or two files of the same kind that belong together; else say why not."""
        schemes = {recording_scheme(path) for path in paths}
        scheme = schemes.pop() if len(schemes) == 1 else ""
        if not scheme:
            names = ", ".join(path.name for path in paths)
            endings = " ".join(recording_endings())
            what = "is no recording" if len(paths) == 1 else "are recordings of different kinds"
            self._refuse(f"{names} {what} (files {endings}, or a folder with rig.json); nothing was changed.")
        elif len(paths) > (2 if scheme in _IN_TWO_FILES else 1):
            self._refuse("Open one recording at a time, or the two .bag files of two cameras; nothing was changed.")
        else:
            self._open_recording(f"{scheme}:{','.join(map(str, sorted(paths)))}", paths[0])

    def open_dropped(self, paths: list[Path]) -> None:
        """Open the preset or recording that was dropped on the window, or say why not."""
        first = paths[0]
        if len(paths) == 1 and first.is_dir():
            self._open_recording(f"folder:{first}", first)
        elif len(paths) == 1 and first.suffix.lower() == ".json":
            self.open_preset(first)
        elif len(paths) == 1 and not recording_scheme(first):
            self._refuse(
                f"{first.name} is neither a preset (.json) nor a recording (a folder with rig.json, or a file "
                f"{' '.join(recording_endings())}); nothing was changed."
            )
        else:
            self.open_recordings(paths)

    def recordings_folder_dialog(self, present: Path, use: Callable[[Path], None]) -> None:
        """Ask for the folder for recordings."""
        self._dialogs.open_folder("Folder for recordings", present if present.is_dir() else Path.home(), use)

    # Export

    def export_dialog(self) -> None:
        """Ask where to save the patch of the present frame."""
        result = self._context.result
        if result is None or result.patch is None:
            return
        suggestion = self._folder("export") / f"patch_{result.patch.sequence:06d}.ply"

        def chosen(path: Path) -> None:
            self._settings.set("folder/export", str(path.parent))
            export_patch(result, path, self._messages)

        self._dialogs.save_file("Export this patch", suggestion, EXPORT_FILTERS, chosen)

    # Unsaved work of a window that crashed

    def offer_unsaved_work(self) -> None:
        """Offer the unsaved work of a window that crashed, newest first, one piece after the other."""
        pieces = unsaved_work(self._context.data_folder)
        if not pieces:
            return
        newest = pieces[0]
        where = f" ({newest.path})" if newest.path else ""

        def discard() -> None:
            newest.file.unlink(missing_ok=True)
            self.offer_unsaved_work()

        self._messages.show_message(
            "recovery",
            Severity.INFO,
            f"Tactune ended without saving “{newest.preset.name}”{where}. Its unsaved changes were kept.",
            offers=[("Restore", lambda: self.guarded(lambda: self._restore(newest))), ("Discard", discard)],
        )

    def _restore(self, work: UnsavedWork) -> None:
        self._document.restore(work.preset, work.path)
        self._autosave.take_over(work)

    # Steps

    def _read_preset(self, path: Path) -> None:
        if self._told(lambda: self._document.open(path)):
            self._messages.clear("file")
            self._settings.set("folder/preset", str(path.parent))
            self._settings.add_recent("presets", str(path))
        elif not path.exists():
            self._settings.remove_recent("presets", str(path))

    def _write_preset(self, path: Path, then: Callable[[], object] | None) -> None:
        self._complete(path)
        if not self._told(lambda: self._document.save(path)):
            return
        self._messages.clear("file")
        self._settings.set("folder/preset", str(path.parent))
        self._settings.add_recent("presets", str(path))
        if then is not None:
            then()

    def _complete(self, path: Path) -> None:
        """Set a preset's name and rig before it is saved, if they are missing."""
        preset, result = self._document.preset, self._context.result
        missing: dict[str, Any] = {}
        if preset.name == "untitled":
            missing["name"] = path.stem[:120] or "untitled"
        if preset.rig is None and result is not None:
            missing["rig"] = result.source.rig.model_dump(mode="json")
        if missing:
            self._document.edit_many(missing)

    def _refuse(self, sentence: str) -> None:
        self._messages.show_message("file", Severity.ERROR, sentence)

    def _open_recording(self, name: str, path: Path) -> None:
        self._settings.set("folder/source", str(path.parent))
        self._context.sourceRequested.emit(name)

    def _told(self, action: Callable[[], None]) -> bool:
        """Call a file action and return whether it succeeded; an error becomes a message."""
        try:
            action()
        except TactuneError as error:
            self._messages.show_message("file", Severity.ERROR, str(error))
            return False
        return True

    def _folder(self, kind: str) -> Path:
        remembered = Path(self._settings.text(f"folder/{kind}", str(Path.home())))
        return remembered if remembered.is_dir() else Path.home()


def _patterns() -> dict[str, list[str]]:
    """Return the file patterns of each kind of recording that is a file."""
    return {kind.scheme: re.split(r"[ ,;]+", kind.pattern) for kind in source_kinds() if kind.needs == "file"}


def recording_endings() -> list[str]:
    """Return the endings of recordings, such as ``.bag``."""
    return [pattern.removeprefix("*") for patterns in _patterns().values() for pattern in patterns]


def recording_filters() -> list[str]:
    """Return the filters of a file dialog, all recordings first."""
    kinds = {kind.scheme: kind.title for kind in source_kinds()}
    single = [f"{kinds[scheme]} ({' '.join(patterns)})" for scheme, patterns in _patterns().items()]
    return [f"Recordings ({' '.join(f'*{ending}' for ending in recording_endings())})", *single]


def recording_scheme(path: Path) -> str:
    """Return the scheme of the source that opens a file, by its name; empty if none does."""
    name = path.name.lower()
    return next((scheme for scheme, patterns in _patterns().items() if any(map(partial(fnmatch, name), patterns))), "")


def file_name(name: str) -> str:
    """Turn a preset's name into a file name."""
    return "".join(letter if letter.isalnum() or letter in "-_ ." else "_" for letter in name).strip(" .") or "preset"


class _Report(QObject):
    written = pyqtSignal(str)
    failed = pyqtSignal(str)


class _Export(QRunnable):
    """Writes on a pool thread; the report's signals arrive on the GUI thread."""

    def __init__(self, result: Result, path: Path, report: _Report) -> None:
        super().__init__()
        self._result, self._path, self._report = result, path, report

    def run(self) -> None:
        patch = self._result.patch
        assert patch is not None
        try:
            write_cloud(self._path, patch_cloud(patch, self._result.frame, self._result.source.rig))
        except TactuneError as error:
            self._report.failed.emit(str(error))
        else:
            number = self._result.frame_number
            self._report.written.emit(f"Frame {number}: {len(patch.points)} points written to {self._path}.")


def export_patch(result: Result, path: Path, messages: MessageBar) -> None:
    """Write the patch of a result in the background and report the outcome."""
    report = _Report(messages)
    report.written.connect(lambda sentence: messages.show_message("export", Severity.INFO, sentence))
    report.failed.connect(lambda sentence: messages.show_message("export", Severity.ERROR, sentence))
    for signal in (report.written, report.failed):
        signal.connect(report.deleteLater)
    pool = QThreadPool.globalInstance()
    assert pool is not None
    pool.start(_Export(result, path, report))
