"""Enlarging one view or image, and copying it as a picture."""

from __future__ import annotations

from PyQt6.QtCore import QObject, pyqtSignal
from PyQt6.QtWidgets import QApplication, QToolButton, QWidget

from ...widgets.images.image_strip import PANES, ImageStrip
from ..worker.results import CloudName
from .actions import Actions
from .view_area import TITLES, ViewArea

_MARGIN = 8


class ViewParts(QObject):
    """Enlarges the view or image that is double-clicked; the rest is hidden, and what is hidden is not drawn."""

    copied = pyqtSignal(str)  # a picture of the view or image of this name is on the clipboard

    def __init__(self, views: ViewArea, strip: ImageStrip, actions: Actions) -> None:
        super().__init__(views)
        self._views, self._strip, self._actions = views, strip, actions
        self._parts: dict[QWidget, str] = {view: TITLES[name] for name, view in views.views.items()}
        self._parts |= {pane: PANES[name] for name, pane in strip.panes.items()}
        #: The enlarged view or image; None while all are shown.
        self.shown: QWidget | None = None
        self._back = QToolButton()
        self._back.setObjectName("back")
        self._back.setText("Back")
        self._back.setToolTip("Show all views and images again (Esc, or double click)")
        self._back.clicked.connect(self.back)
        for view in views.views.values():
            view.enlargeRequested.connect(lambda view=view: self.toggle(view))
        for pane in strip.panes.values():
            pane.doubleClicked.connect(lambda pane=pane: self.toggle(pane))
        for action in (*views.toggles.values(), actions.show_strip):
            action.toggled.connect(self.back)
        actions.copy_view.triggered.connect(self._copy)

    def toggle(self, widget: QWidget) -> None:
        if self.shown is not None:
            self.back()
            return
        self.shown = widget
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
        if self.shown is None:
            return False
        self.shown = None
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

    def _copy(self) -> None:
        """Copy the view or image that is enlarged, under the mouse or has the focus, else the patch."""
        visible = [part for part in self._parts if part.isVisible()]
        meant = [self.shown] if self.shown else [part for part in visible if part.underMouse()]
        meant += [part for part in visible if part.hasFocus()]
        part = meant[0] if meant else self._views.views[CloudName.PATCH]
        clipboard = QApplication.clipboard()
        assert clipboard is not None
        self._back.hide()
        clipboard.setPixmap(part.grab())
        self._back.setVisible(self.shown is not None)
        self.copied.emit(self._parts[part])
