"""Pointing at pixels: linked views and images, and the eyedropper that sets the mask by a click."""

from __future__ import annotations

from functools import partial
from typing import cast

import cv2
import numpy as np
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.contact.alignment import make_alignment
from ...core.errors import TactuneError
from ...core.model.arrays import Uint8Array
from ...core.model.frames import Rig
from ...widgets.basics.controls import new_gesture
from ...widgets.clouds.cloud_data import DepthCloud
from ...widgets.clouds.view_camera import Place, as_place
from ...widgets.images.eyedropper import RADIUS, Mode, new_ranges
from ...widgets.images.image_strip import ImageStrip
from ...widgets.parameters.parameter_panel import ParameterPanel
from ..context import Context
from ..worker.rendering import colors_around
from ..worker.results import CloudName, Result
from .view_area import ViewArea

Pixel = tuple[int, int]
_NOWHERE: Pixel = (-1, -1)


class Pointing(QObject):
    """Puts the images' crosshair on the pixel of a point in a view, and marks the crosshair's points in the views."""

    def __init__(self, context: Context, views: ViewArea, strip: ImageStrip) -> None:
        super().__init__(context)
        self._context, self._views, self._strip = context, views.views, strip
        self._pixel = _NOWHERE
        self._leads = False
        for name, view in self._views.items():
            view.pointHovered.connect(partial(self._point_in_view, name))
        strip.hovered.connect(self._point_in_image)
        context.frameShown.connect(self._follow_frame)

    def _point_in_view(self, name: CloudName, found: tuple[int, Place] | None) -> None:
        result = self._context.result
        if result is None or found is None:
            self._lead(_NOWHERE)
            self._mark({})
            return
        pixel, place = found
        rig = result.source.rig
        v, u = divmod(pixel, rig.proximity.intrinsics.width)
        self._lead(_seen_by_proximity(place, rig) if name is CloudName.TACTILE else (u, v))
        self._mark(self._places(result) | {name: place})

    def _lead(self, pixel: Pixel) -> None:
        self._pixel = pixel
        self._leads = True
        self._strip.point_at(*pixel)
        self._leads = False

    def _point_in_image(self, u: int, v: int) -> None:
        result = self._context.result
        if not self._leads:
            self._pixel = u, v
            self._mark({} if result is None else self._places(result))

    def _follow_frame(self) -> None:
        result = self._context.result
        if result is not None and self._pixel != _NOWHERE:
            self._mark(self._places(result))

    def _mark(self, places: dict[CloudName, Place]) -> None:
        for name, view in self._views.items():
            view.set_mark(places.get(name))

    def _places(self, result: Result) -> dict[CloudName, Place]:
        """Return the points of the pixel in each view that shows one."""
        (u, v), rig = self._pixel, result.source.rig
        height, width = rig.proximity.intrinsics.shape
        if not (0 <= u < width and 0 <= v < height):
            return {}
        flat = v * width + u
        found = {name: _place(self._views[name].cloud(), flat) for name in (CloudName.PROXIMITY, CloudName.PATCH)}
        tactile = _tactile_pixel(result, flat)
        found[CloudName.TACTILE] = None if tactile is None else _place(self._views[CloudName.TACTILE].cloud(), tactile)
        return {name: place for name, place in found.items() if place is not None}


def _place(cloud: DepthCloud | None, flat: int) -> Place | None:
    if cloud is None or flat >= cloud.depth.size or not cloud.drawn().reshape(-1)[flat]:
        return None
    return as_place(cloud.places(np.array([flat]))[0])


def _seen_by_proximity(place: Place, rig: Rig) -> Pixel:
    height, width = rig.proximity.intrinsics.shape
    if place[2] <= 0:
        return _NOWHERE
    u, v = (round(float(value)) for value in rig.proximity.intrinsics.project(np.array([place]))[0])
    return (u, v) if 0 <= u < width and 0 <= v < height else _NOWHERE


def _tactile_pixel(result: Result, flat: int) -> int | None:
    """Return the flat tactile pixel that the alignment compares with a proximity pixel."""
    rig = result.source.rig
    depth_m = result.frame.proximity_depth.reshape(-1)[flat : flat + 1] * np.float32(rig.proximity.depth_unit_m)
    try:
        model = make_alignment(result.preset.alignment, rig)
    except TactuneError:
        return None
    u, v = (float(part[0]) for part in model.tactile_pixels(np.array([flat]), depth_m, rig))
    height, width = rig.tactile.intrinsics.shape
    inside = -0.5 < u < width - 0.5 and -0.5 < v < height - 0.5
    return round(v) * width + round(u) if inside else None


_WORDS = {
    "off": "",
    "set": "Click a print of the membrane. Esc ends.",
    "expand": "Click a print that the mask misses. Esc ends.",
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
    pixel = np.ascontiguousarray(color_around(result, u, v, 0))
    hue, saturation, value = cv2.cvtColor(pixel, cv2.COLOR_RGB2HSV)[0, 0]
    return f"H {hue}  S {saturation}  V {value}"


class Eyedropper(QObject):
    """Turns each click in the colour image into one undoable change of the mask, until it is switched off."""

    started = pyqtSignal()  # a click in the colour image is wanted, so it must be seen

    def __init__(self, context: Context, panel: ParameterPanel, strip: ImageStrip) -> None:
        super().__init__(context)
        self._context, self._document = context, context.document
        self._panel = panel
        self._strip = strip
        self.mode = "off"
        panel.eyedropperRequested.connect(self.use)
        strip.clicked.connect(self._clicked)
        strip.banner.done.clicked.connect(lambda: self.use("off"))

    def use(self, mode: str) -> None:
        if mode != "off" and self.mode == "off":
            self.started.emit()
        self.mode = mode
        self._panel.set_eyedropper(mode)
        self._strip.set_picking(_WORDS[mode])

    def _clicked(self, pane: str, u: int, v: int, _modifiers: object) -> None:
        result, mask = self._context.result, self._document.preset.mask
        if self.mode == "off" or pane != "color" or result is None:
            return
        ranges = new_ranges(color_around(result, u, v, RADIUS), mask, cast(Mode, self.mode))
        picked = {f"mask.{name}": getattr(ranges, name) for name in ("hue", "saturation", "value")}
        if not mask.enabled:
            picked = {"mask.enabled": True, **picked}
        self._document.edit_many(picked, new_gesture(), title="" if mask.enabled else "Pick the mask's colour")
