"""Which two presets the views compare on the present frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from PyQt6.QtCore import QObject, pyqtSignal

from ...core.preset import Preset
from ...core.preset.preset import preset_paths
from .document import Document

#: Name of the side that is the document's preset and follows its edits.
PRESENT: Final = "Present"
#: Name of the side that was last saved, or without a file opened; it follows the next save.
SAVED: Final = "Saved"


@dataclass(frozen=True)
class Side:
    """One of two compared presets and its name on the screen; one named `PRESENT` follows the edits."""

    name: str
    preset: Preset

    @property
    def follows(self) -> bool:
        return self.name == PRESENT


Sides = tuple[Side, Side]

#: What is said of a preset's values; it is no difference.
_RECORDS: Final = ("created", "modified", "suggested", "verdict")
#: Fields that stay when a side is taken over: what a preset is called, and the files and cameras that it belongs to.
_OWN: Final = ("name", "notes", "rig", "untouched")


def differing_fields(a: Preset, b: Preset) -> tuple[str, ...]:
    """Return the dotted paths of the fields in which two presets differ, those that `take_over` leaves last."""
    paths = [path for path in preset_paths() if path not in _RECORDS and a.value(path) != b.value(path)]
    return tuple(sorted(paths, key=lambda path: path in _OWN))


def take_over(document: Document, side: Side) -> bool:
    """Set every value but `_OWN` to that of a side, as one undoable step; return whether the preset allows it."""
    paths = [path for path in differing_fields(document.preset, side.preset) if path not in _OWN]
    return not paths or document.edit_many({path: side.preset.value(path) for path in paths}, title=f"Use {side.name}")


class Comparison(QObject):
    """The two presets that are compared; the views listen."""

    changed = pyqtSignal(object)  # tuple of Side, or None

    def __init__(self, document: Document, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._document = document
        #: The compared presets, A (left of the wipe) and B (right of it); None while nothing is compared.
        self.sides: Sides | None = None
        document.presetChanged.connect(self._follow)
        document.baselineChanged.connect(self._follow)

    @property
    def present(self) -> Side:
        return Side(PRESENT, self._document.preset)

    @property
    def saved(self) -> Side:
        return Side(SAVED, self._document.baseline)

    def show(self, a: Side, b: Side) -> None:
        self._set((a, b))

    def end(self) -> None:
        self._set(None)

    def shows(self, side: Side | None) -> bool:
        """Return whether B is this side, which someone has shown beside the present preset."""
        return self.sides is not None and self.sides[1] == side

    def _follow(self, _: Preset) -> None:
        if self.sides is not None:
            newest = {side.name: side for side in (self.present, self.saved)}
            a, b = (newest.get(side.name, side) for side in self.sides)
            self._set((a, b))

    def _set(self, sides: Sides | None) -> None:
        if sides != self.sides:
            self.sides = sides
            self.changed.emit(sides)
