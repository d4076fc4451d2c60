"""What an analysis tab is, and how another package adds one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from PyQt6.QtWidgets import QWidget

from ..context import Context
from ..worker.results import Result

#: The entry-point group for tabs of other packages: each entry names a `TabKind`.
TABS: Final = "tactune.tabs"


class AnalysisTab(QWidget):
    """One way to judge the frames of the main window. Long work belongs on a thread of the tab's own."""

    @property
    def goes_on(self) -> bool:
        """Whether the tab wants frames behind other tabs, too, as long as the window is open."""
        return False

    def show_result(self, result: Result) -> None:
        """Take a frame of the main window while this tab is visible or `goes_on`; must return at once."""

    def shut_down(self) -> None:
        """Stop all threads, for good."""


@dataclass(frozen=True)
class TabKind:
    """An analysis tab before it is opened; the Analysis menu and window list these."""

    title: str  # also the menu entry; an ampersand marks the key
    tip: str  # one sentence that says what the tab is for
    make: Callable[[Context], AnalysisTab]  # called when the tab is first looked at
    shortcut: str = ""  # such as "F7"
