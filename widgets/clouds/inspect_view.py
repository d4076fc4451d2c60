"""A 3D view for looking closely: it can be enlarged, and has a context menu."""

from __future__ import annotations

from PyQt6.QtCore import QPoint, Qt, pyqtSignal
from PyQt6.QtGui import QContextMenuEvent, QMouseEvent

from .cloud_view import CloudView


class InspectView(CloudView):
    """A `CloudView` that reports double clicks and asks for a context menu.

    Signals
    -------
    enlargeRequested()
        The view was double-clicked.
    menuRequested(at: QPoint)
        A context menu is wanted at this place on the screen.
    """

    HELP = """<p><b>Drag</b> to orbit, <b>Shift + drag</b> or middle button to pan, <b>wheel</b> to zoom,
    <b>double click</b> to enlarge, <b>right click</b> for more.</p>
    <p>Keys: <b>arrows</b> orbit, <b>+ −</b> zoom, <b>R</b> reset, <b>V</b> front, <b>T</b> top, <b>S</b> side,
    <b>Z</b> zoom to the patch.</p>"""

    enlargeRequested = pyqtSignal()
    menuRequested = pyqtSignal(QPoint)

    def mouseDoubleClickEvent(self, event: QMouseEvent | None) -> None:
        """Ask to be enlarged."""
        if event is not None and event.button() == Qt.MouseButton.LeftButton:
            self.enlargeRequested.emit()

    def contextMenuEvent(self, event: QContextMenuEvent | None) -> None:
        """Ask for a menu."""
        if event is not None:
            self.menuRequested.emit(event.globalPos())
