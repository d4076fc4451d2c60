"""Undo of immutable states: the present state, and a step for every edit that led to it."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar

from PyQt6.QtCore import QObject, pyqtSignal
from PyQt6.QtGui import QUndoCommand, QUndoStack

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
        self._state = state

    @property
    def state(self) -> T:
        return self._state

    def edit(self, text: str, after: T, gesture: int = 0, target: Hashable = None) -> None:
        """Change the state as one undoable step; see `StateStep` for the parameters. An equal state is no step."""
        if after != self._state:
            self.undo_stack.push(StateStep(text, self.show, self._state, after, gesture, target))

    def show(self, state: T) -> None:
        """Change the state without a step: for undo, and to restore saved work."""
        self._state = state
        self.changed.emit(state)

    def start(self, state: T) -> None:
        """Begin again with this state and an empty undo stack."""
        self._state = state
        self.undo_stack.clear()
        self.undo_stack.setClean()
        self.changed.emit(state)

    def close(self) -> None:
        """Block the stack's signals, so that its destruction does not reach widgets that are half destroyed."""
        self.undo_stack.blockSignals(True)
