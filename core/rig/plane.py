"""A plane through measured points, and how far they lie from it, as librealsense's Depth Quality Tool has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..model.arrays import Float64Array

#: The tool leaves out this share of the points at either end of the depths before it takes a mean square.
CLIPPED_SHARE = 1 / 200
_LEAST_POINTS = 3


@dataclass(frozen=True)
class Plane:
    """The plane ``normal . p = distance_m``, in the camera's frame, metres.

    Attributes
    ----------
    normal : (float, float, float)
        Of length 1, away from the camera (z > 0).
    distance_m : float
        Of the camera's origin from the plane, which the tool calls distance to target.
    """

    normal: tuple[float, float, float]
    distance_m: float

    @property
    def angle_deg(self) -> float:
        """Angle between the plane's normal and the optical axis, degrees."""
        return float(np.degrees(np.arccos(min(1.0, abs(self.normal[2])))))

    def along_axis_m(self) -> float:
        """Return the depth at which the optical axis meets the plane, metres."""
        return self.distance_m / self.normal[2]

    def signed_distances(self, points: npt.ArrayLike) -> Float64Array:
        """Return how far points (N, 3) lie behind the plane, metres; negative: nearer to the camera."""
        return np.asarray(np.asarray(points, np.float64) @ np.asarray(self.normal) - self.distance_m)


def fit_plane(points: npt.ArrayLike) -> Plane | None:
    """Fit a plane by least squares along the axis that the points spread over least.

    With the centred second moments of the points, the axis is the one whose 2 x 2 minor of the other two is
    largest; the residuals along it are made least. For a wall in front of a camera that is ordinary least
    squares ``z = a x + b y + c`` (librealsense, tools/depth-quality/depth-metrics.h, ``plane_from_points``). All
    points count; clipping comes afterwards.

    Parameters
    ----------
    points : array_like, shape (N, 3)
        Metres in the camera's frame.

    Returns
    -------
    Plane or None
        None where fewer than three points, or points on one line, or a plane seen edge on, determine none.
    """
    array = np.asarray(points, dtype=np.float64)
    if len(array) < _LEAST_POINTS:
        return None
    centroid = array.mean(axis=0)
    centred = array - centroid
    moments = centred.T @ centred
    others = [[1, 2], [0, 2], [0, 1]]
    minors = [float(np.linalg.det(moments[np.ix_(pair, pair)])) for pair in others]
    axis = int(np.argmax(minors))
    if minors[axis] <= 1e-12 * float(np.trace(moments)) ** 2:
        return None
    slopes = np.linalg.solve(moments[np.ix_(others[axis], others[axis])], moments[others[axis], axis])
    normal = np.zeros(3)
    normal[axis], normal[others[axis]] = 1.0, -slopes
    normal /= np.linalg.norm(normal)
    if abs(normal[2]) < 1e-6:
        return None
    normal *= np.sign(normal[2])
    x, y, z = (float(part) for part in normal)
    return Plane((x, y, z), float(normal @ centroid))


def clip_depths(points: Float64Array) -> Float64Array:
    """Return the points without the nearest and the farthest 0.5 %, ordered by depth.

    That is the tool's only guard against outliers (rs-depth-quality.cpp: "Remove outliers [below 0.5% and
    above 99.5%)").
    """
    ordered = points[np.argsort(points[:, 2], kind="stable")]
    cut = int(len(ordered) * CLIPPED_SHARE)
    return ordered[cut : len(ordered) - cut]


def root_mean_square(values: npt.ArrayLike) -> float:
    """Return ``sqrt(mean(values^2))``."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, np.float64)))))


def subpixel_errors(points: Float64Array, plane: Plane, focal_px: float, baseline_m: float) -> Float64Array:
    """Return the disparity of each point minus that of its foot on the plane, pixels.

    ``D_i - D'_i = f b / z_i - f b / z'_i``, where ``z'_i`` is the depth of the point's orthogonal projection on
    the plane: the definition in the tool's own description of its metric. (Its code divides by the points'
    distances from the camera instead of their depths, which makes the result smaller towards the image's rim.)

    Parameters
    ----------
    points : float64, shape (N, 3)
    plane : Plane
    focal_px : float
        Horizontal focal length of the depth image, pixels.
    baseline_m : float
        Between both imagers of the stereo pair, metres.
    """
    foot_z = points[:, 2] - plane.signed_distances(points) * plane.normal[2]
    return np.asarray(focal_px * baseline_m * (1.0 / points[:, 2] - 1.0 / foot_z))
