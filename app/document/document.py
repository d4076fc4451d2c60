"""The document: the preset being edited, the file that it belongs to, and its history."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PyQt6.QtCore import QObject, pyqtSignal
from PyQt6.QtGui import QUndoStack

from ...core.errors import PresetError
from ...core.preset import Preset, now
from ...core.preset.file import save_preset
from ...core.rig.untouched import copy_untouched
from ...core.sources.presets import load_preset
from .commands import EditPreset
from .untouched_store import UntouchedStore


class Document(QObject):
    """Everything that a person can change and save.

    Views listen and send edits; the preset itself is immutable, so whoever holds one (the worker,
    an undo step) holds a consistent whole.

    Signals
    -------
    presetChanged(Preset)
    fileChanged()
        The path or the unsaved mark changed.
    baselineChanged(Preset)
        Another preset is what the file holds, so "reset" goes back to it.
    refused(path: str, sentence: str)
        An edit that the preset does not allow; nothing changed.
    warned(sentence: str)
        The preset was saved, but not everything that belongs to it.
    """

    presetChanged = pyqtSignal(object)
    fileChanged = pyqtSignal()
    baselineChanged = pyqtSignal(object)
    refused = pyqtSignal(str, str)
    warned = pyqtSignal(str)

    def __init__(self, preset: Preset | None = None, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._preset = preset or Preset()
        self._path: Path | None = None
        #: Keeps untouched frames until the preset has a file.
        self.untouched_store: UntouchedStore | None = None
        self.undo_stack = QUndoStack(self)
        self.undo_stack.setUndoLimit(1000)
        self.undo_stack.cleanChanged.connect(self._clean_changed)

    @property
    def preset(self) -> Preset:
        """The preset as it is now."""
        return self._preset

    @property
    def path(self) -> Path | None:
        """The file it was read from or saved to; None for a new one or a shipped one."""
        return self._path

    @property
    def untouched_home(self) -> Path | None:
        """Beside which file the preset's untouched frame lies, as `load_untouched` takes it; None: nowhere yet."""
        return (
            self._path
            if self.untouched_store is None
            else self.untouched_store.home(self._preset.untouched, self._path)
        )

    @property
    def dirty(self) -> bool:
        """Whether there is anything that is not in the file."""
        return not self.undo_stack.isClean()

    @property
    def title(self) -> str:
        """The preset's name with the unsaved mark."""
        return f"{self._preset.name} *" if self.dirty else self._preset.name

    def edit(self, path: str, value: Any, gesture: int = 0) -> bool:
        """Change one field as one undoable step.

        Parameters
        ----------
        path : str
            Dotted path of the field, such as ``"mask.hue"``.
        value : object
        gesture : int
            Edits of one field with the same number (one drag) become one step; 0 never merges.

        Returns
        -------
        bool
            False where the preset refused the value (`refused` says why).
        """
        return self.edit_many({path: value}, gesture)

    def edit_many(self, values: dict[str, Any], gesture: int = 0) -> bool:
        """Change several fields as one undoable step; see `edit`."""
        try:
            after = self._preset.with_values(values)
        except PresetError as error:
            self.refused.emit(next(iter(values)), str(error))
            return False
        if after != self._preset:
            self.undo_stack.push(EditPreset(self, self._preset, after, tuple(sorted(values)), gesture))
        return True

    def show_preset(self, preset: Preset) -> None:
        """Make a preset the present one without a step; for undo commands."""
        self._preset = preset
        self.presetChanged.emit(preset)

    def new(self, preset: Preset) -> None:
        """Begin with a preset that has no file yet."""
        self._replace(preset, None)

    def open(self, path: Path) -> None:
        """Read a preset file.

        Raises
        ------
        PresetError
            The file cannot be used; the document stays as it is.
        """
        self._replace(load_preset(path), path)

    def restore(self, preset: Preset, path: Path | None) -> None:
        """Take up unsaved work that outlived a crash; it counts as unsaved."""
        self._replace(preset, path)
        self.undo_stack.resetClean()
        self.fileChanged.emit()

    def save(self, path: Path) -> None:
        """Write the preset to a file, which becomes the document's; its untouched frame goes along first.

        Raises
        ------
        ExportError
            A file cannot be written; the document stays unsaved.
        """
        lost = self._bring_untouched(path)
        save_preset(self._preset.model_copy(update={"modified": now()}), path)
        self._path = path
        self.undo_stack.setClean()
        self.baselineChanged.emit(self._preset)
        self.fileChanged.emit()
        if lost:
            self.warned.emit(lost)

    def _bring_untouched(self, to: Path) -> str:
        """Put the untouched frame beside the file to be, and return why it could not be read, if so."""
        record, home = self._preset.untouched, self.untouched_home
        if record is None or (home is not None and home.parent == to.parent):
            return ""
        try:
            copy_untouched(record, home or to, to)
        except PresetError as error:
            return f"{to.name} was saved without its untouched frame: {error}."
        return ""

    def _replace(self, preset: Preset, path: Path | None) -> None:
        self._path = path
        self._preset = preset
        self.undo_stack.clear()
        self.undo_stack.setClean()
        self.presetChanged.emit(preset)
        self.baselineChanged.emit(preset)
        self.fileChanged.emit()

    def _clean_changed(self, _: bool) -> None:
        self.fileChanged.emit()
