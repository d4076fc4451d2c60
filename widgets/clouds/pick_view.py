"""A 3D view with clickable points, marks, and handles that move something by mouse or keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from typing import Final

from PyQt6.QtCore import QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QFont, QKeyEvent, QMouseEvent, QPainter, QPen
from PyQt6.QtWidgets import QWidget

from ..basics.colormaps import palette_theme
from ..basics.gestures import GestureClock
from ..basics.theme import CASING
from ..images.marks import COLORS, MarkKind
from .cloud_scene import AXIS_COLORS
from .cloud_view import CLICK_PX, CloudView
from .pose_handles import Handle, PoseHandles, moving, turning

#: Step of one key press: metres and radians.
STEP_M: Final = 0.0005
STEP_RAD: Final = radians(0.5)
_RADIUS = 6.0
_CTRL, _SHIFT = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier
#: Keys that move or turn: right, up, and towards the eye.
_NUDGE_KEYS: dict[int, tuple[float, float, float]] = {
    Qt.Key.Key_Left: (-1, 0, 0),
    Qt.Key.Key_Right: (1, 0, 0),
    Qt.Key.Key_Up: (0, 1, 0),
    Qt.Key.Key_Down: (0, -1, 0),
    Qt.Key.Key_PageUp: (0, 0, -1),
    Qt.Key.Key_PageDown: (0, 0, 1),
}


@dataclass(frozen=True)
class Spot:
    """A numbered mark at a place of the view's frame, metres."""

    place: tuple[float, float, float]
    label: str
    kind: MarkKind = MarkKind.POINT
    selected: bool = False


class PickView(CloudView):
    """A `CloudView` that reports clicked points and, where handles are set, what a person does with them.

    A click takes the point that is seen at the cursor: the nearest to the eye among those drawn there, or else
    the nearest beside it. Handles are dragged; Ctrl and drag moves across the view, Ctrl, Shift and drag turns;
    Ctrl and arrows or page keys move by `STEP_M`, with Shift they turn by `STEP_RAD`.
    """

    HELP = """<p><b>Click</b> a point to pick it. <b>Drag</b> to orbit, <b>Shift + drag</b> or middle button to pan,
    <b>wheel</b> to zoom.</p>
    <p>With handles: drag an <b>arrow</b> to move along it, a <b>ring</b> to turn about its axis;
    <b>Ctrl + drag</b> moves across the view, <b>Ctrl + Shift + drag</b> turns; <b>Ctrl + arrows or page keys</b> move
    by 0.5 mm, with <b>Shift</b> they turn by 0.5°.</p>
    <p>Keys: <b>arrows</b> orbit, <b>+ −</b> zoom, <b>R</b> reset, <b>V</b> front, <b>T</b> top, <b>S</b> side.</p>"""

    FOLLOWS_MOUSE = True

    #: Pixel, place: tuple of 3 floats: the flat pixel of the cloud and its place in the view's frame, metres.
    pointClicked = pyqtSignal(int, object)
    #: Change, gesture: to be applied from the left, in the view's frame; all changes of one
    #: drag carry one gesture.
    nudged = pyqtSignal(object, int)

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(title, parent)
        self._spots: tuple[Spot, ...] = ()
        self._handles: PoseHandles | None = None
        self._held: Handle | None = None
        self._hovered: Handle | None = None
        self._nudging = False
        self._turning = False
        self._last: tuple[float, float] = (0.0, 0.0)
        self._pressed: QPointF | None = None
        self._clock = GestureClock()
        self._pickable: int | None = None
        self._scene.ornament = self._paint_ornament

    def set_spots(self, spots: Sequence[Spot]) -> None:
        """Replace the marks."""
        self._spots = tuple(spots)
        self._canvas.update()

    def spots(self) -> tuple[Spot, ...]:
        return self._spots

    def set_handles(self, handles: PoseHandles | None) -> None:
        """Show handles around a centre, or none."""
        if handles != self._handles:
            self._handles = handles
            self._canvas.update()

    def handles(self) -> PoseHandles | None:
        return self._handles

    def set_pickable(self, pixels: int | None) -> None:
        """Restrict clicks to the first ``pixels`` pixels of the cloud; None: all."""
        self._pickable = pixels

    # Mouse

    def mousePressEvent(self, event: QMouseEvent | None) -> None:
        if event is None or event.button() != Qt.MouseButton.LeftButton:
            super().mousePressEvent(event)
            return
        at = self._on_canvas(event)
        self._last = at
        if self._handles is not None:
            self._held = self._handles.at(at, self.camera(), self._size())
            self._nudging = self._held is not None or bool(event.modifiers() & _CTRL)
            self._turning = bool(event.modifiers() & _SHIFT)
        if self._nudging:
            self._clock.hold()
            self._canvas.update()
            return
        self._pressed = event.position()
        super().mousePressEvent(event)

    def mouseMoveEvent(self, event: QMouseEvent | None) -> None:
        if event is None:
            return
        if self._nudging and self._handles is not None:
            self._nudge_to(self._on_canvas(event))
        elif self._pressed is not None and (event.position() - self._pressed).manhattanLength() <= CLICK_PX:
            return
        else:
            self._pressed = None
            self._hover(self._on_canvas(event))
            super().mouseMoveEvent(event)

    def mouseReleaseEvent(self, event: QMouseEvent | None) -> None:
        if event is not None and event.button() == Qt.MouseButton.LeftButton:
            if self._nudging:
                self._nudging, self._held = False, None
                self._clock.release()
                self._canvas.update()
                return
            if self._pressed is not None:
                self._pressed = None
                self._click(QPointF(*self._on_canvas(event)))
        super().mouseReleaseEvent(event)

    def mouseDoubleClickEvent(self, event: QMouseEvent | None) -> None:
        self.mousePressEvent(event)

    def _click(self, at: QPointF) -> None:
        found = self.pick(at, self._pickable)
        if found is not None:
            self.pointClicked.emit(*found)

    def _nudge_to(self, at: tuple[float, float]) -> None:
        assert self._handles is not None
        camera, size = self.camera(), self._size()
        if self._held is not None:
            change = self._handles.dragged(self._held, self._last, at, camera, size)
        else:
            change = self._handles.dragged_freely(self._last, at, self._turning, camera, size)
        self._last = at
        self.nudged.emit(change, self._clock.number())

    def _hover(self, at: tuple[float, float]) -> None:
        hovered = self._handles.at(at, self.camera(), self._size()) if self._handles is not None else None
        if hovered != self._hovered:
            self._hovered = hovered
            self._canvas.update()

    # Keys

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        if event is None or not self._nudges(event):
            super().keyPressEvent(event)
            return
        if self._handles is None:
            event.ignore()
            return
        right, up, back = self.camera().axes()
        across, upwards, towards = _NUDGE_KEYS[event.key()]
        if event.modifiers() & _SHIFT:
            # as if the side that one sees went along with the arrow
            vector = STEP_RAD * (across * up - upwards * right + towards * back)
            change = turning(vector, self._handles.centre)
        else:
            change = moving(STEP_M * (across * right + upwards * up + towards * back))
        self.nudged.emit(change, self._clock.number())

    @staticmethod
    def _knows(event: QKeyEvent) -> bool:
        return CloudView._knows(event) or PickView._nudges(event)

    @staticmethod
    def _nudges(event: QKeyEvent) -> bool:
        return bool(event.modifiers() & _CTRL) and event.key() in _NUDGE_KEYS

    # Painting

    def _paint_ornament(self, painter: QPainter, canvas: QWidget) -> None:
        size = max(1, canvas.width()), max(1, canvas.height())
        if self._handles is not None:
            colors = AXIS_COLORS[palette_theme(canvas.palette())]
            self._handles.paint(painter, self._held or self._hovered, colors, self.camera(), size)
        if not self._spots:
            return
        font = QFont(canvas.font())
        font.setBold(True)
        painter.setFont(font)
        for spot, (u, v, w) in zip(
            self._spots, self.camera().project([spot.place for spot in self._spots], *size), strict=True
        ):
            if w > 0:
                _paint_spot(painter, spot, QPointF(float(u), float(v)))

    def _on_canvas(self, event: QMouseEvent) -> tuple[float, float]:
        at = self._canvas.mapFrom(self, event.position())
        return at.x(), at.y()

    def _size(self) -> tuple[int, int]:
        return max(1, self._canvas.width()), max(1, self._canvas.height())


def _paint_spot(painter: QPainter, spot: Spot, at: QPointF) -> None:
    radius = _RADIUS + (2.0 if spot.selected else 0.0)
    for color, width in ((CASING, 4.0), (COLORS[spot.kind], 2.0)):
        painter.setPen(QPen(color, width))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawEllipse(at, radius, radius)
        painter.drawPoint(at)
    metrics = painter.fontMetrics()
    width, height = metrics.horizontalAdvance(spot.label) + 8.0, float(metrics.height())
    plate = QRectF(at.x() + radius + 2, at.y() - height / 2, width, height)
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(CASING)
    painter.drawRoundedRect(plate, 4.0, 4.0)
    painter.setPen(COLORS[spot.kind])
    painter.drawText(plate, int(Qt.AlignmentFlag.AlignCenter), spot.label)
