"""Buttons, progress bars and labels that several windows share."""

from __future__ import annotations

from PyQt6.QtGui import QFont
from PyQt6.QtWidgets import QLabel, QProgressBar, QPushButton


def push_button(text: str, tip: str, shortcut: str = "") -> QPushButton:
    """Return a button with a tooltip that Enter does not press by itself."""
    button = QPushButton(text)
    button.setToolTip(tip)
    button.setAutoDefault(False)
    if shortcut:
        button.setShortcut(shortcut)
    return button


def keep_place(progress: QProgressBar) -> None:
    """Give a bar the range 0 to 100 and keep its space while it is hidden, so that the layout does not jump."""
    progress.setRange(0, 100)
    policy = progress.sizePolicy()
    policy.setRetainSizeWhenHidden(True)
    progress.setSizePolicy(policy)


def make_verdict(label: QLabel) -> None:
    """Show a label larger and in bold: the sentence that states the result."""
    font = QFont(label.font())
    font.setPointSizeF(1.15 * font.pointSizeF())
    font.setBold(True)
    label.setFont(font)
