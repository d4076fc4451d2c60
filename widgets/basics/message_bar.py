"""Sentences above a window's views: notes, warnings and errors with buttons that answer them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from html import escape

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QColor, QPalette
from PyQt6.QtWidgets import QFrame, QHBoxLayout, QLabel, QPlainTextEdit, QPushButton, QToolButton, QVBoxLayout, QWidget

LIMIT = 4


class Severity(StrEnum):
    """Severity of a message, shown as a coloured stripe and as its first word."""

    INFO = "Note"
    WARNING = "Warning"
    ERROR = "Error"


_STRIPES = {Severity.INFO: "#3b82c4", Severity.WARNING: "#d9930d", Severity.ERROR: "#d64545"}

Offer = tuple[str, Callable[[], None]]


class Message(QFrame):
    """One sentence with its buttons, optional details, and a button that dismisses it."""

    def __init__(
        self, severity: Severity, sentence: str, offers: Sequence[Offer], details: str, close: Callable[[], None]
    ) -> None:
        super().__init__()
        self.sentence = sentence
        self.setAccessibleName(f"{severity}: {sentence}")
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self.setAutoFillBackground(True)
        self.setBackgroundRole(QPalette.ColorRole.AlternateBase)

        stripe = QFrame()
        stripe.setFixedWidth(5)
        stripe.setAutoFillBackground(True)
        stripe.setBackgroundRole(QPalette.ColorRole.Window)
        palette = stripe.palette()
        palette.setColor(QPalette.ColorRole.Window, QColor(_STRIPES[severity]))
        stripe.setPalette(palette)

        text = QLabel(f"<b>{severity}.</b> {escape(sentence)}")
        text.setTextFormat(Qt.TextFormat.RichText)
        text.setWordWrap(True)
        text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)

        row = QHBoxLayout()
        row.setContentsMargins(8, 4, 4, 4)
        row.addWidget(text, 1)
        for name, action in offers:
            button = QPushButton(name)
            button.clicked.connect(close)
            button.clicked.connect(lambda _=False, action=action: action())
            row.addWidget(button)
        body = QVBoxLayout()
        body.setSpacing(0)
        body.addLayout(row)
        if details:
            row.addWidget(self._details_button(details, body))
        dismiss = QToolButton()
        dismiss.setText("✕")
        dismiss.setAutoRaise(True)
        dismiss.setToolTip("Dismiss this message")
        dismiss.setAccessibleName("Dismiss")
        dismiss.clicked.connect(close)
        row.addWidget(dismiss)

        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(0)
        layout.addWidget(stripe)
        layout.addLayout(body, 1)

    def _details_button(self, details: str, body: QVBoxLayout) -> QToolButton:
        shown = QPlainTextEdit(details)
        shown.setReadOnly(True)
        shown.setMaximumHeight(160)
        shown.hide()
        body.addWidget(shown)
        button = QToolButton()
        button.setText("Details")
        button.setCheckable(True)
        button.toggled.connect(shown.setVisible)
        return button


class MessageBar(QWidget):
    """A short stack of messages. A message replaces an older one of the same key."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._messages: dict[str, Message] = {}
        self._layout = QVBoxLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self._layout.setSpacing(2)
        self.hide()

    def show_message(
        self, key: str, severity: Severity, sentence: str, offers: Sequence[Offer] = (), details: str = ""
    ) -> None:
        """Show a sentence until it is dismissed, answered or replaced.

        Parameters
        ----------
        key : str
            Identifies the matter; a newer message of the same key replaces this one.
        severity : Severity
        sentence : str
        offers : sequence of (button text, action)
            Buttons; pressing one dismisses the message.
        details : str
            Shown on request, such as a traceback.
        """
        old = self._messages.get(key)
        if old is not None and old.sentence == sentence:
            return
        self.clear(key)
        message = Message(severity, sentence, offers, details, lambda: self.clear(key))
        self._messages[key] = message
        self._layout.addWidget(message)
        while len(self._messages) > LIMIT:
            self.clear(next(iter(self._messages)))
        self.show()

    def state(self, key: str, severity: Severity, sentence: str) -> None:
        """Show a sentence; an empty one dismisses the message."""
        if sentence:
            self.show_message(key, severity, sentence)
        else:
            self.clear(key)

    def clear(self, key: str) -> None:
        """Dismiss the message of a key, if there is one."""
        message = self._messages.pop(key, None)
        if message is not None:
            self._layout.removeWidget(message)
            message.hide()
            message.deleteLater()
        self.setVisible(bool(self._messages))

    def sentences(self) -> list[str]:
        """Return the sentences on the screen, oldest first."""
        return [message.sentence for message in self._messages.values()]

    def message(self, key: str) -> Message | None:
        """Return the message of a key, or None."""
        return self._messages.get(key)
