"""An image on which contact is painted: a brush, discs and rectangles; three labels."""

from __future__ import annotations

from math import ceil, floor, hypot
from typing import Any, Final, Literal

import cv2
import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import QEvent, QObject, QPointF, Qt, pyqtSignal
from PyQt6.QtGui import QKeyEvent, QMouseEvent, QWheelEvent

from ...core.model.arrays import BoolArray, Float64Array, Int64Array, Uint8Array
from ..basics.colormaps import CONTACT_RGB, tint
from .image_pane import ARROW_KEYS, ZOOM_KEYS, ImagePane, Swatch, moved_by_arrow

#: Labels of a pixel.
UNKNOWN, NO_CONTACT, CONTACT = 0, 1, 2
NO_CONTACT_RGB: Final = (26, 114, 224)
_PATCH_RGB: Final = (255, 214, 10)
#: Share of a label's colour in the image.
_TINTS: Final = {NO_CONTACT: (0.25, NO_CONTACT_RGB), CONTACT: (0.5, CONTACT_RGB)}
MAX_RADIUS: Final = 120
Tool = Literal["brush", "disc", "rectangle"]
Place = tuple[float, float]


class PaintImage(ImagePane):
    """Shows an image with labels over it, and the outline of a patch; a person paints the labels.

    The left button paints `value`, the right button or Shift erases to unknown. Wheel, [ and ] change the brush. Ctrl
    and wheel, + and - zoom, the middle button pans, 0 shows all. A disc is dragged from its centre, a rectangle from a
    corner: contact inside and in what is contact already, no contact elsewhere. With the keyboard: arrows move the
    brush (Shift: by ten pixels), Space paints there, Delete erases there.
    """

    painted = pyqtSignal(object)  # labels: uint8 (H, W): a stroke ended
    radiusChanged = pyqtSignal(int)

    def __init__(self, title: str) -> None:
        super().__init__(title)
        self.tool: Tool = "brush"
        self.value = CONTACT
        self._radius = 12
        self._base: Uint8Array | None = None
        self._labels: Uint8Array | None = None
        self._before: Uint8Array | None = None  # labels when the stroke began
        self._erases = False
        self._start = self._last = self._at = (0.0, 0.0)
        self._outline: BoolArray | None = None
        self._ring = pg.PlotCurveItem(pen=pg.mkPen("w", width=1.5), shadowPen=pg.mkPen((0, 0, 0, 160), width=3.5))
        self._ring.setZValue(20)
        self._ring.hide()
        self.box.addItem(self._ring, ignoreBounds=True)
        self.header.set_legend(
            None,
            (Swatch("patch", _PATCH_RGB), Swatch("no contact", NO_CONTACT_RGB), Swatch("contact", CONTACT_RGB)),
        )
        self.view.setMinimumSize(240, 180)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName(title)
        self.view.viewport().installEventFilter(self)
        self.view.viewport().setMouseTracking(True)
        self.view.viewport().setCursor(Qt.CursorShape.CrossCursor)
        self.resized.connect(lambda: self.show_rect(self.image_rect()))

    # What is shown

    @property
    def radius(self) -> int:
        """Radius of the brush, pixels."""
        return self._radius

    @property
    def labels(self) -> Uint8Array | None:
        """The labels as they are shown; None while there is nothing to paint."""
        return self._labels

    def set_radius(self, radius: int) -> None:
        """Change the brush."""
        radius = min(max(radius, 1), MAX_RADIUS)
        if radius != self._radius:
            self._radius = radius
            self._show_ring()
            self.radiusChanged.emit(radius)

    def set_image(self, pixels: Uint8Array | None, labels: Uint8Array | None, message: str = "") -> None:
        """Show uint8 (H, W, 4) as ``QImage.Format_RGB32`` and labels, uint8 (H, W); without them a message."""
        same_size = pixels is not None and self._base is not None and pixels.shape == self._base.shape
        self._base, self._labels, self._before = pixels, labels, None
        self.set_message(message if pixels is None else "")
        self._draw()
        if not same_size:
            self.show_rect(self.image_rect())

    def set_outline(self, patch: BoolArray | None) -> None:
        """Outline a patch, bool (H, W), or none."""
        self._outline = None
        if patch is not None:
            area = np.ascontiguousarray(patch).view(np.uint8)
            self._outline = cv2.morphologyEx(area, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
        self._draw()

    def _draw(self) -> None:
        if self._base is None:
            self.set_pixels(None, self._size, 1)
            return
        shown = self._base.copy()
        if self._labels is not None:
            tint_labels(shown, self._labels)
        if self._outline is not None and self._outline.shape == shown.shape[:2]:
            shown[self._outline] = (*_PATCH_RGB[::-1], 255)
        self.set_pixels(shown, (shown.shape[1], shown.shape[0]), 1)

    def _show_ring(self) -> None:
        """Show how large the brush is."""
        turns = np.linspace(0, 2 * np.pi, 49)
        self._ring.setData(self._at[0] + self._radius * np.cos(turns), self._at[1] + self._radius * np.sin(turns))
        self._ring.setVisible(
            self._labels is not None and self.tool == "brush" and self.contains(*map(round, self._at))
        )

    # Painting

    def _begin(self, place: Place, erases: bool) -> None:
        if self._labels is None:
            return
        self._before, self._erases = self._labels, erases
        self._start = self._last = place
        self._continue(place)

    def _continue(self, place: Place) -> None:
        if self._before is None or self._labels is None:
            return
        value = UNKNOWN if self._erases else self.value
        if self.tool == "brush":
            self._labels = brushed(self._labels, self._last, place, self._radius, value)
        else:
            inside = disc_of if self.tool == "disc" else rectangle_of
            area = inside(self._before.shape, self._start, place)
            self._labels = known_object(self._before, area, erases=self._erases)
        self._last = place
        self._draw()

    def _end(self) -> None:
        if self._before is not None and self._labels is not None:
            changed, self._before = not np.array_equal(self._before, self._labels), None
            if changed:
                self.painted.emit(self._labels)

    def _cancel(self) -> bool:
        """Take back the stroke that is being painted; return whether there was one."""
        if self._before is None:
            return False
        self._labels, self._before = self._before, None
        self._draw()
        return True

    # Events

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Paint with the left and right buttons, and size the brush with the wheel."""
        if isinstance(event, QWheelEvent) and not event.modifiers() & Qt.KeyboardModifier.ControlModifier:
            steps = event.angleDelta().y() / 120
            self.set_radius(round(self._radius * 1.2**steps + (0.5 if steps > 0 else -0.5)))
            return True
        if isinstance(event, QMouseEvent):
            buttons = (Qt.MouseButton.LeftButton, Qt.MouseButton.RightButton)
            place = self._place_of(event.position())
            if event.type() == QEvent.Type.MouseMove:
                self._at = place
                self._show_ring()
                self._continue(place)
                return self._before is not None
            if event.button() in buttons and event.type() == QEvent.Type.MouseButtonPress:
                self.setFocus(Qt.FocusReason.MouseFocusReason)
                shift = bool(event.modifiers() & Qt.KeyboardModifier.ShiftModifier)
                self._begin(place, erases=shift or event.button() == Qt.MouseButton.RightButton)
                return True
            if event.button() in buttons and event.type() == QEvent.Type.MouseButtonRelease:
                self._end()
                return True
        if event is not None and event.type() == QEvent.Type.Leave:
            self._ring.hide()
        return super().eventFilter(watched, event)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        if event is None:
            return
        key = Qt.Key(event.key())
        if key in ARROW_KEYS:
            self._at = moved_by_arrow(event, self._at, self._size)
            self._show_ring()
        elif key in {Qt.Key.Key_Space, Qt.Key.Key_Delete, Qt.Key.Key_Backspace} and self.tool == "brush":
            self._begin(self._at, erases=key != Qt.Key.Key_Space)
            self._end()
        elif key in {Qt.Key.Key_BracketLeft, Qt.Key.Key_BracketRight}:
            self.set_radius(self._radius + (1 if key == Qt.Key.Key_BracketRight else -1) * ceil(self._radius / 8))
        elif key in ZOOM_KEYS:
            self.box.scaleBy((1 / ZOOM_KEYS[key],) * 2, center=self._at if self._ring.isVisible() else None)
        elif key == Qt.Key.Key_0:
            self.show_rect(self.image_rect())
        elif key != Qt.Key.Key_Escape or not self._cancel():
            super().keyPressEvent(event)

    def _place_of(self, position: QPointF) -> Place:
        """Return the image place at a position of the viewport."""
        point = self.box.mapSceneToView(self.view.mapToScene(position.toPoint()))
        return point.x(), point.y()


def tint_labels(pixels: Uint8Array, labels: Uint8Array) -> None:
    """Tint an image, uint8 (H, W, 4) as ``QImage.Format_RGB32``, by its labels, in place."""
    for label, (share, rgb) in _TINTS.items():
        tint(pixels, labels == label, rgb, share)


def _grid(shape: tuple[int, ...]) -> tuple[Int64Array, Int64Array]:
    """Return columns and rows of the pixels, shapes (W,) and (H, 1)."""
    return np.arange(shape[1]), np.arange(shape[0])[:, None]


def brushed(labels: Uint8Array, start: Place, end: Place, radius: int, value: int) -> Uint8Array:
    """Return labels with a straight stroke of a round brush: all pixels within ``radius`` of it get ``value``."""
    us, vs = (
        slice(max(0, floor(min(pair)) - radius), ceil(max(pair)) + radius + 1) for pair in zip(start, end, strict=True)
    )
    columns, rows = _grid(labels.shape)
    u, v = columns[us], rows[vs]
    du, dv = end[0] - start[0], end[1] - start[1]
    length2 = du * du + dv * dv
    along: Float64Array | float = 0.0
    if length2 > 0:
        along = np.clip(((u - start[0]) * du + (v - start[1]) * dv) / length2, 0.0, 1.0)
    inside = (u - start[0] - along * du) ** 2 + (v - start[1] - along * dv) ** 2 <= radius**2
    after = labels.copy()
    after[vs, us][inside] = value
    return after


def known_object(labels: Uint8Array, area: BoolArray, erases: bool) -> Uint8Array:
    """Return labels after an object was picked: contact there and where it was before, else no contact."""
    if erases:
        return np.where(area, np.uint8(UNKNOWN), labels)
    return np.where(area | (labels == CONTACT), np.uint8(CONTACT), np.uint8(NO_CONTACT))


def disc_of(shape: tuple[int, ...], centre: Place, edge: Place) -> BoolArray:
    """Return the pixels of a disc around a centre, out to another place."""
    u, v = _grid(shape)
    inside: Any = np.hypot(u - centre[0], v - centre[1]) <= hypot(edge[0] - centre[0], edge[1] - centre[1])
    return np.asarray(inside, np.bool_)


def rectangle_of(shape: tuple[int, ...], start: Place, end: Place) -> BoolArray:
    """Return the pixels of a rectangle between two corners."""
    u, v = _grid(shape)
    across = (u >= min(start[0], end[0])) & (u <= max(start[0], end[0]))
    down = (v >= min(start[1], end[1])) & (v <= max(start[1], end[1]))
    return np.asarray(across & down, np.bool_)
