"""The window of the Analysis menu: its tabs, the actions that open them, and the frames they get."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Final

from PyQt6.QtCore import QEvent, QObject, Qt
from PyQt6.QtGui import QAction, QKeyEvent, QKeySequence, QShowEvent
from PyQt6.QtWidgets import QDialog, QTabWidget, QVBoxLayout, QWidget

from ...core.model.plugins import added_by_others
from ...widgets.basics.controls import free_space_bar, wrapped_label
from ...widgets.basics.dialogs import bring_up, room_on
from ...widgets.basics.layouts import vbox
from ...widgets.basics.messages import Severity
from ..context import Context
from ..worker.errors import explain, guarded
from .tab import TABS, AnalysisTab, TabKind

_GEOMETRY = "analysis/geometry"


# a tab's class is imported when the tab is first looked at: the main window starts without it


def _tilt(context: Context) -> AnalysisTab:
    from .tilt_tab import TiltTab

    return TiltTab(context)


def _track(context: Context) -> AnalysisTab:
    from .track_tab import TrackTab

    return TrackTab(context)


def _tune(context: Context) -> AnalysisTab:
    from .tune_tab import TuneTab

    return TuneTab(context)


#: Our own tabs by name; other packages add theirs by entry points.
OWN_TABS: Final = {
    "tilt": TabKind("T&ilt", "Roll and pitch of the contact patch, with standard deviations", _tilt, "Shift+F8"),
    "track": TabKind("Trac&k an object", "Pose of an object of known shape, tracked by its patches", _track, "Ctrl+F8"),
    "tune": TabKind("Tun&e", "Search for preset values with less error and less time", _tune, "Shift+F7"),
}


class AnalysisLauncher(QObject):
    """Opens the window on a tab and feeds it; ``shared`` are actions of the main window that work here too."""

    def __init__(self, context: Context, play: QAction, shared: Sequence[QAction]) -> None:
        super().__init__(context)
        self._context, self._play, self._shared = context, play, shared
        self.window: AnalysisWindow | None = None
        added, problems = added_by_others(TABS, TabKind)
        self._kinds = dict(sorted((added | OWN_TABS).items(), key=lambda item: item[1].title.replace("&", "")))
        for name, problem in problems.items():
            sentence = f"An analysis tab is missing: {problem}."
            context.messages.show_message(f"tab {name}", Severity.WARNING, sentence)
        #: One action for each tab, by name and in the order of the menu.
        self.actions = {name: self._action(name, kind) for name, kind in self._kinds.items()}

    def open(self, name: str, _checked: bool = False) -> None:
        if self.window is None:
            self.window = AnalysisWindow(self._kinds, self._context, self._play)
            self.window.addActions([*self.actions.values(), *self._shared])
        self.window.open_on(name)

    def close(self) -> None:
        if self.window is not None:
            self.window.shut_down()

    def _action(self, name: str, kind: TabKind) -> QAction:
        made = QAction(f"{kind.title}…", self)
        keys = kind.shortcut
        if keys in {action.shortcut().toString() for action in self._context.window.findChildren(QAction)} - {""}:
            sentence = f"The analysis tab {name!r} has no shortcut: {keys} belongs to another action."
            self._context.messages.show_message(f"shortcut of {name}", Severity.WARNING, sentence)
            keys = ""
        made.setShortcut(QKeySequence(keys))
        made.setToolTip(f"{kind.tip} ({keys})" if keys else kind.tip)
        made.triggered.connect(partial(self.open, name))
        return made


class AnalysisWindow(QDialog):
    """Stays open beside the main window; passes each frame to the visible tab, and to others that go on."""

    def __init__(self, kinds: Mapping[str, TabKind], context: Context, play: QAction) -> None:
        super().__init__()  # a window with a parent would lie over the main window, which it previews
        context.window.destroyed.connect(self.deleteLater)
        self.setWindowTitle("Analysis")
        self.setWindowFlags(Qt.WindowType.Window)
        self._kinds, self._context, self._play = kinds, context, play
        self._names = list(kinds)
        self.made: dict[str, AnalysisTab] = {}
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        self._columns: dict[str, QVBoxLayout] = {}
        for name, kind in kinds.items():
            page = QWidget()
            self._columns[name] = vbox(within=page, margins=8)
            self.tabs.setTabToolTip(self.tabs.addTab(page, kind.title), kind.tip)
        self.tabs.currentChanged.connect(self._tab_changed)
        context.frameShown.connect(self.show_newest)
        vbox(self.tabs, within=self, margins=(0, 4, 0, 0))
        self.resize(960, 640)
        screen = context.window.screen()
        if not self.restoreGeometry(context.settings.blob(_GEOMETRY)) and screen is not None:
            room = room_on(screen)  # in the lower right corner most of the main window's views stay visible
            self.move(max(room.right() - self.width(), room.left()), max(room.bottom() - self.height(), room.top()))

    def open_on(self, name: str) -> None:
        self.tabs.setCurrentIndex(self._names.index(name))
        bring_up(self)

    def show_newest(self) -> None:
        """Pass the main window's frame to the visible tab, and to others that go on."""
        result = self._context.result
        if result is None or not self.isVisible():
            return
        front = None if self.isMinimized() else self._current()
        for tab in tuple(self.made.values()):
            if tab is front or tab.goes_on:
                guarded(partial(tab.show_result, result))

    def shut_down(self) -> None:
        self._context.settings.set(_GEOMETRY, self.saveGeometry())
        for tab in self.made.values():
            guarded(tab.shut_down)
        self.close()

    def _current(self) -> AnalysisTab:
        """Return the tab in front; make it when it is first looked at."""
        name = self._names[self.tabs.currentIndex()]
        if name not in self.made:
            self.made[name] = self._make(name)
            self._columns[name].addWidget(self.made[name])
        return self.made[name]

    def _make(self, name: str) -> AnalysisTab:
        """Make a tab; if that fails, report the error and return a tab that says so."""
        try:
            return self._kinds[name].make(self._context)
        except Exception as error:  # another package's tab may raise anything
            sys.excepthook(type(error), error, error.__traceback__)
            broken = AnalysisTab()
            vbox(wrapped_label(explain(error, f"the tab {name} cannot be opened")), within=broken)
            return broken

    def _tab_changed(self) -> None:
        if self.isVisible():
            self._current()
            self.show_newest()

    def showEvent(self, event: QShowEvent | None) -> None:
        super().showEvent(event)
        self._tab_changed()

    def event(self, event: QEvent | None) -> bool:
        free_space_bar(self, event)
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Play or pause when nothing else takes the space bar, as in the main window."""
        if event is not None and event.key() == Qt.Key.Key_Space and not event.isAutoRepeat():
            self._play.trigger()
            return
        super().keyPressEvent(event)
