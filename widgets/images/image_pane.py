"""One image that can be zoomed, panned, pointed at and clicked."""

from __future__ import annotations

import math
from typing import Any

import pyqtgraph as pg
from PyQt6.QtCore import QEvent, QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QImage, QKeyEvent, QPainter, QPaintEvent, QPalette
from PyQt6.QtWidgets import QWidget

from ...core.model.arrays import Uint8Array
from ..basics.colormaps import Legend
from ..basics.layouts import vbox
from ..basics.overlays import Notice, Wipe, WipeGrip, paint_wipe
from ..basics.view_header import ViewHeader

#: Columns and rows that each arrow key moves, and the factor of each zoom key.
ARROW_KEYS = {Qt.Key.Key_Left: (-1, 0), Qt.Key.Key_Right: (1, 0), Qt.Key.Key_Up: (0, -1), Qt.Key.Key_Down: (0, 1)}
ZOOM_KEYS = {Qt.Key.Key_Plus: 1.25, Qt.Key.Key_Equal: 1.25, Qt.Key.Key_Minus: 0.8}


def moved_by_arrow(event: QKeyEvent, place: tuple[float, float], size: tuple[int, int]) -> tuple[int, int]:
    """Return the pixel beside a place in the direction of an arrow key, within an image; with Shift ten pixels away."""
    length = 10 if event.modifiers() & Qt.KeyboardModifier.ShiftModifier else 1
    moved = zip(place, ARROW_KEYS[Qt.Key(event.key())], size, strict=True)
    u, v = (min(max(round(at) + length * step, 0), extent - 1) for at, step, extent in moved)
    return u, v


_SMALLEST_VIEW = 6.0
_LARGEST_VIEW = 20_000.0

Rectangle = tuple[int, int, int, int]


class PixelItem(pg.GraphicsObject):  # type: ignore[misc]  # pyqtgraph has no types
    """Draws ready-made pixels; a pixel's centre lies at its integer coordinates."""

    def __init__(self) -> None:
        super().__init__()
        self._pixels: tuple[Uint8Array | None, Uint8Array | None] = (None, None)
        self._image, self._right = QImage(), QImage()
        self._split: float | None = None
        self._rect = QRectF(-0.5, -0.5, 1.0, 1.0)

    def set_pixels(self, pixels: Uint8Array | None, stride: int = 1, right: Uint8Array | None = None) -> None:
        """Show uint8 (h, w, 4) as ``QImage.Format_RGB32``, ``right`` beyond the split; each covers stride² pixels."""
        self._pixels = pixels, right  # the QImages only borrow this memory
        self._image, self._right = image_of(pixels), image_of(right)
        if pixels is not None:
            height, width = pixels.shape[:2]
            rect = QRectF(-0.5, -0.5, width * stride, height * stride)
            if rect != self._rect:
                self.prepareGeometryChange()
                self._rect = rect

    def set_split(self, split: float | None) -> None:
        """Set the column from which on the right image is shown."""
        if split != self._split:
            self._split = split
            self.update()

    def boundingRect(self) -> QRectF:
        return self._rect

    def paint(self, painter: QPainter, *_: Any) -> None:
        if not self._image.isNull():
            painter.drawImage(self._rect, self._image)
        if self._split is not None and not self._right.isNull():
            painter.save()
            painter.setClipRect(self._rect.adjusted(self._split - self._rect.left(), 0, 0, 0))
            painter.drawImage(self._rect, self._right)
            painter.restore()


def image_of(pixels: Uint8Array | None) -> QImage:
    if pixels is None:
        return QImage()
    height, width = pixels.shape[:2]
    return QImage(pixels.data, width, height, 4 * width, QImage.Format.Format_RGB32)  # type: ignore[call-overload, no-any-return]


class _View(pg.GraphicsView):  # type: ignore[misc]
    left = pyqtSignal()

    def __init__(self) -> None:
        super().__init__(background=None)  # that of the window
        self.viewport().setBackgroundRole(QPalette.ColorRole.Window)
        self.setCacheMode(self.CacheModeFlag.CacheNone)  # another theme has another background
        self.grip = WipeGrip(self.viewport())

    def leaveEvent(self, event: QEvent) -> None:
        super().leaveEvent(event)
        self.left.emit()

    def paintEvent(self, event: QPaintEvent) -> None:
        super().paintEvent(event)
        if self.grip.wipe is not None:
            paint_wipe(QPainter(self.viewport()), QRectF(self.viewport().rect()), self.grip.wipe)


class ImagePane(QWidget):
    """A titled image; its tooltip has the legend, which stands beside the title if it is enlarged."""

    hovered = pyqtSignal(int, int)  # the pixel under the mouse; -1, -1 outside the image
    clicked = pyqtSignal(int, int, object)  # u, v, modifiers
    doubleClicked = pyqtSignal()
    viewChanged = pyqtSignal(object)  # zoomed or panned to this QRectF of the image
    viewMoved = pyqtSignal()  # zoomed or panned by a person

    def __init__(self, title: str) -> None:
        super().__init__()
        self._size = (640, 480)
        self.header = ViewHeader(title)
        self.view = _View()
        self.view.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.view.setAccessibleName(title)
        self.view.setMinimumSize(80, 60)
        self.box = pg.ViewBox(lockAspect=True, invertY=True, enableMenu=False, defaultPadding=0.0)
        self.box.setLimits(minXRange=_SMALLEST_VIEW, minYRange=_SMALLEST_VIEW, maxXRange=_LARGEST_VIEW)
        self.view.setCentralItem(self.box)
        self._pixels = PixelItem()
        self.box.addItem(self._pixels, ignoreBounds=True)
        self.cross = pg.PlotCurveItem(connect="pairs", pen=pg.mkPen("w"), shadowPen=pg.mkPen((0, 0, 0, 150), width=3))
        self.cross.setZValue(20)
        self.cross.hide()
        self.box.addItem(self.cross, ignoreBounds=True)
        self.notice, self.badge = Notice(self.view), Notice(self.view, warns=True)

        vbox(self.header, (self.view, 1), within=self, margins=0, spacing=0)

        self.view.scene().sigMouseMoved.connect(self._moved)
        self.view.scene().sigMouseClicked.connect(self._clicked)
        self.view.left.connect(lambda: self.hovered.emit(-1, -1))
        self.box.sigRangeChanged.connect(self._range_changed)
        self.box.sigRangeChangedManually.connect(lambda *_: self.viewMoved.emit())

    def set_pixels(
        self, pixels: Uint8Array | None, size: tuple[int, int], stride: int, right: Uint8Array | None = None
    ) -> None:
        """Show an image of width and height ``size``; see `PixelItem.set_pixels`."""
        self._size = size
        self._pixels.set_pixels(pixels, stride, right)
        # Not the item: its scene would paint the whole window at once, for each pane and frame.
        self.view.viewport().update()

    def set_legend(self, entries: Legend) -> None:
        self.header.set_entries(entries)
        self.setToolTip(self.header.legend_tip())

    def set_wipe(self, wipe: Wipe | None) -> None:
        """Divide the visible width between two images, or show only one."""
        self.view.grip.wipe = wipe
        self._pixels.set_split(self.split())
        self.view.viewport().update()

    def split(self) -> float | None:
        """Return the column from which on the right image is shown."""
        wipe, rect = self.view.grip.wipe, self.box.viewRect()
        return None if wipe is None else rect.left() + wipe.share * rect.width()

    def set_cross(self, u: int, v: int) -> None:
        """Show the crosshair at a pixel; negative numbers hide it."""
        inside = self.contains(u, v)
        if inside:
            width, height = self._size
            self.cross.setData([u, u, -0.5, width - 0.5], [-0.5, height - 0.5, v, v])
        self.cross.setVisible(inside)

    def show_rect(self, rect: QRectF) -> None:
        self.box.setRange(rect, padding=0)

    def image_rect(self) -> QRectF:
        return QRectF(-0.5, -0.5, *self._size)

    def contains(self, u: int, v: int) -> bool:
        return 0 <= u < self._size[0] and 0 <= v < self._size[1]

    def scale(self) -> float:
        width = self.box.viewRect().width()
        return float(self.box.width() * self.devicePixelRatioF() / width) if width > 0 else 1.0

    def _range_changed(self, *_: object) -> None:
        self._pixels.set_split(self.split())
        self.viewChanged.emit(self.box.viewRect())

    def _pixel_at(self, scene_position: QPointF) -> tuple[int, int]:
        point = self.box.mapSceneToView(scene_position)
        u, v = math.floor(point.x() + 0.5), math.floor(point.y() + 0.5)
        return (u, v) if self.contains(u, v) else (-1, -1)

    def _moved(self, scene_position: QPointF) -> None:
        self.hovered.emit(*self._pixel_at(scene_position))

    def _clicked(self, event: Any) -> None:
        pixel = self._pixel_at(event.scenePos())
        if event.button() == Qt.MouseButton.LeftButton and event.double():
            self.doubleClicked.emit()
        elif event.button() == Qt.MouseButton.LeftButton and pixel != (-1, -1):
            self.clicked.emit(*pixel, event.modifiers())
