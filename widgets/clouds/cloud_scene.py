"""What a cloud view shows, and the overlays that are painted over it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

from PyQt6.QtCore import QPointF, QRectF, Qt
from PyQt6.QtGui import QColor, QFontMetricsF, QImage, QPainter, QPalette, QPen
from PyQt6.QtWidgets import QWidget

from ..basics.colormaps import Theme, palette_theme
from ..basics.stale_badge import paint_badge
from ..basics.theme import text_font
from ..basics.wipe import Wipe, paint_wipe
from .cloud_data import DepthCloud
from .view_camera import ViewCamera

AXIS_COLORS = {
    "light": (QColor(200, 40, 40), QColor(25, 135, 60), QColor(40, 90, 210)),
    "dark": (QColor(255, 115, 110), QColor(100, 210, 130), QColor(125, 165, 255)),
}
_AXIS_LENGTH, _AXIS_MARGIN = 22.0, 34.0
#: Cosine to the viewing direction above which an axis gets no letter: it appears as a dot.
_FACING = 0.97
_MESSAGE_FLAGS = int(Qt.AlignmentFlag.AlignCenter | Qt.TextFlag.TextWordWrap)


@dataclass
class CloudScene:
    """The state that a view shares with the canvas that draws it."""

    cloud: DepthCloud | None = None
    right: DepthCloud | None = None  # Drawn right of the wipe, if there is one
    wipe: Wipe | None = None
    camera: ViewCamera = field(default_factory=ViewCamera)
    point_size: float = 2.0  # Device-independent pixels
    running: bool = False  # Frames follow each other
    message: str = ""
    badge: str = ""  # Says why the cloud is old, and dims it
    ornament: Callable[[QPainter, QWidget], None] | None = None  # Paints what a view adds, such as marks

    def parts(self, width: int) -> tuple[tuple[DepthCloud | None, int, int], tuple[DepthCloud | None, int, int]]:
        """Return both clouds with their first column and the first after it; one that both sides share is whole."""
        column = width if self.wipe is None or self.right is self.cloud else self.wipe.column(width)
        return (self.cloud, 0, column), (self.right, column, width)

    @staticmethod
    def background(widget: QWidget) -> tuple[int, int, int]:
        color = widget.palette().color(QPalette.ColorRole.Base)
        return color.red(), color.green(), color.blue()


def paint_overlay(painter: QPainter, widget: QWidget, scene: CloudScene) -> None:
    """Paint the axes, the wipe, the message and the badge over a drawn cloud."""
    if scene.badge:
        paint_badge(painter, QRectF(widget.rect()), widget.palette(), widget.font(), scene.badge)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    _paint_axes(painter, widget, scene.camera)
    if scene.ornament is not None:
        scene.ornament(painter, widget)
    if scene.wipe is not None:
        paint_wipe(painter, QRectF(widget.rect()), scene.wipe, text_font("caption"))
    if scene.message:
        _paint_message(painter, widget, scene.message)


def _paint_axes(painter: QPainter, widget: QWidget, camera: ViewCamera) -> None:
    """Paint x, y, z of the proximity frame as seen by the camera."""
    theme, letters = palette_theme(widget.palette()), text_font("caption", bold=True).key()
    image = _axes_image(camera.azimuth, camera.elevation, theme, letters, widget.devicePixelRatioF())
    painter.drawImage(QPointF(0.0, widget.height() - 2 * _AXIS_MARGIN), image)


@lru_cache(maxsize=4)
def _axes_image(azimuth: float, elevation: float, theme: Theme, _letters: str, ratio: float) -> QImage:
    """Return the axes on a transparent ground, drawn only when the camera turns: the farthest axis first."""
    side = round(2 * _AXIS_MARGIN * ratio)
    image = QImage(side, side, QImage.Format.Format_ARGB32_Premultiplied)
    image.setDevicePixelRatio(ratio)
    image.fill(Qt.GlobalColor.transparent)
    painter = QPainter(image)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setFont(text_font("caption", bold=True))
    origin = QPointF(_AXIS_MARGIN, _AXIS_MARGIN)
    right, up, back = ViewCamera(azimuth=azimuth, elevation=elevation).axes()
    for axis in sorted(range(3), key=lambda axis: float(back[axis])):
        direction = QPointF(float(right[axis]), -float(up[axis]))
        tip = origin + direction * _AXIS_LENGTH
        painter.setPen(QPen(AXIS_COLORS[theme][axis], 2.0, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
        painter.drawLine(origin, tip)
        if abs(float(back[axis])) > _FACING:
            continue
        label = QRectF(-8.0, -8.0, 16.0, 16.0).translated(origin + direction * (_AXIS_LENGTH + 7.0))
        painter.drawText(label, Qt.AlignmentFlag.AlignCenter, "xyz"[axis])
    painter.end()
    return image


def message_rect(widget: QWidget, message: str) -> QRectF:
    return QFontMetricsF(text_font("body")).boundingRect(_message_room(widget), _MESSAGE_FLAGS, message)


def _message_room(widget: QWidget) -> QRectF:
    return QRectF(widget.rect()).adjusted(24.0, 12.0, -24.0, -12.0)


def _paint_message(painter: QPainter, widget: QWidget, message: str) -> None:
    painter.setFont(text_font("body"))
    room, text = _message_room(widget), message_rect(widget, message)
    plate = widget.palette().color(QPalette.ColorRole.Base)
    plate.setAlpha(215)
    painter.setPen(Qt.PenStyle.NoPen)
    painter.setBrush(plate)
    painter.drawRoundedRect(text.adjusted(-12.0, -8.0, 12.0, 8.0), 6.0, 6.0)
    painter.setPen(widget.palette().color(QPalette.ColorRole.Text))
    painter.drawText(room, _MESSAGE_FLAGS, message)
