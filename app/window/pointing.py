"""One pixel in all views and images: pointing in one marks it in the others, and two points give a distance."""

from __future__ import annotations

from functools import partial

import numpy as np
from PyQt6.QtCore import QObject

from ...core.errors import TactuneError
from ...core.model.frames import Rig
from ...widgets.basics.messages import Severity
from ...widgets.clouds.cloud_data import DepthCloud
from ...widgets.clouds.cloud_view import Place, as_place
from ...widgets.images.image_strip import ImageStrip
from ..context import TASK, Context
from ..worker.results import CloudName, Result, SourceInfo
from ..worker.tactile_use import alignment_model
from .view_area import ViewArea

Pixel = tuple[int, int]
_NOWHERE: Pixel = (-1, -1)
_NO_MARK = (
    "No point is marked: move the crosshair in the images to a pixel with depth (arrow keys), then press Shift+D."
)


class Pointing(QObject):
    """Puts the images' crosshair on the pixel of a point in a view, and marks the crosshair's points in the views."""

    def __init__(self, context: Context, views: ViewArea, strip: ImageStrip) -> None:
        super().__init__(context)
        self._context, self._views, self._strip = context, views.views, strip
        self._pixel = _NOWHERE
        self._leads = False
        self._ends: tuple[Place, ...] = ()
        self._source: SourceInfo | None = None
        for name, view in self._views.items():
            view.pointHovered.connect(partial(self._point_in_view, name))
            view.endChosen.connect(self.add_end)
        strip.hovered.connect(self._point_in_image)
        context.frameShown.connect(self._follow_frame)

    def add_end(self, place: Place) -> None:
        """Choose an end of a distance; a third one begins another distance."""
        self._show_ends((*self._ends, place) if len(self._ends) == 1 else (place,))

    def add_marked(self) -> None:
        """Choose the point under the images' crosshair as an end, or say that there is none."""
        order = CloudName.PATCH, CloudName.PROXIMITY, CloudName.TACTILE
        mark = next((mark for name in order if (mark := self._views[name].mark()) is not None), None)
        if mark is None:
            self._context.messages.show_message("measure", Severity.INFO, _NO_MARK, subject=TASK)
        else:
            self.add_end(mark)

    def clear_distance(self) -> bool:
        """Remove the distance; return whether there was one."""
        shown = bool(self._ends)
        self._show_ends(())
        return shown

    def _show_ends(self, ends: tuple[Place, ...]) -> None:
        self._ends = ends
        for view in self._views.values():
            view.set_ends(ends)

    def _point_in_view(self, name: CloudName, found: tuple[int, Place] | None) -> None:
        result = self._context.result
        if result is None or found is None:
            self._lead(_NOWHERE)
            self._mark({})
            return
        pixel, place = found
        rig = result.source.rig
        self._lead(_seen_by_proximity(place, rig) if name is CloudName.TACTILE else _pixel_of(pixel, rig))
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
        if result is None:
            return
        if result.source is not self._source:
            self._source = result.source
            self.clear_distance()
        if self._pixel != _NOWHERE:
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


def _pixel_of(flat: int, rig: Rig) -> Pixel:
    v, u = divmod(flat, rig.proximity.intrinsics.width)
    return u, v


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
        model = alignment_model(result.preset.alignment, rig)
    except TactuneError:
        return None
    u, v = (float(part[0]) for part in model.tactile_pixels(np.array([flat]), depth_m, rig))
    height, width = rig.tactile.intrinsics.shape
    inside = -0.5 < u < width - 0.5 and -0.5 < v < height - 0.5
    return round(v) * width + round(u) if inside else None
