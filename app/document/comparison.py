"""Which two presets the views compare on the present frame."""

from __future__ import annotations

from dataclasses import dataclass

from PyQt6.QtCore import QObject, pyqtSignal

from ...core.preset import Preset


@dataclass(frozen=True)
class Side:
    """One of two compared presets and its name on the screen, such as ``"Saved"``."""

    name: str
    preset: Preset


class Comparison(QObject):
    """The two presets that are compared; whoever offers a comparison calls `show`, the views listen.

    Signals
    -------
    changed(sides: tuple of Side or None)
    """

    changed = pyqtSignal(object)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._sides: tuple[Side, Side] | None = None

    @property
    def sides(self) -> tuple[Side, Side] | None:
        """The compared presets, A (left of the wipe) and B (right of it); None while nothing is compared."""
        return self._sides

    def show(self, a: Side, b: Side) -> None:
        """Compare two presets; replaces an earlier comparison."""
        self._set((a, b))

    def end(self) -> None:
        """Show the present preset alone again."""
        self._set(None)

    def _set(self, sides: tuple[Side, Side] | None) -> None:
        if sides != self._sides:
            self._sides = sides
            self.changed.emit(sides)
