"""What the proximity camera adds to where dots are: it sees the membrane too where this lies on the object."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from ..model.arrays import Float64Array
from ..model.clouds import valid_depth
from ..model.frames import Rig, SensorFrame
from ..model.intrinsics import Intrinsics

#: Both cameras see the same surface where their depths are nearer than this, metres.
_SAME_M: Final = 0.002
#: Fewer such places, or fewer around a dot, say nothing.
_FEWEST_PLACES, _FEWEST_AROUND = 100, 8
#: The proximity camera's depth at a dot is that of a plane through its places within so many tactile pixels.
_PLANE_PX: Final = 2.5
_OUTLIER_SIGMAS: Final = 3.0
#: How far apart both cameras see the surface is averaged over discs of these radii, pixels, while it stays the same.
_RADII_PX: Final = (3, 5, 8, 12, 18)
_AGREES_WITHIN: Final = 1.5
_LEAST_COVERED: Final = 0.35
#: So many pixels of a stereo camera count as one measurement.
_PIXELS_A_SAMPLE: Final = 70.0


@dataclass(frozen=True, eq=False)
class TouchedPlaces:
    """Places at which the proximity camera sees the membrane, in the tactile camera.

    Attributes
    ----------
    tree : cKDTree
        Of their pixels, ``(u, v)``.
    inverse : float64, shape (N,)
        One over their depths, 1/m, as the proximity camera sees them.
    ahead : float64, shape (N,)
        By how much one over the tactile depth is more.
    tactile_noise : float
        Standard deviation of one over the tactile depth of a pixel, 1/m.
    """

    tree: cKDTree
    inverse: Float64Array
    ahead: Float64Array
    tactile_noise: float

    @classmethod
    def of(cls, frame: SensorFrame, rig: Rig, depth_m: Float64Array, tactile_noise: float) -> TouchedPlaces | None:
        """Find them; None where there are too few, or the cameras' pose or the noise is not known.

        Parameters
        ----------
        frame : SensorFrame
        rig : Rig
        depth_m : float64, shape (H, W)
            Tactile depth, nan where there is none.
        tactile_noise : float
        """
        if rig.T_proximity_tactile is None or not np.isfinite(tactile_noise):
            return None
        pixels, depth = _in_tactile_camera(frame, rig)
        height, width = depth_m.shape
        inside = ((pixels > -0.5) & (pixels < (width - 0.5, height - 0.5))).all(axis=1)
        pixels, depth = pixels[inside], depth[inside]
        near = np.rint(pixels).astype(np.intp)
        tactile = depth_m[near[:, 1], near[:, 0]]
        same = np.abs(depth - tactile) < _SAME_M
        if np.count_nonzero(same) < _FEWEST_PLACES:
            return None
        inverse = 1.0 / depth[same]
        return cls(cKDTree(pixels[same]), inverse, 1.0 / tactile[same] - inverse, tactile_noise)

    def sharpen(
        self, pixels: Float64Array, points_m: Float64Array, sigma_m: Float64Array, intrinsics: Intrinsics
    ) -> tuple[Float64Array, Float64Array]:
        """Weigh depths of dots, and those that the proximity camera gives, by their noise.

        The proximity camera tells the shape around a dot. How far it lies from the tactile camera's depths, which
        a pose that is slightly off or either camera's own error may make it, is averaged over the surroundings.

        Parameters
        ----------
        pixels : float64, shape (N, 2)
        points_m : float64, shape (N, 3)
        sigma_m : float64, shape (N,)
        intrinsics : Intrinsics
            The tactile camera's.

        Returns
        -------
        points_m, sigma_m
            The same where the proximity camera says nothing.
        """
        planes = [self._plane(pixel) for pixel in pixels]
        scatters = [plane[2] for plane in planes if plane is not None]
        points, sigma = points_m.copy(), sigma_m.copy()
        if not scatters:
            return points, sigma
        noise, rays = float(np.median(scatters)), intrinsics.normalise(pixels)
        for number, plane in enumerate(planes):
            if plane is None or not np.isfinite(points_m[number]).all():
                continue
            apart = self._apart(pixels[number], noise)
            if apart is None:
                continue
            depth = 1.0 / (plane[0] + apart[0])
            error = math.hypot(apart[1], noise * math.sqrt(plane[1])) * depth**2
            weights = 1.0 / error**2, 1.0 / sigma_m[number] ** 2
            mean = (weights[0] * depth + weights[1] * points_m[number, 2]) / sum(weights)
            points[number] = rays[number, 0] * mean, rays[number, 1] * mean, mean
            sigma[number] = sum(weights) ** -0.5
        return points, sigma

    def _plane(self, pixel: Float64Array) -> tuple[float, float, float] | None:
        """Return one over the depth at a pixel, its variance over that of a place, and the places' scatter."""
        places = np.array(self.tree.query_ball_point(pixel, _PLANE_PX), np.intp)
        while len(places) >= _FEWEST_AROUND:
            design = np.column_stack([np.ones(len(places)), self.tree.data[places] - pixel])
            fit = np.linalg.lstsq(design, self.inverse[places], rcond=None)[0]
            rest = np.abs(self.inverse[places] - design @ fit)
            kept = rest <= _OUTLIER_SIGMAS * 1.4826 * np.median(rest) + 1e-9
            if kept.all():
                scatter = math.sqrt(float(rest @ rest) / (len(places) - 3))
                return float(fit[0]), float(np.linalg.inv(design.T @ design)[0, 0]), scatter
            places = places[kept]
        return None

    def _apart(self, pixel: Float64Array, noise: float) -> tuple[float, float] | None:
        """Return how far apart both cameras are around a pixel, 1/m, and its standard deviation (Lepski's rule)."""
        best, low, high = None, -math.inf, math.inf
        for radius in _RADII_PX:
            places = self.tree.query_ball_point(pixel, radius)
            cells = len(np.unique(np.rint(self.tree.data[places]), axis=0)) if places else 0
            if len(places) < _FEWEST_AROUND or cells < _LEAST_COVERED * math.pi * radius**2:
                break
            value = float(np.median(self.ahead[places]))
            tactile = self.tactile_noise * min(math.sqrt(_PIXELS_A_SAMPLE / cells), 1.0)
            error = math.hypot(tactile, noise / math.sqrt(len(places)))
            low, high = max(low, value - _AGREES_WITHIN * error), min(high, value + _AGREES_WITHIN * error)
            if low > high:
                break
            best = value, error
        return best


def _in_tactile_camera(frame: SensorFrame, rig: Rig) -> tuple[Float64Array, Float64Array]:
    """Return the tactile pixels, (N, 2), and depths there, metres, of all that the proximity camera sees."""
    rows, columns = np.nonzero(valid_depth(frame.proximity_depth))
    depth = frame.proximity_depth[rows, columns] * rig.proximity.depth_unit_m
    rays = rig.proximity.intrinsics.normalise(np.column_stack([columns, rows]).astype(np.float64))
    tactile_from_proximity = np.linalg.inv(np.asarray(rig.T_proximity_tactile))
    points = np.column_stack([rays * depth[:, None], depth]) @ tactile_from_proximity[:3, :3].T
    points += tactile_from_proximity[:3, 3]
    points = points[points[:, 2] > 0]
    return rig.tactile.intrinsics.project(points), points[:, 2]
