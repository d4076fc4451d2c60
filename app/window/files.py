"""File actions: open and save presets, open what is dropped; asks before unsaved changes are lost."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from PyQt6.QtCore import QObject
from PyQt6.QtWidgets import QApplication

from ...core.preset import Preset, now
from ...core.preset.file import shipped_presets
from ...core.sources.presets import load_preset
from ...widgets.basics.messages import Severity
from ..context import SOURCE, TASK, Context
from ..document.comparison import differing_fields
from ..document.document import Document, describe_edit
from ..document.headless_code import as_command, as_python
from ..document.recovery import Autosave, UnsavedWork, unsaved_work
from ..sources.pages import recording_name
from ..worker.results import SourceInfo
from .actions import Actions

PRESET_FILTER = "Presets (*.json)"
#: Fields that say what a preset is called and made for, and number of values of a recording that a message names.
_LABELS: Final = ("name", "notes", "rig")
_SHOWN_VALUES: Final = 2


class FileFlows(QObject):
    """Opens and saves, with dialogs and messages."""

    def __init__(self, context: Context, autosave: Autosave, actions: Actions) -> None:
        super().__init__(context)
        self._context, self._autosave = context, autosave
        context.saveRequested.connect(self.save)
        self._document, self._dialogs = context.document, context.dialogs
        self._settings, self._messages = context.settings, context.messages
        context.worker.opened.connect(self._note_opened)
        context.document.fileChanged.connect(self._note_preset)
        actions.new_preset.triggered.connect(lambda _: self.new())
        actions.open_preset.triggered.connect(self.open_preset_dialog)
        actions.save.triggered.connect(lambda _: self.save())
        actions.save_as.triggered.connect(lambda _: self.save_as())
        actions.copy_command.triggered.connect(lambda _: self._copy("command", as_command))
        actions.copy_python.triggered.connect(lambda _: self._copy("Python program", as_python))
        actions.reopen.setChecked(self._settings.text("reopen", "on") == "on")
        actions.reopen.toggled.connect(lambda on: self._settings.set("reopen", "on" if on else "off"))

    def guarded(self, then: Callable[[], object]) -> None:
        """Call ``then``, which replaces the preset, after asking about unsaved changes."""
        if not self._document.dirty:
            then()
            return
        self._dialogs.ask_unsaved(self._document.preset.name, save=lambda: self.save(then), discard=then)

    def new(self, shipped: str = "default") -> None:
        changes = {"name": "untitled", "created": now(), "modified": now()}
        self.guarded(lambda: self._told(lambda: self._document.new(load_preset(shipped).model_copy(update=changes))))

    def offer_preset(self, preset: Preset | None) -> None:
        """Offer the values with which a recording was made, unless they are in use."""
        before = self._document.preset
        changed = [] if preset is None else [path for path in differing_fields(before, preset) if path not in _LABELS]
        if preset is None or not changed:
            self._messages.clear("recorded preset")
            return
        shown = [describe_edit(preset, (path,)) for path in changed[:_SHOWN_VALUES]]
        more = f" and {len(changed) - len(shown)} more" if len(changed) > len(shown) else ""
        self._messages.show_message(
            "recorded preset",
            Severity.INFO,
            f"The recording was made with other values ({', '.join(shown)}{more}). Use them?",
            [("Use them", lambda: self.guarded(lambda: self._document.new(preset)))],
            subject=SOURCE,
        )

    def open_preset_dialog(self) -> None:
        self.guarded(lambda: self._dialogs.open_file("preset", "Open preset", PRESET_FILTER, self._read_preset))

    def open_preset(self, path: Path) -> None:
        self.guarded(lambda: self._read_preset(path))

    def save(self, then: Callable[[], object] | None = None) -> None:
        """Save to the document's file, or ask for one; ``then`` runs only after success."""
        if self._document.path is None:
            self.save_as(then)
        else:
            self._write_preset(self._document.path, then)

    def save_as(self, then: Callable[[], object] | None = None) -> None:
        name = file_name(self._document.preset.name)
        own = f"my-{name}" if name in shipped_presets() else name
        suggestion = self._document.path or f"{own}.json"
        self._dialogs.save_file(
            "preset", "Save preset", suggestion, [PRESET_FILTER], lambda path: self._write_preset(path, then)
        )

    def _copy(self, what: str, program: Callable[[Document, str], str]) -> None:
        """Copy the program that computes the same patches headless."""
        source = self._context.source_name or self._settings.last_opened()[0] or "sim"
        clipboard = QApplication.clipboard()
        assert clipboard is not None
        if self._told(lambda: clipboard.setText(program(self._document, source))):
            sentence = f"The {what} that computes these patches was copied."
            self._messages.show_message("copied", Severity.INFO, sentence, subject=TASK)

    def open_dropped(self, paths: list[Path]) -> None:
        """Open the preset or recording that was dropped on the window, or say why not."""
        first = paths[0]
        if len(paths) == 1 and first.suffix.lower() == ".json" and first.is_file():
            self.open_preset(first)
            return
        with self._messages.telling("file"):
            self._context.sourceRequested.emit(recording_name(paths))

    def offer_unsaved_work(self) -> None:
        """Offer the unsaved work of a window that crashed, newest first, one piece after the other."""
        newest = next(iter(unsaved_work(self._context.data_folder)), None)
        if newest is None:
            return
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

    def _note_opened(self, info: SourceInfo) -> None:
        """Remember source and preset for the next start."""
        self._settings.set("last/source", info.name)
        self._note_preset()

    def _note_preset(self) -> None:
        self._settings.set("last/preset", str(self._document.path.absolute() if self._document.path else ""))

    def _restore(self, work: UnsavedWork) -> None:
        self._document.restore(work.preset, work.path)
        self._autosave.take_over(work)

    def _read_preset(self, path: Path) -> None:
        if self._told(lambda: self._document.open(path)):
            self._remember(path)
        elif not path.exists():
            self._settings.remove_recent("presets", str(path))

    def _write_preset(self, path: Path, then: Callable[[], object] | None) -> None:
        """Save, with the rig of the frames if the preset has none, and with the file's name if it is another file."""
        elsewhere, captured = path != self._document.path, self._document.baseline.untouched
        missing: dict[str, Any] = {"name": path.stem[:120] or "untitled"} if elsewhere else {}
        if self._document.preset.rig is None and (result := self._context.result) is not None:
            missing["rig"] = result.source.rig.model_dump(mode="json")
        if missing:
            self._document.edit_many(missing)
        if not self._told(lambda: self._document.save(path)):
            return
        record = self._document.preset.untouched
        if elsewhere or record != captured:
            sentence = f"The preset was saved in {path}."
            if record is not None:
                sentence += f" Its untouched frame is a second file beside it, {record.file}."
            self._messages.show_message("saved", Severity.INFO, sentence, subject=TASK)
        self._remember(path)
        if then is not None:
            then()

    def _remember(self, path: Path) -> None:
        self._messages.clear("file")
        self._dialogs.remember("preset", path.parent)
        self._settings.add_recent("presets", str(path))

    def _told(self, action: Callable[[], None]) -> bool:
        """Return whether a file action succeeded; an error becomes a message."""
        with self._messages.telling("file", TASK):
            action()
            return True
        return False


def file_name(name: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-_ ." else "_" for letter in name).strip(" .") or "preset"
