"""Icons of one set, Material Design Icons, tinted in the theme's colours as they are painted."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from PyQt6.QtCore import QRect, QRectF, QSize, Qt
from PyQt6.QtGui import QColor, QIcon, QIconEngine, QImage, QPainter, QPalette, QPixmap
from PyQt6.QtSvg import QSvgRenderer
from PyQt6.QtWidgets import QApplication

from .theme import theme_colors

_FOLDER = Path(__file__).parents[1] / "icons"


def icon(name: str, color: str = "") -> QIcon:
    """Return a file of ``widgets/icons`` that follows the theme, in a colour of `ThemeColors` or that of buttons."""
    return QIcon(_ThemeIcon(name, color))


def app_icon() -> QIcon:
    return QIcon(str(_FOLDER / "tactune.svg"))


class _ThemeIcon(QIconEngine):
    """Draws one file in the colour that the theme has at that moment."""

    def __init__(self, name: str, color: str) -> None:
        super().__init__()
        self._name = name
        self._color = color

    def paint(self, painter: QPainter | None, rect: QRect, mode: QIcon.Mode, state: QIcon.State) -> None:
        if painter is not None:
            painter.drawPixmap(rect, self.pixmap(rect.size(), mode, state))

    def pixmap(self, size: QSize, mode: QIcon.Mode, state: QIcon.State) -> QPixmap:
        palette, role = QApplication.palette(), QPalette.ColorRole.ButtonText
        color = palette.color(role)
        if mode == QIcon.Mode.Disabled:
            color = palette.color(QPalette.ColorGroup.Disabled, role)
        elif mode == QIcon.Mode.Selected:
            color = palette.color(QPalette.ColorRole.HighlightedText)
        elif self._color:
            color = QColor(getattr(theme_colors(), self._color))
        return QPixmap.fromImage(_tinted(self._name, size.width(), size.height(), color.rgba()))

    def clone(self) -> QIconEngine:
        return _ThemeIcon(self._name, self._color)


@lru_cache(maxsize=512)
def _tinted(name: str, width: int, height: int, rgba: int) -> QImage:
    image = QImage(width, height, QImage.Format.Format_ARGB32_Premultiplied)
    image.fill(Qt.GlobalColor.transparent)
    painter = QPainter(image)
    QSvgRenderer((_FOLDER / f"{name}.svg").read_bytes()).render(painter, QRectF(image.rect()))
    painter.setCompositionMode(QPainter.CompositionMode.CompositionMode_SourceIn)
    painter.fillRect(image.rect(), QColor.fromRgba(rgba))
    painter.end()
    return image
