"""The document: the preset being edited, the file that it belongs to, and its undo history."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from pydantic import BaseModel
from PyQt6.QtCore import QObject, pyqtSignal
from PyQt6.QtGui import QUndoCommand, QUndoStack

from ...core.errors import PresetError, TactuneError
from ...core.model.frames import SensorFrame
from ...core.preset import Preset, UntouchedRecord, now
from ...core.preset.file import save_preset, with_notes_of_changes
from ...core.rig.untouched import copy_untouched, save_untouched
from ...core.sources.presets import load_preset, load_preset_and_note
from ...core.tuning.advice.proposal import Proposal
from ...widgets.basics.fields import field_spec

T = TypeVar("T")

_MERGE_ID = 1


class StateStep(QUndoCommand):
    """Replace one state by another. Both are kept as they are, so undo restores exactly what was there."""

    def __init__(
        self, text: str, show: Callable[[Any], None], before: Any, after: Any, gesture: int, target: Hashable
    ) -> None:
        super().__init__(text)
        self._show, self._before, self._after, self._merge_key = show, before, after, (gesture, target)

    def redo(self) -> None:
        self._show(self._after)

    def undo(self) -> None:
        self._show(self._before)

    def id(self) -> int:
        """Return the id of commands that Qt tries to merge; -1 never merges."""
        return _MERGE_ID if self._merge_key[0] else -1

    def mergeWith(self, other: QUndoCommand | None) -> bool:
        """Take a later step of the same gesture into this one; a step without effect becomes obsolete."""
        if not isinstance(other, StateStep) or other._merge_key != self._merge_key:
            return False
        self._after = other._after
        self.setText(other.text())
        self.setObsolete(self._after == self._before)
        return True


class History(QObject, Generic[T]):
    """A present state, immutable, and the undo stack of every edit made to it."""

    changed = pyqtSignal(object)  # the state

    def __init__(self, state: T, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.undo_stack = QUndoStack(self)
        self.state = state

    def edit(self, text: str, after: T, gesture: int = 0, target: Hashable = None) -> None:
        """Change the state as one undoable step; see `StateStep` for the parameters. An equal state is no step."""
        if after != self.state:
            self.undo_stack.push(StateStep(text, self.show, self.state, after, gesture, target))

    def show(self, state: T) -> None:
        """Change the state without a step: for undo, and to restore saved work."""
        self.state = state
        self.changed.emit(state)

    def start(self, state: T) -> None:
        """Begin again with this state and an empty undo stack."""
        self.state = state
        self.undo_stack.clear()
        self.undo_stack.setClean()
        self.changed.emit(state)

    def close(self) -> None:
        """Block the stack's signals, so that its destruction does not reach widgets that are half destroyed."""
        self.undo_stack.blockSignals(True)


#: Number of newest untouched frames that stay: unsaved work names them, and a window may still undo to them.
_KEPT: Final = 50


class UntouchedStore:
    """A folder of untouched frames, named by their content; its methods may be called from any thread."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        #: Stands for the file of a preset without one; it is never written.
        self.place = folder / "preset.json"

    def keep(self, frame: SensorFrame, frames: int) -> UntouchedRecord:
        return save_untouched(frame, frames, self.place)

    def home(self, record: UntouchedRecord | None, path: Path | None) -> Path | None:
        """Return the file beside which `load_untouched` finds an untouched frame: the preset's own, else `place`."""
        if record is None or (path is not None and (path.parent / record.file).is_file()):
            return path
        return self.place if (self._folder / record.file).is_file() else path

    def tidy(self) -> None:
        with suppress(OSError):
            files = sorted(self._folder.glob("untouched-*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
            for file in files[_KEPT:]:
                file.unlink()


class Document(QObject):
    """Everything that a person can change and save: views listen to it and send edits."""

    presetChanged = pyqtSignal(object)  # Preset
    fileChanged = pyqtSignal()  # the path or the unsaved mark
    baselineChanged = pyqtSignal(object)  # Preset that "reset" returns to
    refused = pyqtSignal(str, str)  # path and sentence: the preset does not allow an edit
    warned = pyqtSignal(str)  # saved without the untouched frame, or opened with a field that is gone

    def __init__(self, preset: Preset | None = None, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._history = History(preset or Preset(), self)
        #: The preset's file; None for a new preset or a shipped one.
        self.path: Path | None = None
        #: The preset that "reset" returns to: as it was opened or last saved.
        self.baseline = self.preset
        #: Keeps untouched frames until the preset has a file.
        self.untouched_store: UntouchedStore | None = None
        self.undo_stack = self._history.undo_stack
        self.undo_stack.setUndoLimit(1000)
        self.undo_stack.cleanChanged.connect(self.fileChanged)
        self._history.changed.connect(self.presetChanged)

    @property
    def preset(self) -> Preset:
        return self._history.state

    @property
    def untouched_home(self) -> Path | None:
        """The file beside which the preset's untouched frame lies, for `load_untouched`; None if there is none."""
        store = self.untouched_store
        return self.path if store is None else store.home(self.preset.untouched, self.path)

    @property
    def dirty(self) -> bool:
        return not self.undo_stack.isClean()

    @property
    def title(self) -> str:
        """The preset's name with the unsaved mark."""
        return f"{self.preset.name} *" if self.dirty else self.preset.name

    def edit(self, path: str, value: Any, gesture: int = 0) -> bool:
        """Change one field as one step, also those of one ``gesture``; return False if the preset refused the value."""
        return self.edit_many({path: value}, gesture)

    def apply(self, proposal: Proposal) -> bool:
        return self.edit_many(dict(proposal.changes), title=proposal.label)

    def edit_many(self, values: dict[str, Any], gesture: int = 0, title: str = "") -> bool:
        """Change several fields as one undoable step; see `edit`. ``title`` is its text in the Edit menu."""
        try:
            after = self.preset.with_values(values)
        except PresetError as error:
            self.refused.emit(next(iter(values)), str(error))
            return False
        paths = tuple(sorted(values))
        self._history.edit(title or describe_edit(after, paths), after, gesture, target=paths)
        return True

    def new(self, preset: Preset, path: Path | None = None) -> None:
        """Begin again with a preset, of a file if there is one, and without undo."""
        self.path = path
        self._history.start(preset)
        self._set_baseline(preset)

    def open(self, path: Path) -> None:
        preset, note = load_preset_and_note(path)
        self.new(preset, path)
        if note:
            self.warned.emit(f"{path.name}: {note}.")

    def restore(self, preset: Preset, path: Path | None) -> None:
        """Restore unsaved work after a crash. It counts as unsaved."""
        self.new(preset, path)
        if path is not None:
            with suppress(TactuneError):
                self._set_baseline(load_preset(path))
        self.undo_stack.resetClean()
        self.fileChanged.emit()

    def save(self, path: Path) -> None:
        """Write the preset to a file, which becomes the document's. Its untouched frame is written first."""
        lost = self._bring_untouched(path)
        self._history.show(with_notes_of_changes(self.preset, self.baseline))
        save_preset(self.preset.model_copy(update={"modified": now()}), path)
        self.path = path
        self.undo_stack.setClean()
        self._set_baseline(self.preset)
        if lost:
            self.warned.emit(lost)

    def _bring_untouched(self, to: Path) -> str:
        """Copy the untouched frame beside a new file. Return a sentence if it cannot be read, else an empty one."""
        record, home = self.preset.untouched, self.untouched_home
        if record is None or (home is not None and home.parent == to.parent):
            return ""
        try:
            copy_untouched(record, home or to, to)
        except PresetError as error:
            return f"{to.name} was saved without its untouched frame: {error}."
        return ""

    def _set_baseline(self, preset: Preset) -> None:
        self.baseline = preset
        self.baselineChanged.emit(preset)
        self.fileChanged.emit()


def describe_edit(preset: Preset, paths: tuple[str, ...]) -> str:
    """Describe an edit for the Edit menu, such as ``"Tolerance t 1.2 %"``."""
    if len(paths) == 1:
        value = preset.value(paths[0])
        title = field_title(paths[0])
        short = not isinstance(value, BaseModel) and not (isinstance(value, tuple) and isinstance(value[0], tuple))
        return f"{title} {shown_value(paths[0], value)}" if short else title
    sections = sorted({path.split(".")[0] for path in paths})
    return f"{', '.join(sections)} ({len(paths)} values)"


def field_title(path: str) -> str:
    with suppress(TypeError):  # a section, or a field of a type that the panel does not show
        return field_spec(Preset, path).title
    return path.rpartition(".")[2].replace("_", " ").capitalize()


def shown_value(path: str, value: Any) -> str:
    """Format a value as the panel shows it, with its unit, short enough for a menu."""
    with suppress(TypeError):  # a field of a type that the panel does not show
        spec = field_spec(Preset, path)
        if spec.kind != "matrix":
            return spec.describe(value)
    text = "none" if value is None else str(value)
    return text if len(text) <= 24 else text[:23] + "…"
