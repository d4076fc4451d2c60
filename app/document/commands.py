"""Undo commands. They know the document and nothing else; what a widget shows follows from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import BaseModel
from PyQt6.QtGui import QUndoCommand

from ...core.preset import Preset

if TYPE_CHECKING:
    from .document import Document

_EDIT_ID = 1


class EditPreset(QUndoCommand):
    """Replace the preset by another one.

    Edits of the same fields within one gesture (one drag of a slider, one run of typing) merge
    into a single step. Presets are immutable, so a step keeps both ends as they are, and undoing
    brings back exactly what was there.
    """

    def __init__(self, document: Document, before: Preset, after: Preset, paths: tuple[str, ...], gesture: int) -> None:
        super().__init__(describe_edit(after, paths))
        self._document = document
        self._before = before
        self._after = after
        self._paths = paths
        self._gesture = gesture

    def redo(self) -> None:
        """Show the new preset."""
        self._document.show_preset(self._after)

    def undo(self) -> None:
        """Show the old preset again."""
        self._document.show_preset(self._before)

    def id(self) -> int:
        """Qt asks for a merge only between commands of one id; -1 never merges."""
        return _EDIT_ID if self._gesture else -1

    def mergeWith(self, other: QUndoCommand | None) -> bool:
        """Take in a later edit of the same gesture."""
        if not isinstance(other, EditPreset) or (other._gesture, other._paths) != (self._gesture, self._paths):
            return False
        self._after = other._after
        self.setText(other.text())
        self.setObsolete(self._after == self._before)
        return True


def describe_edit(preset: Preset, paths: tuple[str, ...]) -> str:
    """Say what an edit did, such as ``"Tolerance t 0.012"``, for the Edit menu."""
    if paths == ("untouched",):
        return "Capture untouched frame"
    if len(paths) == 1:
        return f"{field_title(paths[0])} {format_value(preset.value(paths[0]))}"
    if len(paths) == 2:
        return " and ".join(field_title(path) for path in paths).capitalize()
    sections = sorted({path.split(".")[0] for path in paths})
    return f"{', '.join(sections)} ({len(paths)} values)"


def field_title(path: str) -> str:
    """Return the title of a preset field for people, such as ``"Tolerance t"``."""
    model: Any = Preset
    title = path
    for part in path.split("."):
        field = model.model_fields[part]
        title = field.title or part.replace("_", " ").capitalize()
        model = field.annotation
        if not (isinstance(model, type) and issubclass(model, BaseModel)):
            break
    return title


def format_value(value: Any) -> str:
    """Write a preset value short enough for a menu."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, tuple):
        if any(isinstance(item, tuple) for item in value):
            return "matrix"
        return " - ".join(format_value(item) for item in value)
    if value is None:
        return "from the rig"
    text = ", ".join(f"{name} {item:g}" for name, item in value.items()) if isinstance(value, dict) else str(value)
    return text if len(text) <= 24 else text[:23] + "…"
