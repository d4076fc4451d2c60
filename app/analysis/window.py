"""The window of the Analysis menu: tabs that are made when they are first looked at."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QAction, QKeyEvent, QShowEvent
from PyQt6.QtWidgets import QDialog, QTabWidget, QVBoxLayout, QWidget

from ..settings import Settings
from ..worker.results import Result
from .tab import AnalysisTab

_GEOMETRY = "analysis/geometry"


class AnalysisWindow(QDialog):
    """Stays open beside the main window; hands each frame to the tab that is visible.

    Closed, it takes no frames and keeps what was entered.

    Parameters
    ----------
    tabs : mapping of str to (str, callable)
        Key, title and what makes the tab.
    tips : mapping of str to str
        What each tab is for.
    newest : callable
        Returns the frame that is shown now, or None.
    settings : Settings
        Where the window's place is remembered.
    play : QAction
        What the space bar does.
    parent : QWidget
        The main window.
    """

    def __init__(
        self,
        tabs: Mapping[str, tuple[str, Callable[[], AnalysisTab]]],
        tips: Mapping[str, str],
        newest: Callable[[], Result | None],
        settings: Settings,
        play: QAction,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle("Analysis – Tactune")
        self.setWindowFlags(Qt.WindowType.Window)
        self._factories = {key: make for key, (_, make) in tabs.items()}
        self._keys = list(tabs)
        self._newest, self._settings, self._play = newest, settings, play
        self.made: dict[str, AnalysisTab] = {}
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        for key, (title, _) in tabs.items():
            place = QWidget()
            QVBoxLayout(place).setContentsMargins(6, 6, 6, 6)
            self.tabs.setTabToolTip(self.tabs.addTab(place, title), tips[key])
        self.tabs.currentChanged.connect(self._tab_changed)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 4, 0, 0)
        layout.addWidget(self.tabs)
        self.resize(1200, 780)
        self.restoreGeometry(settings.blob(_GEOMETRY))

    def take_actions(self, actions: Sequence[QAction]) -> None:
        """Let shortcuts of the main window work here, too."""
        self.addActions(list(actions))

    def open_on(self, key: str) -> None:
        """Come to the front with one of the tabs."""
        self.tabs.setCurrentIndex(self._keys.index(key))
        self.show()
        self.raise_()
        self.activateWindow()

    def show_newest(self) -> None:
        """Hand the frame of the main window to the tab that is visible."""
        result = self._newest()
        if result is not None and self.isVisible() and not self.isMinimized():
            self._current().show_result(result)

    def shut_down(self) -> None:
        """Close for good."""
        self._settings.set(_GEOMETRY, self.saveGeometry())
        for tab in self.made.values():
            tab.shut_down()
        self.close()

    def _current(self) -> AnalysisTab:
        """Return the tab in front; make it where it is looked at for the first time."""
        key = self._keys[self.tabs.currentIndex()]
        if key not in self.made:
            self.made[key] = self._factories[key]()
            place = self.tabs.currentWidget()
            assert place is not None
            layout = place.layout()
            assert layout is not None
            layout.addWidget(self.made[key])
        return self.made[key]

    def _tab_changed(self) -> None:
        if self.isVisible():
            self._current()
            self.show_newest()

    def showEvent(self, event: QShowEvent | None) -> None:
        """Make the tab in front and give it the newest frame."""
        super().showEvent(event)
        self._current()
        self.show_newest()

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Play or pause on a space bar that nothing else wanted, as in the main window."""
        if event is not None and event.key() == Qt.Key.Key_Space and not event.isAutoRepeat():
            self._play.trigger()
            return
        super().keyPressEvent(event)
