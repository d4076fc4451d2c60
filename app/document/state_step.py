"""Undo of immutable states: a step knows the state before and the state after."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from PyQt6.QtGui import QUndoCommand


class StateStep(QUndoCommand):
    """From one state to another; steps of one gesture merge, and vanish where nothing is left of them.

    Parameters
    ----------
    text : str
        What the step does, for menus and tooltips.
    show : callable
        Makes a state the present one.
    before, after
        The states, comparable.
    gesture : int
        Number of the gesture, see `widgets.gestures`; 0 for a step of its own.
    """

    def __init__(self, text: str, show: Callable[[Any], None], before: Any, after: Any, gesture: int) -> None:
        super().__init__(text)
        self._show, self._before, self._after, self._gesture = show, before, after, gesture

    def redo(self) -> None:
        """Show the state after."""
        self._show(self._after)

    def undo(self) -> None:
        """Show the state before."""
        self._show(self._before)

    def id(self) -> int:
        """Return what makes Qt offer steps to `mergeWith`."""
        return 1 if self._gesture else -1

    def mergeWith(self, other: QUndoCommand | None) -> bool:
        """Take a later step of the same gesture into this one."""
        if not isinstance(other, StateStep) or other._gesture != self._gesture:
            return False
        self._after = other._after
        self.setObsolete(self._after == self._before)
        return True
