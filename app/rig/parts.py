"""Small settings that the tabs of the check window share."""

from __future__ import annotations

from PyQt6.QtGui import QFont
from PyQt6.QtWidgets import QLabel, QProgressBar


def keep_place(progress: QProgressBar) -> None:
    """Let a bar of 0 to 100 keep its room while it is hidden, so that nothing jumps."""
    progress.setRange(0, 100)
    policy = progress.sizePolicy()
    policy.setRetainSizeWhenHidden(True)
    progress.setSizePolicy(policy)


def make_verdict(label: QLabel) -> None:
    """Write a label larger and bold: the sentence that a person came for."""
    font = QFont(label.font())
    font.setPointSizeF(1.15 * font.pointSizeF())
    font.setBold(True)
    label.setFont(font)
