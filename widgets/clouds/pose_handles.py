"""Handles that move and turn something in a 3D view: three arrows and three rings; no widget needed."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import pi
from typing import Final

import numpy as np
import numpy.typing as npt
from PyQt6.QtCore import QPointF, Qt
from PyQt6.QtGui import QColor, QPainter, QPen, QPolygonF
from scipy.spatial.transform import Rotation

from ...core.model.arrays import Float64Array
from .view_camera import NEAR, ViewCamera

Size = tuple[int, int]

#: Distance in pixels within which the mouse grabs a handle.
REACH: Final = 7.0
_ARROW_PX, _RING_PX = 74.0, 56.0
_RING_STEPS = 48
#: How far an arrow seen from its end may be foreshortened before its drags are no longer made up for.
_FLATTEST: Final = 0.1
#: An arrow that points at the eye is shorter than this on the screen, and a ring seen from its edge flatter.
_MIN_LENGTH_PX = 14.0
_CASING = QColor(0, 0, 0, 150)


class Handle(StrEnum):
    """A handle, named by its effect."""

    MOVE_X = "move along x"
    MOVE_Y = "move along y"
    MOVE_Z = "move along z"
    TURN_X = "turn about x"
    TURN_Y = "turn about y"
    TURN_Z = "turn about z"

    @property
    def axis(self) -> int:
        """0, 1 or 2."""
        return "xyz".index(self.value[-1])

    @property
    def turns(self) -> bool:
        return self.value.startswith("turn")


@dataclass(frozen=True)
class PoseHandles:
    """Arrows and rings of the view's axes around a centre, of the same size on the screen at any distance.

    Attributes
    ----------
    centre : tuple of 3 floats
        Metres, in the frame of the view.
    """

    centre: tuple[float, float, float]

    def lines(self, camera: ViewCamera, size: Size) -> dict[Handle, Float64Array]:
        """Return the screen polyline of each draggable handle, float64 (K, 2) pixels."""
        if camera.project([self.centre], *size)[0, 2] <= NEAR * camera.distance:
            return {}
        metre = self._metres_per_px(camera, size)
        angles = np.linspace(0.0, 2 * pi, _RING_STEPS + 1)
        lines: dict[Handle, Float64Array] = {}
        for handle in Handle:
            if handle.turns:
                across, along = _others(handle.axis)
                offsets = _RING_PX * metre * (np.outer(np.cos(angles), across) + np.outer(np.sin(angles), along))
            else:
                offsets = np.outer([0.0, _ARROW_PX * metre], np.eye(3)[handle.axis])
            line = camera.project(np.array(self.centre) + offsets, *size)[:, :2]
            if np.ptp(line, axis=0).max() >= _MIN_LENGTH_PX:
                lines[handle] = line
        return lines

    def at(self, place: tuple[float, float], camera: ViewCamera, size: Size) -> Handle | None:
        """Return the handle under the mouse. Only the outer half of an arrow counts, so that rings stay reachable."""
        best, found = REACH, None
        for handle, line in self.lines(camera, size).items():
            start, end = (line[:-1], line[1:]) if handle.turns else (line.mean(axis=0)[None], line[1:])
            distance = float(_distances(np.array(place), start, end).min())
            if distance < best:
                best, found = distance, handle
        return found

    def dragged(
        self, handle: Handle, before: tuple[float, float], after: tuple[float, float], camera: ViewCamera, size: Size
    ) -> Float64Array:
        """Return the transform of a drag between two pixels: float64 (4, 4), applied from the left."""
        moved = np.array(after) - np.array(before)
        centre, axis = np.array(self.centre), np.eye(3)[handle.axis]
        metre = self._metres_per_px(camera, size)
        if not handle.turns:
            per_metre = self._screen_change(centre, metre * axis, camera, size) / metre
            return moving(axis * float(moved @ per_metre) / max(float(per_metre @ per_metre), (_FLATTEST / metre) ** 2))
        across, along = _others(handle.axis)
        angles = np.linspace(0.0, 2 * pi, 4 * _RING_STEPS, endpoint=False)
        ring = _RING_PX * metre * (np.outer(np.cos(angles), across) + np.outer(np.sin(angles), along))
        places = camera.project(centre + ring, *size)[:, :2]
        held = int(np.argmin(((places - np.array(before)) ** 2).sum(axis=1)))
        step = 1e-3
        tangent = self._screen_change(centre + ring[held], step * np.cross(axis, ring[held]), camera, size) / step
        return turning(axis * float(moved @ tangent) / max(float(tangent @ tangent), 1.0), centre)

    def dragged_freely(
        self, before: tuple[float, float], after: tuple[float, float], turn: bool, camera: ViewCamera, size: Size
    ) -> Float64Array:
        """Return the transform of a drag beside the handles: translation in the view plane, or an orbit."""
        dx, dy = np.array(after) - np.array(before)
        right, up, _ = camera.axes()
        if not turn:
            return moving((dx * right - dy * up) * self._metres_per_px(camera, size))
        per_px = pi / max(1, min(size))
        return turning((dx * up + dy * right) * per_px, np.array(self.centre))

    def paint(
        self, painter: QPainter, held: Handle | None, colors: tuple[QColor, ...], camera: ViewCamera, size: Size
    ) -> None:
        """Paint all handles, the active one thicker; ``colors`` are those of x, y and z."""
        for handle, line in self.lines(camera, size).items():
            points = [QPointF(float(x), float(y)) for x, y in line]
            width = 3.4 if handle is held else 1.8
            for color, extra in ((_CASING, 1.6), (colors[handle.axis], 0.0)):
                painter.setPen(QPen(color, width + extra, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
                painter.drawPolyline(QPolygonF(points))
                if not handle.turns:
                    painter.setBrush(color)
                    painter.drawEllipse(points[-1], width + 1.2, width + 1.2)
                    painter.setBrush(Qt.BrushStyle.NoBrush)

    def _metres_per_px(self, camera: ViewCamera, size: Size) -> float:
        """Return the length at the centre's distance that one pixel shows."""
        right, _, _ = camera.axes()
        return 1e-3 / float(np.linalg.norm(self._screen_change(np.array(self.centre), 1e-3 * right, camera, size)))

    @staticmethod
    def _screen_change(place: Float64Array, step: Float64Array, camera: ViewCamera, size: Size) -> Float64Array:
        there, here = camera.project([place + step, place], *size)[:, :2]
        change: Float64Array = there - here
        return change


def moving(metres: npt.ArrayLike) -> Float64Array:
    """Return a translation: float64 (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, 3] = metres
    return matrix


def turning(radians: npt.ArrayLike, centre: npt.ArrayLike) -> Float64Array:
    """Return the rotation about a centre by a rotation vector: float64 (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(np.asarray(radians, np.float64)).as_matrix()
    pivot = np.asarray(centre, np.float64)
    matrix[:3, 3] = pivot - matrix[:3, :3] @ pivot
    return matrix


def _others(axis: int) -> tuple[Float64Array, Float64Array]:
    """Return the two axes that span the plane of a ring."""
    eye = np.eye(3)
    return eye[(axis + 1) % 3], eye[(axis + 2) % 3]


def _distances(place: Float64Array, start: Float64Array, end: Float64Array) -> Float64Array:
    """Return how far a place lies from each line from start to end, pixels."""
    along = end - start
    share = ((place - start) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12)
    nearest = start + np.clip(share, 0.0, 1.0)[:, None] * along
    distances: Float64Array = np.linalg.norm(place - nearest, axis=1)
    return distances
