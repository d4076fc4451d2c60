"""An image to click points in: placed, dragged and nudged to fractions of a pixel, by mouse or by keys."""

from __future__ import annotations

from typing import Final

from PyQt6.QtCore import QEvent, QObject, QPointF, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QImage, QKeyEvent, QMouseEvent, QPainter, QPaintEvent, QPen
from PyQt6.QtWidgets import QWidget

from ...core.model.arrays import Uint8Array
from ..basics.theme import theme_colors
from .image_pane import ARROW_KEYS, ZOOM_KEYS, ImagePane, image_of
from .marks import COLORS, Mark, MarkKind, MarkLayer

#: Edge of the magnified square in screen pixels, and the image pixels that it spans.
EDGE: Final = 168
SPAN: Final = 21.0
_DISTANCE = 26


class Loupe(QWidget):
    """Shows the surroundings of a place in an image, enlarged, with a crosshair and a line of words below."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self._pixels: Uint8Array | None = None
        self._image = QImage()  # borrows the memory of the pixels
        self._place = (0.0, 0.0)
        self._snapped: tuple[float, float] | None = None
        self._words = ""
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.setFixedSize(self.sizeHint())
        self.hide()

    def sizeHint(self) -> QSize:
        return QSize(EDGE, EDGE + 2 * self.fontMetrics().lineSpacing() + 2)

    def set_pixels(self, pixels: Uint8Array | None) -> None:
        """Take the image: uint8 (h, w, 4), ``QImage.Format_RGB32``."""
        self._pixels = pixels
        self._image = image_of(pixels)
        self.update()

    def show_at(self, cursor: QPointF, place: tuple[float, float]) -> None:
        """Magnify an image place and move beside the cursor (parent coordinates), inside the parent."""
        self._place, self._snapped, self._words = place, None, ""
        parent = self.parentWidget()
        assert parent is not None
        x, y = cursor.x() + _DISTANCE, cursor.y() - self.height() - _DISTANCE / 2
        if x + self.width() > parent.width():
            x = cursor.x() - _DISTANCE - self.width()
        if y < 0:
            y = min(cursor.y() + _DISTANCE / 2, parent.height() - self.height())
        self.move(round(x), max(0, round(y)))
        self.show()
        self.raise_()
        self.update()

    def set_snapped(self, place: tuple[float, float] | None, words: str) -> None:
        """Mark by a ring the position that a click would set, and say in words what is there."""
        self._snapped, self._words = place, words
        self.update()

    def text(self) -> str:
        return self._words or f"{self._place[0]:.1f}  {self._place[1]:.1f}"

    def paintEvent(self, _: QPaintEvent | None) -> None:
        painter = QPainter(self)
        colors = theme_colors()
        painter.fillRect(self.rect(), QColor(colors.base))
        if not self._image.isNull():  # the centre of a pixel lies at its integer coordinates
            left, top = (at - SPAN / 2 + 0.5 for at in self._place)
            painter.drawImage(QRectF(0, 0, EDGE, EDGE), self._image, QRectF(left, top, SPAN, SPAN))
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        middle = EDGE / 2
        for pen in (QPen(QColor(0, 0, 0, 150), 3), QPen(QColor(255, 255, 255), 1)):
            painter.setPen(pen)
            for start, end in ((4, middle - 8), (middle + 8, EDGE - 4)):
                painter.drawLine(QPointF(middle, start), QPointF(middle, end))
                painter.drawLine(QPointF(start, middle), QPointF(end, middle))
        if self._snapped is not None:
            scale = EDGE / SPAN
            u, v = (self._snapped[axis] - self._place[axis] for axis in (0, 1))
            painter.setPen(QPen(COLORS[MarkKind.PENDING], 2))
            painter.drawEllipse(QPointF(middle + u * scale, middle + v * scale), 5, 5)
        painter.setPen(QColor(colors.text))
        line = QRectF(2, EDGE, EDGE - 4, self.height() - EDGE)
        painter.drawText(line, Qt.AlignmentFlag.AlignCenter | Qt.TextFlag.TextWordWrap, self.text())
        painter.setPen(QPen(QColor(colors.border), 1))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawRect(QRectF(0.5, 0.5, self.width() - 1, self.height() - 1))


#: Moving less than this, in screen pixels, is still a click.
_CLICK_SLOP = 3.0


class PointImage(ImagePane):
    """Shows marks over an image: a click on free ground places a point, a press on a mark selects it, a drag moves it.

    Keys: arrows nudge by a pixel (Shift: a tenth), Delete removes, Enter and space accept the ghost, + and - zoom.
    """

    placed = pyqtSignal(float, float, object)  # u, v, modifiers
    pressed = pyqtSignal(str, object)  # key, modifiers: a mark was pressed
    #: Key, u, v, done: a mark was moved; ``done`` when the button was released.
    dragged = pyqtSignal(str, float, float, bool)
    pointed = pyqtSignal(float, float)  # u, v: the mouse is over this place; nan, nan when it left
    nudged = pyqtSignal(float, float)  # du, dv
    deleteRequested = pyqtSignal()
    acceptRequested = pyqtSignal()
    cancelRequested = pyqtSignal()

    def __init__(self, title: str, *, magnifies: bool = True) -> None:
        super().__init__(title)
        viewport = self.view.viewport()
        self.layer = MarkLayer(self)
        self.loupe = Loupe(viewport)
        self._magnifies = magnifies
        self._held: Mark | None = None
        self._held_moves = False
        self._grip = QPointF()
        self._pressed_at: QPointF | None = None
        self._touched = False
        self.awaits_point = False  # then a click on a mark places a point, too
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName(title)
        self.view.setMinimumSize(160, 120)
        viewport.setMouseTracking(True)
        viewport.setCursor(Qt.CursorShape.CrossCursor)
        viewport.installEventFilter(self)
        self.viewMoved.connect(lambda: setattr(self, "_touched", True))
        self.box.sigResized.connect(self._fit_untouched)

    def set_image(self, pixels: Uint8Array | None, message: str = "") -> None:
        """Show uint8 (h, w, 4) as ``QImage.Format_RGB32``, or say why there is none."""
        size = self._size if pixels is None else (pixels.shape[1], pixels.shape[0])
        self._touched = self._touched and size == self._size
        self.set_pixels(pixels, size, 1)
        self.notice.set_text(message if pixels is None else "")
        self.loupe.set_pixels(pixels)
        self._fit_untouched()

    def show_all(self) -> None:
        self._touched = False
        self.show_rect(self.image_rect())

    def zoom(self, factor: float) -> None:
        rect = self.box.viewRect()
        width, height = rect.width() / factor, rect.height() / factor
        self.show_rect(QRectF(rect.center().x() - width / 2, rect.center().y() - height / 2, width, height))
        self._touched = True
        self.viewMoved.emit()

    def screen_place(self, u: float, v: float) -> QPointF:
        """Return where an image place is, in coordinates of ``view.viewport()``."""
        return self.layer.to_screen().map(QPointF(u, v))

    def image_place(self, position: QPointF) -> tuple[float, float]:
        """Return the image place at a position of ``view.viewport()``."""
        inverse, _ = self.layer.to_screen().inverted()
        place = inverse.map(position)
        return place.x(), place.y()

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Handle marks and clicks; leave panning and zooming to the view."""
        if event is None or watched is not self.view.viewport():
            return super().eventFilter(watched, event)
        kind = event.type()
        if kind == QEvent.Type.Resize:
            self.layer.setGeometry(self.view.viewport().rect())
        elif kind == QEvent.Type.Leave:
            self.loupe.hide()
            self.pointed.emit(float("nan"), float("nan"))
        elif isinstance(event, QMouseEvent):
            if kind == QEvent.Type.MouseButtonPress:
                return self._press(event)
            if kind == QEvent.Type.MouseMove:
                return self._move(event)
            if kind == QEvent.Type.MouseButtonRelease:
                return self._release(event)
        return super().eventFilter(watched, event)

    def _press(self, event: QMouseEvent) -> bool:
        self.setFocus(Qt.FocusReason.MouseFocusReason)
        if event.button() != Qt.MouseButton.LeftButton:
            return False
        self._pressed_at = event.position()
        self._held, self._held_moves = self.layer.mark_at(event.position()), False
        if self._held is None:
            return False
        self._grip = self.screen_place(self._held.u, self._held.v) - event.position()
        if not self.awaits_point:
            self.pressed.emit(self._held.key, event.modifiers())
        return True

    def _move(self, event: QMouseEvent) -> bool:
        place = self.image_place(event.position())
        inside = self._inside(place)
        if self._magnifies and inside:
            self.loupe.show_at(event.position(), place)
        else:
            self.loupe.hide()
        self.pointed.emit(*(place if inside else (float("nan"), float("nan"))))
        if self._held is None:
            return False
        if self._held_moves or self._went_far(event.position()):
            self._held_moves = True
            self.dragged.emit(self._held.key, *self.image_place(event.position() + self._grip), False)
        return True

    def _release(self, event: QMouseEvent) -> bool:
        if event.button() != Qt.MouseButton.LeftButton:
            return False
        held, moves = self._held, self._held_moves
        clicked = self._pressed_at is not None and not self._went_far(event.position())
        self._held, self._pressed_at = None, None
        place = self.image_place(event.position())
        if held is not None and moves:
            self.dragged.emit(held.key, *self.image_place(event.position() + self._grip), True)
        elif clicked and self._inside(place) and (held is None or self.awaits_point):
            self.placed.emit(*place, event.modifiers())
        return held is not None

    def _went_far(self, position: QPointF) -> bool:
        offset = position - (self._pressed_at or position)
        return offset.manhattanLength() > _CLICK_SLOP

    def _inside(self, place: tuple[float, float]) -> bool:
        return self.image_rect().contains(QPointF(*place))

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        assert event is not None
        key, modifiers = Qt.Key(event.key()), event.modifiers()
        if key in ARROW_KEYS:
            step = 0.1 if modifiers & Qt.KeyboardModifier.ShiftModifier else 1.0
            du, dv = ARROW_KEYS[key]
            self.nudged.emit(step * du, step * dv)
        elif key in {Qt.Key.Key_Delete, Qt.Key.Key_Backspace}:
            self.deleteRequested.emit()
        elif key in {Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Space}:
            self.acceptRequested.emit()
        elif key == Qt.Key.Key_Escape:
            self.cancelRequested.emit()
        elif key in ZOOM_KEYS:
            self.zoom(ZOOM_KEYS[key])
        elif key == Qt.Key.Key_0:
            self.show_all()
            self.viewMoved.emit()
        else:
            super().keyPressEvent(event)

    def _fit_untouched(self, *_: object) -> None:
        if not self._touched:
            self.show_rect(self.image_rect())
