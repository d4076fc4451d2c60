"""The orbiting perspective camera of a 3D view; draws nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import cos, pi, radians, sin, tan
from typing import Literal, Self

import numpy as np
import numpy.typing as npt

from ...core.model.arrays import Float64Array

Viewpoint = Literal["reset", "front", "top", "side"]
Place = tuple[float, float, float]

#: Azimuth and elevation of the named viewpoints, radians.
VIEWPOINTS: dict[Viewpoint, tuple[float, float]] = {
    "reset": (radians(-28.0), radians(24.0)),
    "front": (0.0, 0.0),
    "top": (0.0, pi / 2),
    "side": (radians(90.0), 0.0),
}

#: Near and far plane as multiples of the distance to the target.
NEAR, FAR = 0.02, 50.0

#: Share of the view that a framed cloud may fill.
FILL = 0.92

#: Percentiles that count as the edges of a cloud, so that flying pixels do not affect framing.
_EDGES = (0.5, 99.5)

_SHORTEST_M, _LONGEST_M = 0.005, 100.0


@dataclass(frozen=True)
class ViewCamera:
    """A camera that orbits a target, in the proximity depth frame (x right, y down, z forward); image up stays up.

    At azimuth 0 and elevation 0 the eye stands behind the depth cameras, ``distance`` metres from the target, and looks
    along +z as they do. Azimuth is counted in radians to the right, around the vertical axis through the target,
    elevation above the horizontal plane, from -pi/2 to pi/2; ``field_of_view`` over the shorter side of the view.
    """

    target: Place = (0.0, 0.0, 0.25)
    distance: float = 0.6
    azimuth: float = VIEWPOINTS["reset"][0]
    elevation: float = VIEWPOINTS["reset"][1]
    field_of_view: float = radians(32.0)

    def axes(self) -> Float64Array:
        """Return the unit vectors right, up and back (towards the eye) as rows: float64 (3, 3)."""
        ca, sa, ce, se = cos(self.azimuth), sin(self.azimuth), cos(self.elevation), sin(self.elevation)
        return np.array([[ca, 0.0, sa], [-se * sa, -ce, se * ca], [sa * ce, -se, -ca * ce]])

    def eye(self) -> Float64Array:
        eye: Float64Array = np.array(self.target) + self.distance * self.axes()[2]
        return eye

    @lru_cache(maxsize=8)  # noqa: B019  # of cameras that no longer exist, 8 are kept
    def pixel_matrix(self, width: int, height: int) -> Float64Array:
        """Return the matrix (3, 4) that takes a homogeneous point to ``(u w, v w, w)``.

        ``w`` is the distance along the viewing direction, metres; ``u`` runs right and ``v`` down from the view's upper
        left corner; pixel centres lie at halves.
        """
        right, up, back = self.axes()
        focal = self._focal(width, height)
        matrix = np.empty((3, 4))
        matrix[:, :3] = focal * right - width / 2 * back, -focal * up - height / 2 * back, -back
        matrix[:, 3] = -matrix[:, :3] @ self.eye()
        matrix.flags.writeable = False
        return matrix

    def project(self, points: npt.ArrayLike, width: int, height: int) -> Float64Array:
        """Project points (N, 3) to ``(u, v, w)``; see `pixel_matrix`."""
        points = np.asarray(points, dtype=np.float64)
        matrix = self.pixel_matrix(width, height)
        projected = points @ matrix[:, :3].T + matrix[:, 3]
        projected[:, :2] /= projected[:, 2:]
        return projected

    def orbited(self, right: float, up: float) -> Self:
        """Move the eye around the target by radians; it stops above and below the target."""
        azimuth = (self.azimuth + right + pi) % (2 * pi) - pi
        return replace(self, azimuth=azimuth, elevation=min(max(self.elevation + up, -pi / 2), pi / 2))

    def panned(self, dx: float, dy: float, width: int, height: int) -> Self:
        """Shift the target so that the scene moves by ``(dx, dy)`` pixels on the screen, y down."""
        right, up, _ = self.axes()
        metres = self.distance / self._focal(width, height)
        target = np.array(self.target) + metres * (dy * up - dx * right)
        return replace(self, target=as_place(target))

    def zoomed(self, factor: float, at: tuple[float, float], width: int, height: int) -> Self:
        """Divide the distance by ``factor``, keeping the point under pixel ``at`` in place."""
        distance = min(max(self.distance / factor, _SHORTEST_M), _LONGEST_M)
        kept = 1.0 - distance / self.distance
        dx, dy = kept * (width / 2 - at[0]), kept * (height / 2 - at[1])
        return replace(self.panned(dx, dy, width, height), distance=distance)

    def looking_from(self, viewpoint: Viewpoint) -> Self:
        azimuth, elevation = VIEWPOINTS[viewpoint]
        return replace(self, azimuth=azimuth, elevation=elevation)

    def framing(self, points: npt.ArrayLike, width: float, height: float, fill: float = FILL) -> Self:
        """Move so that points (N, 3), metres, take the share ``fill`` of the view, keeping the direction of view."""
        points = np.asarray(points, dtype=np.float64)
        if len(points) == 0:
            return self
        axes = self.axes()
        along = points @ axes.T
        half_width, half_height = 0.5 * fill * np.array([width, height]) / self._focal(width, height)
        x, x_distance = _frame_one_axis(along[:, 0], along[:, 2], float(half_width))
        y, y_distance = _frame_one_axis(along[:, 1], along[:, 2], float(half_height))
        eye_back = max(x_distance, y_distance)
        middle_back = float(np.median(along[:, 2]))
        distance = min(max(eye_back - middle_back, _SHORTEST_M), _LONGEST_M)
        return replace(self, target=as_place(np.array([x, y, eye_back - distance]) @ axes), distance=distance)

    def _focal(self, width: float, height: float) -> float:
        return 0.5 * min(width, height) / tan(self.field_of_view / 2)


def _frame_one_axis(across: Float64Array, back: Float64Array, half_slope: float) -> tuple[float, float]:
    """Return the eye's place across and its smallest place back with |across - eye| <= half_slope (eye_back - back)."""
    low = float(np.percentile(across - half_slope * back, _EDGES[0]))
    high = float(np.percentile(across + half_slope * back, _EDGES[1]))
    return (low + high) / 2, (high - low) / (2 * half_slope)


def as_place(point: npt.ArrayLike) -> Place:
    x, y, z = (float(value) for value in np.asarray(point))
    return x, y, z
