"""Tooltips in lines of readable length: of widgets, menu entries, table headers and cells alike."""

from __future__ import annotations

from typing import Final

from PyQt6.QtCore import QEvent, QObject, Qt
from PyQt6.QtWidgets import QLabel, QWidget

#: Largest width of a tooltip, in pixels: lines of about 60 characters.
MAX_WIDTH_PX: Final = 400


def is_tip(widget: QWidget) -> bool:
    return widget.inherits("QTipLabel")


class TipWrapper(QObject):
    """Wraps the text of tooltips. Qt wraps only rich text, and shows the rest in one line of any length.

    Qt makes a new label for almost every tooltip, and the style sees each one before it is shown. So this is the one
    place that all tooltips pass, and no filter over the whole application is needed.
    """

    def watch(self, tip: QWidget) -> None:
        """Wrap what this tooltip will show; call it once, before the tooltip has its text."""
        tip.setMaximumWidth(MAX_WIDTH_PX)  # Qt places it by this width
        tip.installEventFilter(self)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Give the label the height of its wrapped text, inside the screen."""
        if isinstance(watched, QLabel) and event is not None and event.type() in {QEvent.Type.Show, QEvent.Type.Resize}:
            # The help of the views is rich text; elsewhere a file name may look like markup.
            rich = watched.text().startswith("<p>")
            watched.setTextFormat(Qt.TextFormat.RichText if rich else Qt.TextFormat.PlainText)
            watched.setWordWrap(True)
            height = watched.heightForWidth(watched.width())
            if height != watched.height():
                watched.resize(watched.width(), height)
                screen = watched.screen()
                below = 0 if screen is None else watched.geometry().bottom() - screen.geometry().bottom()
                if below > 0:
                    watched.move(watched.x(), watched.y() - below)
        return False
