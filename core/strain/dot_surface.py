"""Where dots lie in space: the depth under each, averaged over as much of the surface as is smooth."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from ..model.arrays import Float64Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import DepthCamera
from ..model.intrinsics import Intrinsics
from .dot_kernels import NEAREST, SCRATCH_SHAPE, fit_inverse_depths, is_smooth_between

#: Radii of the surroundings over which inverse depth is fitted, pixels.
_RADII_PX: Final = np.array((2, 3, 5, 8, 12, 18))
#: Noise is the scatter over surroundings of this radius, of every other row and column.
_NOISE_RADIUS_PX: Final = 12
#: Steepest surface on which neighbouring dots can still be told apart, as a slope against the image plane.
STEEPEST: Final = 3.0
#: Depths farther apart are not averaged before slopes are taken over so many pixels.
_EDGE_M: Final = 0.003
_SLOPE_SIGMA_PX: Final = 2.0
_SLOPE_STEP_PX: Final = 2
#: Over this many pixels the slope between two dots is taken.
_SLOPE_PX: Final = 3


def dot_points(counts: Uint16Array, camera: DepthCamera, pixels: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Deproject dots.

    The inverse of the depth, in which a stereo camera's noise is the same everywhere, is fitted by a
    polynomial over ever wider surroundings, as long as the surface is smooth there (Lepski's rule).

    Parameters
    ----------
    counts : uint16, shape (H, W)
        Raw depth, aligned to the image in which the dots were found.
    camera : DepthCamera
    pixels : float64, shape (N, 2)

    Returns
    -------
    points : float64, shape (N, 3)
        Metres in the camera's frame; nan where there is no depth.
    sigma_m : float64, shape (N,)
        Standard deviation of the depth.
    """
    inverse = np.full(counts.shape, np.nan)
    valid = valid_depth(counts)
    inverse[valid] = 1.0 / (counts[valid] * camera.depth_unit_m)
    fits = np.empty((len(pixels), 2))
    scratch, nearest = np.empty(SCRATCH_SHAPE), np.empty((2, NEAREST))
    fit_inverse_depths(inverse, pixels, _inverse_noise(inverse, pixels), _RADII_PX, scratch, nearest, fits)
    depth = 1.0 / fits[:, 0]
    rays = camera.intrinsics.normalise(pixels)
    return np.column_stack([rays * depth[:, None], depth]), fits[:, 1] * depth**2


def _inverse_noise(inverse: Float64Array, pixels: Float64Array) -> float:
    """Return the standard deviation of one over the depth, 1/m: the scatter about local fits around pixels, (N, 2)."""
    scatter = []
    for u, v in pixels[:: max(len(pixels) // 100, 1)]:
        top, left = max(round(v) - _NOISE_RADIUS_PX, 0), max(round(u) - _NOISE_RADIUS_PX, 0)
        window = inverse[top : round(v) + _NOISE_RADIUS_PX + 1 : 2, left : round(u) + _NOISE_RADIUS_PX + 1 : 2]
        rows, columns = np.nonzero(np.isfinite(window))
        x, y, values = 2 * columns + left - u, 2 * rows + top - v, window[rows, columns]
        within = x**2 + y**2 <= (_NOISE_RADIUS_PX + 0.5) ** 2
        x, y, values = x[within], y[within], values[within]
        if len(values) >= 30:
            design = np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y], axis=1)
            rest = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
            scatter.append(float(np.sqrt(np.mean(rest**2))))
    return float(np.percentile(scatter, 30)) if scatter else math.nan


def surface_area(depth_m: Float64Array, intrinsics: Intrinsics) -> Float64Array:
    """Tell how much of the surface each pixel shows, square metres: the more, the steeper it is seen.

    Slopes are taken to the side on which the depth changes less, so never across an edge.

    Parameters
    ----------
    depth_m : float64, shape (H, W)
        nan where there is no depth.
    intrinsics : Intrinsics

    Returns
    -------
    float64, shape (H, W)
        As if seen straight on where there is no depth.
    """
    known = np.isfinite(depth_m)
    depth = _smooth_depth(depth_m)
    rows, columns = np.indices(depth.shape)
    rays = intrinsics.normalise(np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64))
    slopes = np.stack([np.where(known, _slope(depth, axis), 0.0) for axis in (1, 0)], axis=2)
    return area_of_slopes(depth, rays.reshape(*depth.shape, 2), slopes, intrinsics, STEEPEST)


def _smooth_depth(depth_m: Float64Array) -> Float64Array:
    """Return depth, metres, averaged over some pixels but not over edges; the median where there is none.

    Parameters
    ----------
    depth_m : float64, shape (H, W)
        nan where there is no depth.
    """
    known = np.isfinite(depth_m)
    filled = np.where(known, depth_m, 0.0).astype(np.float32)  # so far away that the filter leaves it out
    smooth = cv2.bilateralFilter(filled, -1, _EDGE_M, _SLOPE_SIGMA_PX).astype(np.float64)
    return np.where(known, smooth, np.nanmedian(depth_m))


def area_of_slopes(
    depth_m: Float64Array, rays: Float64Array, slopes_m: Float64Array, intrinsics: Intrinsics, steepest: float
) -> Float64Array:
    """Return how much of the surface pixels show, square metres, shape (...).

    Parameters
    ----------
    depth_m : float64, shape (...)
    rays : float64, shape (..., 2)
        Their directions, at depth 1.
    slopes_m : float64, shape (..., 2)
        Change of depth to the next pixel along u and v.
    intrinsics : Intrinsics
    steepest : float
        Steeper slopes against the image plane count as this one.
    """
    side = depth_m / intrinsics.fx
    limit = (steepest * side)[..., None]
    right, down = np.moveaxis(np.clip(slopes_m, -limit, limit), -1, 0)
    x, y = np.moveaxis(rays, -1, 0)
    return np.asarray(side * np.sqrt(right**2 + down**2 + (side + x * right + y * down) ** 2))


def _slope(depth: Float64Array, axis: int) -> Float64Array:
    """Return the change of depth from pixel to pixel along an axis, the smaller of both sides'."""
    ahead = (np.roll(depth, -_SLOPE_STEP_PX, axis) - depth) / _SLOPE_STEP_PX
    back = np.roll(ahead, _SLOPE_STEP_PX, axis)
    return np.where(np.abs(ahead) < np.abs(back), ahead, back)


def surface_between(depth_m: Float64Array, focal_px: float, start: Float64Array, end: Float64Array) -> bool:
    """Whether the surface between two pixels is seen: no step of depth, behind which further dots may hide.

    Parameters
    ----------
    depth_m : float64, shape (H, W)
        nan where there is no depth.
    focal_px : float
    start, end : float64, shape (2,)
        ``(u, v)``.
    """
    return bool(is_smooth_between(depth_m, focal_px, start, end, STEEPEST, _SLOPE_PX))
