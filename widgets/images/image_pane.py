"""One image that can be zoomed, panned, pointed at and clicked."""

from __future__ import annotations

import math
from typing import Any

import pyqtgraph as pg
from PyQt6.QtCore import QEvent, QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QImage, QMouseEvent, QPainter
from PyQt6.QtWidgets import QLabel, QVBoxLayout, QWidget

from ...core.model.arrays import Uint8Array
from ..basics.stale_badge import StaleBadge
from ..basics.theme import theme_colors
from .pane_header import PaneHeader

_SMALLEST_VIEW = 6.0
_LARGEST_VIEW = 20_000.0

Rectangle = tuple[int, int, int, int]


class PixelItem(pg.GraphicsObject):  # type: ignore[misc]  # pyqtgraph has no types
    """Draws ready-made pixels; a pixel's centre lies at its integer coordinates."""

    def __init__(self) -> None:
        super().__init__()
        self._pixels: Uint8Array | None = None
        self._image = QImage()
        self._rect = QRectF(-0.5, -0.5, 1.0, 1.0)

    def set_pixels(self, pixels: Uint8Array | None, stride: int = 1) -> None:
        """Show uint8 (h, w, 4) as ``QImage.Format_RGB32``; each covers stride x stride image pixels."""
        self._pixels = pixels  # the QImage only borrows this memory
        if pixels is None:
            self._image = QImage()
        else:
            height, width = pixels.shape[:2]
            self._image = QImage(pixels.data, width, height, 4 * width, QImage.Format.Format_RGB32)  # type: ignore[call-overload]
            rect = QRectF(-0.5, -0.5, width * stride, height * stride)
            if rect != self._rect:
                self.prepareGeometryChange()
                self._rect = rect
        self.update()

    def boundingRect(self) -> QRectF:
        """Return the extent in image coordinates."""
        return self._rect

    def paint(self, painter: QPainter, *_: Any) -> None:
        """Draw the pixels."""
        if not self._image.isNull():
            painter.drawImage(self._rect, self._image)


class _View(pg.GraphicsView):  # type: ignore[misc]
    """Tells when the mouse leaves and when it is double-clicked."""

    left = pyqtSignal()
    doubleClicked = pyqtSignal()

    def leaveEvent(self, event: QEvent) -> None:
        super().leaveEvent(event)
        self.left.emit()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        super().mouseDoubleClickEvent(event)
        if event.button() == Qt.MouseButton.LeftButton:
            self.doubleClicked.emit()


class ImagePane(QWidget):
    """A titled image with a legend.

    Signals
    -------
    hovered(u: int, v: int)
        The pixel under the mouse; -1, -1 outside the image.
    clicked(u: int, v: int, modifiers: Qt.KeyboardModifier)
    doubleClicked()
    viewChanged(rect: QRectF)
        Zoomed or panned, by whomever, in image coordinates.
    viewMoved()
        Zoomed or panned by a person.
    resized()
    """

    hovered = pyqtSignal(int, int)
    clicked = pyqtSignal(int, int, object)
    doubleClicked = pyqtSignal()
    viewChanged = pyqtSignal(object)
    viewMoved = pyqtSignal()
    resized = pyqtSignal()

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._size = (640, 480)
        self.header = PaneHeader(title)
        self.view = _View()
        self.view.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.view.setAccessibleName(title)
        self.view.setMinimumSize(80, 60)
        self.box = pg.ViewBox(lockAspect=True, invertY=True, enableMenu=False, defaultPadding=0.0)
        self.box.setLimits(minXRange=_SMALLEST_VIEW, minYRange=_SMALLEST_VIEW, maxXRange=_LARGEST_VIEW)
        self.view.setCentralItem(self.box)
        self._pixels = PixelItem()
        self.box.addItem(self._pixels, ignoreBounds=True)
        self._cross = pg.PlotCurveItem(connect="pairs", pen=pg.mkPen("w"), shadowPen=pg.mkPen((0, 0, 0, 150), width=3))
        self._cross.setZValue(20)
        self._cross.hide()
        self.box.addItem(self._cross, ignoreBounds=True)
        self._empty = QLabel("", self.view)
        self._empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._empty.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._badge = StaleBadge(self.view)

        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(1)
        layout.addWidget(self.header)
        layout.addWidget(self.view, 1)

        self.view.scene().sigMouseMoved.connect(self._moved)
        self.view.scene().sigMouseClicked.connect(self._clicked)
        self.view.left.connect(lambda: self.hovered.emit(-1, -1))
        self.view.doubleClicked.connect(self.doubleClicked)
        self.box.sigRangeChanged.connect(lambda *_: self.viewChanged.emit(self.box.viewRect()))
        self.box.sigRangeChangedManually.connect(lambda *_: self.viewMoved.emit())
        self.box.sigResized.connect(lambda *_: self.resized.emit())
        self._recolor()

    def set_pixels(self, pixels: Uint8Array | None, size: tuple[int, int], stride: int) -> None:
        """Show an image of width and height ``size``; see `PixelItem.set_pixels`."""
        self._size = size
        self._pixels.set_pixels(pixels, stride)

    def set_message(self, text: str) -> None:
        """Say why there is no image; empty where there is one."""
        self._empty.setText(text)
        self._empty.setGeometry(self.view.rect())

    def set_badge(self, text: str) -> None:
        """Mark the image as old and say so; nothing: it is what the cameras see."""
        self._badge.set_text(text)

    def set_cross(self, u: int, v: int) -> None:
        """Mark a pixel; negative numbers unmark."""
        inside = self.contains(u, v)
        if inside:
            width, height = self._size
            self._cross.setData([u, u, -0.5, width - 0.5], [-0.5, height - 0.5, v, v])
        self._cross.setVisible(inside)

    def show_rect(self, rect: QRectF) -> None:
        """Zoom to a rectangle in image coordinates."""
        self.box.setRange(rect, padding=0)

    def image_rect(self) -> QRectF:
        """Return the whole image in its own coordinates."""
        return QRectF(-0.5, -0.5, *self._size)

    def contains(self, u: int, v: int) -> bool:
        """Whether the image has such a pixel."""
        return 0 <= u < self._size[0] and 0 <= v < self._size[1]

    def scale(self) -> float:
        """Return how many screen pixels an image pixel takes."""
        width = self.box.viewRect().width()
        return float(self.box.width() * self.devicePixelRatioF() / width) if width > 0 else 1.0

    def widget_position(self, u: float, v: float) -> QPointF:
        """Return where an image pixel is, in coordinates of ``view.viewport()``."""
        return QPointF(self.view.mapFromScene(self.box.mapViewToScene(QPointF(u, v))))

    def changeEvent(self, event: QEvent | None) -> None:
        """Follow the theme."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.PaletteChange:
            self._recolor()

    def resizeEvent(self, event: Any) -> None:
        """Keep the message in the middle."""
        super().resizeEvent(event)
        self._empty.setGeometry(self.view.rect())
        self._badge.setGeometry(self.view.rect())

    def _recolor(self) -> None:
        self.view.setBackground(theme_colors().base)

    def _pixel_at(self, scene_position: QPointF) -> tuple[int, int]:
        point = self.box.mapSceneToView(scene_position)
        u, v = math.floor(point.x() + 0.5), math.floor(point.y() + 0.5)
        return (u, v) if self.contains(u, v) else (-1, -1)

    def _moved(self, scene_position: QPointF) -> None:
        self.hovered.emit(*self._pixel_at(scene_position))

    def _clicked(self, event: Any) -> None:
        pixel = self._pixel_at(event.scenePos())
        if event.button() == Qt.MouseButton.LeftButton and not event.double() and pixel != (-1, -1):
            self.clicked.emit(*pixel, event.modifiers())
