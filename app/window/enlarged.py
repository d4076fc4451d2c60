"""One view or image over the whole area of views and images."""

from __future__ import annotations

from PyQt6.QtCore import QObject
from PyQt6.QtWidgets import QToolButton, QWidget

from ...widgets.images.image_strip import ImageStrip
from .actions import Actions
from .view_area import ViewArea

_MARGIN = 8


class Enlarged(QObject):
    """Enlarges the view or image that is double-clicked and goes back at the next double click.

    Everything else is hidden, and what is hidden is not drawn. A change of what is shown in the *View* menu goes back,
    too.
    """

    def __init__(self, views: ViewArea, strip: ImageStrip, actions: Actions) -> None:
        super().__init__(views)
        self._views, self._strip, self._actions = views, strip, actions
        self._shown: QWidget | None = None
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

    @property
    def shown(self) -> QWidget | None:
        """The enlarged view or image; None while all are shown."""
        return self._shown

    def toggle(self, widget: QWidget) -> None:
        """Enlarge a view or image, or go back if one is enlarged."""
        if self._shown is not None:
            self.back()
            return
        self._shown = widget
        of_views = widget in self._views.views.values()
        self._views.setVisible(of_views)
        self._strip.setVisible(not of_views)
        for part in (*self._views.views.values(), *self._strip.panes.values()):
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
