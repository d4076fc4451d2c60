"""What a person may do with one view or image: enlarge it, copy it, and its context menu."""

from __future__ import annotations

from functools import partial

from PyQt6.QtCore import QObject, QPoint, Qt, pyqtSignal
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QApplication, QMenu, QToolButton, QWidget

from ...widgets.clouds.cloud_view import Place
from ...widgets.clouds.inspect_view import InspectView
from ...widgets.images.image_pane import ImagePane
from ...widgets.images.image_strip import PANES, ImageStrip
from ..worker.results import CloudName
from .actions import Actions
from .pointing import Pointing
from .view_area import TITLES, ViewArea

_MARGIN = 8


class ViewParts(QObject):
    """Enlarges the view or image that is double-clicked and goes back at the next double click.

    Everything else is hidden, and what is hidden is not drawn. A change of what is shown in the *View* menu goes back,
    too.

    Signals
    -------
    copied(name: str)
        A picture of the view or image of this name is on the clipboard.
    """

    copied = pyqtSignal(str)

    def __init__(self, views: ViewArea, strip: ImageStrip, pointing: Pointing, actions: Actions) -> None:
        super().__init__(views)
        self._views, self._strip, self._pointing, self._actions = views, strip, pointing, actions
        self._parts: dict[QWidget, str] = {view: TITLES[name] for name, view in views.views.items()}
        self._parts |= {pane: PANES[name] for name, pane in strip.panes.items()}
        self._shown: QWidget | None = None
        self._back = QToolButton()
        self._back.setObjectName("back")
        self._back.setText("Back")
        self._back.setToolTip("Show all views and images again (Esc, or double click)")
        self._back.clicked.connect(self.back)
        for view in views.views.values():
            view.enlargeRequested.connect(lambda view=view: self.toggle(view))
            view.menuRequested.connect(partial(self._show_view_menu, view))
        for pane in strip.panes.values():
            pane.doubleClicked.connect(lambda pane=pane: self.toggle(pane))
            pane.menuRequested.connect(partial(self._show_image_menu, pane))
        for action in (*views.toggles.values(), actions.show_strip):
            action.toggled.connect(self.back)
        actions.copy_view.triggered.connect(lambda: self.copy(self._meant()))

    @property
    def shown(self) -> QWidget | None:
        """The enlarged view or image; None while all are shown."""
        return self._shown

    def toggle(self, widget: QWidget) -> None:
        if self._shown is not None:
            self.back()
            return
        self._shown = widget
        of_views = widget in self._views.views.values()
        self._views.setVisible(of_views)
        self._strip.setVisible(not of_views)
        for part in self._parts:
            part.setVisible(part is widget)
        self._back.setParent(widget)
        self._back.adjustSize()
        self._back.move(_MARGIN, widget.fontMetrics().height() + 2 * _MARGIN)
        self._back.show()
        self._back.raise_()
        self._views.wantedChanged.emit()

    def back(self) -> bool:
        """Show all views and images again; return whether one was enlarged."""
        if self._shown is None:
            return False
        self._shown = None
        self._back.hide()
        self._back.setParent(None)
        for name, view in self._views.views.items():
            view.setVisible(self._views.toggles[name].isChecked())
        for pane in self._strip.panes.values():
            pane.show()
        self._views.show()
        self._strip.setVisible(self._actions.show_strip.isChecked())
        self._views.wantedChanged.emit()
        return True

    def copy(self, part: QWidget) -> None:
        """Copy a view or image as it is shown, with its legend, to the clipboard."""
        clipboard = QApplication.clipboard()
        assert clipboard is not None
        self._back.hide()
        clipboard.setPixmap(part.grab())
        self._back.setVisible(self._shown is not None)
        self.copied.emit(self._parts[part])

    def _meant(self) -> QWidget:
        """Return the view or image that is enlarged, under the mouse or has the focus; else the patch."""
        shown = [part for part in self._parts if part.isVisible()]
        tests = (QWidget.underMouse, QWidget.hasFocus)
        return next(
            (part for test in tests for part in shown if part is self._shown or test(part)),
            self._views.views[CloudName.PATCH],
        )

    def _show_view_menu(self, view: InspectView, at: QPoint, place: Place | None) -> None:
        menu, actions = self._menu(view), self._actions
        menu.addSeparator()
        menu.addActions([actions.reset_view, actions.front_view, actions.top_view, actions.side_view])
        menu.addAction(actions.zoom_to_patch)
        menu.addSeparator()
        ends = self._pointing.ends
        measure = _entry(menu, "Measure to here" if len(ends) == 1 else "Measure from here", "Shift+click")
        measure.setEnabled(place is not None)
        measure.triggered.connect(lambda: self._pointing.add_end(place) if place is not None else None)
        clear = _entry(menu, "Clear distance", "Esc")
        clear.setEnabled(bool(ends))
        clear.triggered.connect(self._pointing.clear_distance)
        menu.popup(at)

    def _show_image_menu(self, pane: ImagePane, at: QPoint) -> None:
        menu = self._menu(pane)
        _entry(menu, "Show whole image", "0").triggered.connect(self._strip.reset_view)
        menu.popup(at)

    def _menu(self, part: QWidget) -> QMenu:
        menu = QMenu(part)
        menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        enlarge = _entry(menu, "Enlarge" if self._shown is None else "Back to all views", "double click")
        enlarge.triggered.connect(lambda: self.toggle(part))
        _entry(menu, "Copy as picture", "Ctrl+Shift+C").triggered.connect(lambda: self.copy(part))
        return menu


def _entry(menu: QMenu, text: str, keys: str) -> QAction:
    entry = menu.addAction(f"{text}\t{keys}")
    assert entry is not None
    return entry
