"""The membrane's surface in one depth image: dots in space, area per pixel, depth steps, and hidden dots."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from ...model.arrays import AnyArray, BoolArray, Float64Array, Int32Array
from ...model.intrinsics import Intrinsics
from ...preset import CameraNoise
from .kernels import NEAREST, SCRATCH_SHAPE, fit_inverse_depths, fit_to_noise, is_smooth_between
from .lattice import DotLattice

#: Radii of the discs in which inverse depth is fitted, pixels.
_RADII_PX: Final = np.array((2, 3, 5, 8, 12, 18, 27, 40))
#: Side of the square of random noise, which wraps around, pixels; a power of 2.
_FIELD_PX: Final = 1024
#: Steepest surface on which neighbouring dots can still be separated: slope against the image plane.
STEEPEST: Final = 3.0
#: Bilateral filter before slopes are taken: depth difference, metres, and radius, pixels; then the slope's step.
_EDGE_M: Final = 0.003
_SLOPE_SIGMA_PX: Final = 2.0
_SLOPE_STEP_PX: Final = 2
#: Slopes between two dots are taken over this many pixels.
_SLOPE_PX: Final = 3
#: Depth step: neighbouring pixels whose slope against the image plane exceeds this.
_STEP: Final = 2 * STEEPEST
#: Within this distance of a step, slopes are fitted to the pixel's own side, pixels.
_SLOPES_NEAR_PX: Final = 5
#: Those fits: radius, pixels; fewest pixels; largest depth difference within a side, as a share.
_RADIUS_PX: Final = 3
_MIN_PX: Final = 10
_SAME_SIDE: Final = 0.04
#: A spot at a step is a whole dot if its area relative to the grid cells around it is within these multiples of the
#: median. Below, part of the dot is hidden; above, the spot contains more than the dot.
_WHOLE_AREA: Final = (0.75, 1.8)
#: Standard deviation of a centroid, pixels: in general, and within `_EDGE_NEAR_PX` of a depth step.
_CENTROID_SIGMA_PX, _EDGE_SIGMA_PX = 0.07, 0.12
_EDGE_NEAR_PX: Final = 8


@dataclass(frozen=True, eq=False)
class DotFits:
    """Dots in space, and the fits of inverse depth that tell their places.

    Attributes
    ----------
    points_m : float64, shape (N, 3)
        Metres in the tactile camera's frame; nan where there is no depth.
    fits : float64, shape (N, 4)
        See `fit_inverse_depths`.
    """

    points_m: Float64Array
    fits: Float64Array


def dot_points(surface: SeenSurface, pixels: Float64Array, noise: CameraNoise) -> DotFits:
    """Deproject dots to points in the camera's frame.

    Inverse depth, in which the noise of a stereo camera is uniform, is fitted by polynomials in growing discs as long
    as the surface is smooth (Lepski 1991).

    Parameters
    ----------
    surface : SeenSurface
        Depth aligned to the image in which the dots were found.
    pixels : float64, shape (N, 2)
    noise : CameraNoise
        Noise of the depth image.
    """
    fits = np.empty((len(pixels), 4))
    scratch, nearest = np.empty(SCRATCH_SHAPE), np.empty((2, NEAREST))
    sigma = noise.total_m / noise.distance_m**2
    shared_px = 4 * math.pi * (noise.length_px * noise.correlated_m / noise.total_m) ** 2
    fit_inverse_depths(1.0 / surface.depth_m, pixels, sigma, shared_px, _RADII_PX, scratch, nearest, fits)
    return DotFits(_with_z(surface.intrinsics.normalise(pixels)) / fits[:, :1], fits)


def dot_samples(
    surface: SeenSurface, pixels: Float64Array, found: DotFits, noise: CameraNoise, count: int
) -> Float64Array:
    """Return the dots' places with random errors of their depths and centroids added.

    Dots share the errors of pixels that their fits share. A centroid that is off by a pixel moves the dot along the
    surface, farther where the surface is steeper.

    Parameters
    ----------
    surface : SeenSurface
    pixels : float64, shape (N, 2)
    found : DotFits
    noise : CameraNoise
    count : int
        Number of samples, B.

    Returns
    -------
    float64, shape (N, 3, B)
        Metres in the tactile camera's frame.
    """
    rng = np.random.default_rng(0)
    field = rng.standard_normal((_FIELD_PX, _FIELD_PX), dtype=np.float32)
    if noise.length_px:
        white = noise.white_m * rng.standard_normal(field.shape, dtype=np.float32)
        smooth = gaussian_filter(field, noise.length_px, mode="wrap")
        field = np.asarray(noise.correlated_m / smooth.std() * smooth + white, np.float32)
    else:
        field *= np.float32(noise.total_m)
    errors = np.empty((len(pixels), count))
    shifts = rng.integers(_FIELD_PX, size=(count, 2))
    fit_to_noise(1.0 / surface.depth_m, pixels, found.fits, field, shifts, np.empty(SCRATCH_SHAPE), errors)
    height, width = surface.depth_m.shape
    u, v = np.rint(pixels).astype(np.intp).T
    at_edge = surface.near_step(_EDGE_NEAR_PX)[v.clip(0, height - 1), u.clip(0, width - 1)]
    centroid_sigma = np.where(at_edge, _EDGE_SIGMA_PX, _CENTROID_SIGMA_PX)
    rays, depth = _with_z(surface.intrinsics.normalise(pixels)), found.points_m[:, 2]
    across = np.zeros((len(pixels), 3, 2))
    across[:, 0, 0], across[:, 1, 1] = depth / surface.intrinsics.fx, depth / surface.intrinsics.fy
    along = (across + rays[:, :, None] * surface.slopes(pixels)[:, None, :]) * centroid_sigma[:, None, None]
    inverse = found.fits[:, :1] + errors / noise.distance_m**2
    return np.asarray(rays[:, :, None] / inverse[:, None, :] + along @ rng.standard_normal((len(pixels), 2, count)))


def _with_z(rays: Float64Array) -> Float64Array:
    return np.column_stack([rays, np.ones(len(rays))])


def surface_area(depth_m: Float64Array, intrinsics: Intrinsics) -> Float64Array:
    """Return the surface area that each pixel shows, square metres; it grows with the slope.

    Slopes are taken towards the side with the smaller change of depth, so never across an edge.

    Parameters
    ----------
    depth_m : float64, shape (H, W)
        nan where there is no depth.
    intrinsics : Intrinsics

    Returns
    -------
    float64, shape (H, W)
        Pixels without depth count as perpendicular to the line of sight.
    """
    known = np.isfinite(depth_m)
    depth = _smooth_depth(depth_m)
    rows, columns = np.indices(depth.shape)
    rays = intrinsics.normalise(np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64))
    slopes = np.stack([np.where(known, _slope(depth, axis), 0.0) for axis in (1, 0)], axis=2)
    return area_of_slopes(depth, rays.reshape(*depth.shape, 2), slopes, intrinsics, STEEPEST)


def _smooth_depth(depth_m: Float64Array) -> Float64Array:
    """Return depth, metres, smoothed by a bilateral filter; pixels without depth get the median.

    Parameters
    ----------
    depth_m : float64, shape (H, W)
        nan where there is no depth.
    """
    known = np.isfinite(depth_m)
    filled = np.where(known, depth_m, 0.0).astype(np.float32)  # 0 differs so much that the filter ignores it
    smooth = cv2.bilateralFilter(filled, -1, _EDGE_M, _SLOPE_SIGMA_PX).astype(np.float64)
    return np.where(known, smooth, np.nanmedian(depth_m))


def area_of_slopes(
    depth_m: Float64Array, rays: Float64Array, slopes_m: Float64Array, intrinsics: Intrinsics, steepest: float
) -> Float64Array:
    """Return the surface area that pixels show, square metres, shape (...).

    Parameters
    ----------
    depth_m : float64, shape (...)
    rays : float64, shape (..., 2)
        Rays ``(x / z, y / z)`` of the pixels.
    slopes_m : float64, shape (..., 2)
        Change of depth to the next pixel along u and v.
    intrinsics : Intrinsics
    steepest : float
        Slopes against the image plane are limited to this value.
    """
    side = depth_m / intrinsics.fx
    limit = (steepest * side)[..., None]
    right, down = np.moveaxis(np.clip(slopes_m, -limit, limit), -1, 0)
    x, y = np.moveaxis(rays, -1, 0)
    return np.asarray(side * np.sqrt(right**2 + down**2 + (side + x * right + y * down) ** 2))


def _slope(depth: Float64Array, axis: int) -> Float64Array:
    """Return the change of depth per pixel along an axis: the smaller of both one-sided differences."""
    ahead = (np.roll(depth, -_SLOPE_STEP_PX, axis) - depth) / _SLOPE_STEP_PX
    back = np.roll(ahead, _SLOPE_STEP_PX, axis)
    return np.where(np.abs(ahead) < np.abs(back), ahead, back)


def surface_between(depth_m: Float64Array, focal_px: float, start: Float64Array, end: Float64Array) -> bool:
    """Tell whether the surface between two pixels is visible: no depth step, behind which further dots may be hidden.

    Parameters
    ----------
    depth_m : float64, shape (H, W)
        nan where there is no depth.
    focal_px : float
    start, end : float64, shape (2,)
        ``(u, v)``.
    """
    return bool(is_smooth_between(depth_m, focal_px, start, end, STEEPEST, _SLOPE_PX))


@dataclass(frozen=True, eq=False)
class SeenSurface:
    """The surface in one depth image.

    Attributes
    ----------
    depth_m : float64, shape (H, W)
        nan where there is none.
    intrinsics : Intrinsics
    area_m2 : float64, shape (H, W)
        Surface area that each pixel shows, square metres.
    step_right, step_down : bool, shape (H, W - 1) and (H - 1, W)
        Depth steps between horizontal, and between vertical neighbours.
    """

    depth_m: Float64Array
    intrinsics: Intrinsics
    area_m2: Float64Array
    step_right: BoolArray
    step_down: BoolArray

    @classmethod
    def of(cls, depth_m: Float64Array, intrinsics: Intrinsics) -> SeenSurface:
        """Find the depth steps and the surface area of each pixel, from depth in metres (H, W), nan without depth."""
        right, down = (_steps(depth_m, axis, intrinsics.fx) for axis in (1, 0))
        area = surface_area(depth_m, intrinsics)
        rows, columns = np.nonzero(_near(right, down, _SLOPES_NEAR_PX) & np.isfinite(depth_m))
        if len(rows):
            slopes, enough = _slopes_of_own_side(depth_m, rows, columns)
            rows, columns = rows[enough], columns[enough]
            places = np.column_stack([columns, rows]).astype(np.float64)
            area[rows, columns] = area_of_slopes(
                depth_m[rows, columns], intrinsics.normalise(places), slopes[enough], intrinsics, _STEP
            )
        return cls(depth_m, intrinsics, area, right, down)

    def slopes(self, pixels: Float64Array) -> Float64Array:
        """Return the change of depth per pixel along u and v, metres, at pixels (N, 2); 0 where unknown."""
        columns, rows = np.rint(pixels).astype(np.intp).T
        slopes, enough = _slopes_of_own_side(self.depth_m, rows, columns)
        return np.where(enough[:, None], slopes, 0.0)

    def near_step(self, reach_px: int) -> BoolArray:
        """Tell the pixels within a distance of a depth step, bool, shape (H, W)."""
        return _near(self.step_right, self.step_down, reach_px)

    def regions(self, inside: BoolArray) -> tuple[Int32Array, Int32Array]:
        """Label connected regions; pixels on both sides of a depth step are not connected.

        Parameters
        ----------
        inside : bool, shape (H, W)

        Returns
        -------
        labels : int32, shape (H, W)
            0 outside.
        stats : int32, shape (K, 5)
            Left, top, width, height and number of pixels of each region, the outside first.
        """
        links = np.zeros((2 * inside.shape[0] - 1, 2 * inside.shape[1] - 1), np.uint8)  # pixels, and links between them
        links[::2, ::2] = inside
        links[::2, 1::2] = inside[:, 1:] & inside[:, :-1] & ~self.step_right
        links[1::2, ::2] = inside[1:] & inside[:-1] & ~self.step_down
        count, fine, boxes, _ = cv2.connectedComponentsWithStats(links, connectivity=4)
        labels = np.ascontiguousarray(fine[::2, ::2], dtype=np.int32)
        stats = np.asarray(boxes, np.int32)
        stats[:, :2] = stats[:, :2] // 2
        stats[:, 2:4] = (stats[:, 2:4] + 1) // 2
        stats[:, 4] = np.bincount(labels.ravel(), minlength=count)
        return labels, stats

    def part(self, part: tuple[slice, slice]) -> SeenSurface:
        """Return a window of rows and columns. Its pixel coordinates start at 0, so its rays are not valid."""
        rows, columns = part
        depth = self.depth_m[part]
        height, width = depth.shape
        return SeenSurface(
            depth,
            self.intrinsics,
            self.area_m2[part],
            self.step_right[rows, columns][:, : width - 1],
            self.step_down[rows, columns][: height - 1],
        )

    def side_of(self, spot: BoolArray) -> BoolArray:
        """Tell the pixels on the same side as a spot: similar depth and no step between; bool, shape (H, W)."""
        known = self.depth_m[spot & np.isfinite(self.depth_m)]
        middle = float(np.median(known)) if len(known) else np.nan
        labels, _ = self.regions(np.abs(self.depth_m - middle) <= _SAME_SIDE * middle)
        own = np.bincount(labels[spot], minlength=1)
        own[0] = 0
        return np.asarray((labels == own.argmax()) & (labels > 0))


def whole_dots(lattice: DotLattice, points_m: Float64Array, area_m2: Float64Array, at_step: BoolArray) -> BoolArray:
    """Tell the dots that are completely visible, by their area relative to the stretched grid around them.

    Parameters
    ----------
    lattice : DotLattice
    points_m : float64, shape (N, 3)
    area_m2 : float64, shape (N,)
        Area of each spot.
    at_step : bool, shape (N,)
        Spots at a depth step; all others count as whole.

    Returns
    -------
    bool, shape (N,)
    """
    square = np.ones(len(points_m))
    for axis in (0, 1):
        pairs = lattice.neighbours(axis)
        length = np.linalg.norm(points_m[pairs[:, 1]] - points_m[pairs[:, 0]], axis=1)
        known = np.isfinite(length)
        ends, twice = pairs[known].ravel(), np.repeat(length[known], 2)
        count = np.bincount(ends, minlength=len(points_m))
        total = np.bincount(ends, twice, minlength=len(points_m))
        square *= np.where(count > 0, total / np.maximum(count, 1), np.nan)
    share = area_m2 / square
    low, high = np.array(_WHOLE_AREA) * np.nanmedian(share)
    return np.asarray(~at_step | ((share >= low) & (share <= high)))


def _steps(depth_m: Float64Array, axis: int, focal_px: float) -> BoolArray:
    first, second = (np.take(depth_m, range(start, depth_m.shape[axis] - 1 + start), axis) for start in (0, 1))
    return np.abs(second - first) > _STEP * np.minimum(first, second) / focal_px


def _near(step_right: BoolArray, step_down: BoolArray, reach_px: int) -> BoolArray:
    """Tell the pixels within a distance of a pixel beside a step."""
    beside = np.zeros((step_right.shape[0], step_down.shape[1]), np.uint8)
    beside[:, :-1] |= step_right
    beside[:, 1:] |= step_right
    beside[:-1] |= step_down
    beside[1:] |= step_down
    return np.asarray(cv2.dilate(beside, np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)) > 0)


def _slopes_of_own_side(depth_m: Float64Array, rows: AnyArray, columns: AnyArray) -> Any:
    """Return the change of depth per pixel along u and v, (M, 2), from quadratic fits, and which had enough pixels."""
    down, right = np.mgrid[-_RADIUS_PX : _RADIUS_PX + 1, -_RADIUS_PX : _RADIUS_PX + 1]
    round_ = down**2 + right**2 <= (_RADIUS_PX + 0.5) ** 2
    down, right = down[round_], right[round_]
    v, u = rows[:, None] + down, columns[:, None] + right
    height, width = depth_m.shape
    inside = (v >= 0) & (u >= 0) & (v < height) & (u < width)
    middle = depth_m[rows, columns][:, None]
    rise = np.where(inside, depth_m[v.clip(0, height - 1), u.clip(0, width - 1)], np.nan) - middle
    same = np.abs(rise) <= _SAME_SIDE * middle
    weight = same * np.exp(-(down**2 + right**2) / _RADIUS_PX**2)
    design = np.stack([np.ones(len(down)), right, down, right**2, right * down, down**2], axis=1)
    normal = np.einsum("nk,ki,kj->nij", weight, design, design) + 1e-6 * np.eye(6)
    fits = np.linalg.solve(normal, ((weight * np.where(same, rise, 0.0)) @ design)[..., None])[..., 0]
    return fits[:, 1:3], same.sum(axis=1) >= _MIN_PX
