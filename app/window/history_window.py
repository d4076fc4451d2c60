"""The undo history as a list; a click goes back or forward to a step."""

from __future__ import annotations

from PyQt6.QtCore import QSize
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QDialog, QUndoView, QWidget

from ...widgets.basics.controls import wrapped_label
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.icons import icon
from ...widgets.basics.layouts import vbox
from ..document.document import Document


class HistoryWindow(QDialog):
    """Lists every step of the document, undone ones too; the saved state is marked."""

    def __init__(self, document: Document, undo_actions: list[QAction], parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("History")
        self.addActions(undo_actions)
        self.view = QUndoView(document.undo_stack)
        self.view.setEmptyLabel("As opened")
        self.view.setCleanIcon(icon("check"))
        self.view.setIconSize(QSize(12, 12))
        self.view.setAccessibleName("Steps of the undo history")
        self.view.setToolTip("Click a step to go back or forward to it; the mark shows what is saved")
        note = wrapped_label("Click a step to go back or forward to it. The mark shows what is saved.")
        vbox(note, self.view, within=self)
        self.resize(320, 420)

    def show_steps(self) -> None:
        """Show the list beside the other windows."""
        bring_up(self)
        self.view.setFocus()
