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
    _svg(name)
    return QIcon(_ThemeIcon(name, color))


@lru_cache
def app_icon() -> QIcon:
    drawn = QIcon()
    renderer = QSvgRenderer((_FOLDER / "tactune.svg").read_bytes())
    for side in (16, 24, 32, 48, 64, 128, 256):
        drawn.addPixmap(QPixmap.fromImage(_drawn(renderer, QSize(side, side))))
    return drawn


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
        return QPixmap.fromImage(_tinted(self._name, size.width(), size.height(), self._tint(mode)))

    def clone(self) -> QIconEngine:
        return _ThemeIcon(self._name, self._color)

    def _tint(self, mode: QIcon.Mode) -> int:
        palette, role = QApplication.palette(), QPalette.ColorRole.ButtonText
        if mode == QIcon.Mode.Disabled:
            return palette.color(QPalette.ColorGroup.Disabled, role).rgba()
        if mode == QIcon.Mode.Selected:
            return palette.color(QPalette.ColorRole.HighlightedText).rgba()
        return (QColor(getattr(theme_colors(), self._color)) if self._color else palette.color(role)).rgba()


@lru_cache
def _svg(name: str) -> bytes:
    return (_FOLDER / f"{name}.svg").read_bytes()


@lru_cache(maxsize=512)
def _tinted(name: str, width: int, height: int, rgba: int) -> QImage:
    image = _drawn(QSvgRenderer(_svg(name)), QSize(width, height))
    painter = QPainter(image)
    painter.setCompositionMode(QPainter.CompositionMode.CompositionMode_SourceIn)
    painter.fillRect(image.rect(), QColor.fromRgba(rgba))
    painter.end()
    return image


def _drawn(renderer: QSvgRenderer, size: QSize) -> QImage:
    image = QImage(size, QImage.Format.Format_ARGB32_Premultiplied)
    image.fill(Qt.GlobalColor.transparent)
    painter = QPainter(image)
    renderer.render(painter, QRectF(image.rect()))
    painter.end()
    return image
