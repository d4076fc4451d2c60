"""What the main window needs to know of the analysis: open it on a tab, pass frames on, close."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QAction

from .tab import AnalysisTab
from .window import AnalysisWindow

if TYPE_CHECKING:
    from ..window.main_window import MainWindow


def _compare(window: MainWindow) -> AnalysisTab:
    from .compare_tab import CompareTab

    return CompareTab(window)


def _scan_truth(window: MainWindow) -> AnalysisTab:
    from .truth_tab import TruthTab

    return TruthTab(window)


def _strain(window: MainWindow) -> AnalysisTab:
    from .strain_tab import StrainTab

    return StrainTab(window)


#: The tabs in their order, by the name of the action that opens them: title and what makes them. What a
#: tab needs is imported when it is first looked at, so that the main window starts as fast without it.
TABS: dict[str, tuple[str, Callable[[MainWindow], AnalysisTab]]] = {
    "compare": ("&Compare", _compare),
    "scan_truth": ("&Ground truth", _scan_truth),
    "strain": ("&Strain", _strain),
}


class AnalysisLauncher(QObject):
    """Keeps at most one window and feeds it."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._main = window
        self.window: AnalysisWindow | None = None
        window.frameShown.connect(self._frame_shown)
        for key in TABS:
            self._action(key).triggered.connect(partial(self.open, key))

    def open(self, key: str, _checked: bool = False) -> None:
        """Open the window on a tab, or bring it to the front."""
        if self.window is None:
            self.window = self._make()
        self.window.open_on(key)

    def close(self) -> None:
        """Stop the tabs and close the window."""
        if self.window is not None:
            self.window.shut_down()

    def _make(self) -> AnalysisWindow:
        main, actions = self._main, self._main.actions_
        made = AnalysisWindow(
            {key: (title, partial(make, main)) for key, (title, make) in TABS.items()},
            {key: self._action(key).toolTip() for key in TABS},
            lambda: main.result,
            main.settings,
            actions.play,
            main,
        )
        made.take_actions(
            [
                *(self._action(key) for key in TABS),
                actions.capture_untouched,
                *(actions.previous, actions.next, actions.first, actions.loop, actions.freeze),
            ]
        )
        return made

    def _action(self, key: str) -> QAction:
        action: QAction = getattr(self._main.actions_, key)
        return action

    def _frame_shown(self) -> None:
        if self.window is not None:
            self.window.show_newest()
