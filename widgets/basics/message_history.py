"""The messages of this start as a list, so that no note is missed."""

from __future__ import annotations

from PyQt6.QtCore import QEvent
from PyQt6.QtWidgets import QDialog, QDialogButtonBox, QPlainTextEdit, QWidget

from .controls import copy_text, dialog_buttons, push_button
from .layouts import vbox
from .messages import HISTORY


class MessageHistory(QDialog):
    """Lists all messages since the start, the newest first; brought up to date whenever it is activated."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("Messages")
        self.text = QPlainTextEdit()
        self.text.setReadOnly(True)
        self.text.setPlaceholderText("No message yet")
        self.text.setAccessibleName("Messages of this start, the newest first")
        self.copy = push_button("&Copy all", "Copy the list to the clipboard")
        self.copy.clicked.connect(self._copy)
        buttons = dialog_buttons(QDialogButtonBox.StandardButton.Close)
        buttons.addButton(self.copy, QDialogButtonBox.ButtonRole.ActionRole)
        buttons.rejected.connect(self.close)
        vbox(self.text, buttons, within=self)
        self.resize(620, 360)

    def changeEvent(self, event: QEvent | None) -> None:
        """Show what was said since the last look."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.ActivationChange and self.isActiveWindow():
            self.refresh()

    def refresh(self) -> None:
        """List the messages, with their details."""
        lines = []
        for said in reversed(HISTORY):
            details = "".join(f"\n    {line}" for line in said.details.splitlines())
            lines.append(f"{said.at:%H:%M:%S}  {said.severity}: {said.sentence}{details}")
        self.text.setPlainText("\n".join(lines))

    def _copy(self) -> None:
        copy_text(self.text.toPlainText())
