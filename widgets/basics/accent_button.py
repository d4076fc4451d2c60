"""Buttons that stay down show it in the accent colour, in both themes."""

from __future__ import annotations

from PyQt6.QtGui import QColor, QPalette
from PyQt6.QtWidgets import QPushButton, QWidget

from .theme import theme_colors


class AccentButton(QPushButton):
    """A checkable button, filled with the accent colour while it is checked."""

    def __init__(self, text: str, tip: str, parent: QWidget | None = None) -> None:
        super().__init__(text, parent)
        self.setCheckable(True)
        self.setAutoDefault(False)
        self.setToolTip(tip)
        self.toggled.connect(self._color)

    def _color(self, checked: bool) -> None:
        palette = QPalette()
        if checked:
            colors = theme_colors()
            palette.setColor(QPalette.ColorRole.Button, QColor(colors.accent).darker(118))
            palette.setColor(QPalette.ColorRole.ButtonText, QColor(colors.on_accent))
        self.setPalette(palette)
