"""The eyedropper: a click in the colour image sets the mask's colour ranges."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from PyQt6.QtCore import QObject, QPoint, QPointF, pyqtSignal
from PyQt6.QtGui import QColor

from ...core.model.arrays import Uint8Array
from ...widgets.basics.gestures import new_gesture
from ...widgets.basics.messages import Severity
from ...widgets.images.eyedropper import RADIUS, EyedropperError, Mode, new_ranges
from ...widgets.images.image_strip import ImageStrip
from ...widgets.images.point_image import SPAN, Loupe
from ...widgets.parameters.parameter_panel import ParameterPanel
from ..calibration.pictures import pack_rgb
from ..context import SOURCE, Context
from ..worker.rendering import colors_around
from ..worker.results import Result

_REACH = int(SPAN) // 2
_WORDS = {
    "off": "",
    "set": "Click the membrane's prints in the colour image. Esc ends.",
    "expand": "Click prints that the mask misses in the colour image. Esc ends.",
    "shrink": "Click what the mask wrongly covers in the colour image. Esc ends.",
}


def color_around(result: Result, u: int, v: int, radius: int) -> Uint8Array:
    """Return the colours around a proximity pixel of the frame on the screen, uint8 (h, w, 3)."""
    typical_m = sum(result.rendered.depth_range_m) / 2
    return colors_around(result.frame, result.source.rig, u, v, radius, typical_m)


def hsv_words(result: Result, u: int, v: int) -> str:
    """Return hue (0 to 179), saturation and value (0 to 255) of a proximity pixel; empty outside the image."""
    height, width = result.frame.proximity_depth.shape
    if not (0 <= u < width and 0 <= v < height):
        return ""
    return _in_words(color_around(result, u, v, 0))


def _in_words(pixel: Uint8Array) -> str:
    hue, saturation, value = cv2.cvtColor(np.ascontiguousarray(pixel), cv2.COLOR_RGB2HSV)[0, 0]
    return f"H {hue}  S {saturation}  V {value}"


class Eyedropper(QObject):
    """Turns each click in the colour image into one undoable change of the mask, until it is switched off."""

    started = pyqtSignal()  # a click in the colour image is wanted, so it must be seen

    def __init__(self, context: Context, panel: ParameterPanel, strip: ImageStrip) -> None:
        super().__init__(context)
        self._context, self._document, self._messages = context, context.document, context.messages
        self._panel = panel
        self._strip = strip
        self.mode = "off"
        self._pixel = (-1, -1)
        self.loupe = Loupe(context.window)
        panel.eyedropperRequested.connect(self.use)
        strip.clicked.connect(self._clicked)
        strip.hovered.connect(self._hovered)
        strip.pickingDone.connect(lambda: self.use("off"))
        context.frameShown.connect(self._show_loupe)

    def use(self, mode: str) -> None:
        if mode != "off" and self.mode == "off":
            self.started.emit()
        self.mode = mode
        self._panel.set_eyedropper(mode)
        self._strip.set_picking(_WORDS[mode])
        self._messages.clear("eyedropper")
        self._show_loupe()

    def _hovered(self, u: int, v: int) -> None:
        self._pixel = u, v
        self._show_loupe()

    def _show_loupe(self) -> None:
        (u, v), result = self._pixel, self._context.result
        pane = self._strip.panes["color"]
        if self.mode == "off" or result is None or not pane.isVisible() or not pane.contains(u, v):
            self.loupe.hide()
            return
        window = self._context.window
        place = pane.view.mapFromScene(pane.box.mapViewToScene(QPointF(u, v)))
        cursor = pane.view.viewport().mapTo(window, QPoint(place))
        top = self._strip.mapTo(window, QPoint(0, 0)).y()
        if top > self.loupe.height():  # above the strip, where it covers neither the images nor the banner
            cursor.setY(min(cursor.y(), top))
        around = color_around(result, u, v, _REACH)
        self.loupe.set_pixels(pack_rgb(around), (max(0, u - _REACH), max(0, v - _REACH)))
        self.loupe.show_at(QPointF(cursor), (float(u), float(v)))
        pixel = color_around(result, u, v, 0)
        self.loupe.set_color(QColor(*pixel[0, 0].tolist()), _in_words(pixel))

    def _clicked(self, pane: str, u: int, v: int, _modifiers: object) -> None:
        result, mask = self._context.result, self._document.preset.mask
        if self.mode == "off" or pane != "color" or result is None:
            return
        try:
            ranges = new_ranges(color_around(result, u, v, RADIUS), mask, cast(Mode, self.mode))
        except EyedropperError as error:
            self._messages.show_message("eyedropper", Severity.WARNING, str(error), subject=SOURCE)
            return
        self._messages.clear("eyedropper")
        picked = {f"mask.{name}": getattr(ranges, name) for name in ("hue", "saturation", "value")}
        if not mask.enabled:
            picked = {"mask.enabled": True, **picked}
        self._document.edit_many(picked, new_gesture(), title="" if mask.enabled else "Pick the mask's colour")
