"""The surface that an image of depth shows, with its edges, and the dots of which these hide a part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np

from ..model.arrays import AnyArray, BoolArray, Float64Array, Int32Array
from ..model.intrinsics import Intrinsics
from .dot_lattice import DotLattice
from .dot_surface import STEEPEST, area_of_slopes, surface_area

#: Neighbouring pixels whose slope against the image plane is beyond this show different parts of the surface.
_STEP: Final = 2 * STEEPEST
#: So near to a step slopes are fitted to the own side of it, pixels.
_SLOPES_NEAR_PX: Final = 5
#: Radius of those fits, pixels, the fewest pixels in them, and the depth over which a side reaches at most, as a share.
_RADIUS_PX: Final = 3
_FEWEST_PX: Final = 10
_SAME_SIDE: Final = 0.04
#: A spot at a step is a whole dot where its area, over that of the square of the grid around it, is within these
#: multiples of what it is elsewhere; below, a part is hidden, and beyond, more than a dot is in it.
_WHOLE_AREA: Final = (0.75, 1.8)
#: Standard deviation of a centroid, pixels: elsewhere, and within so many pixels of a step of depth.
_CENTROID_SIGMA_PX, _EDGE_SIGMA_PX = 0.07, 0.12
_EDGE_NEAR_PX: Final = 8


@dataclass(frozen=True, eq=False)
class SeenSurface:
    """The surface in one image of depth.

    Attributes
    ----------
    depth_m : float64, shape (H, W)
        nan where there is none.
    intrinsics : Intrinsics
    area_m2 : float64, shape (H, W)
        How much of the surface each pixel shows.
    step_right, step_down : bool, shape (H, W - 1) and (H - 1, W)
        Where two pixels beside, or below each other show different parts of it.
    """

    depth_m: Float64Array
    intrinsics: Intrinsics
    area_m2: Float64Array
    step_right: BoolArray
    step_down: BoolArray

    @classmethod
    def of(cls, depth_m: Float64Array, intrinsics: Intrinsics) -> SeenSurface:
        """Find steps, and slopes."""
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
        """Return the changes of depth, metres, to the next pixel along u and v at pixels, (N, 2); 0 where not known."""
        columns, rows = np.rint(pixels).astype(np.intp).T
        slopes, enough = _slopes_of_own_side(self.depth_m, rows, columns)
        return np.where(enough[:, None], slopes, 0.0)

    def near_step(self, reach_px: int) -> BoolArray:
        """Tell the pixels so near to a step, shape (H, W)."""
        return _near(self.step_right, self.step_down, reach_px)

    def regions(self, inside: BoolArray) -> tuple[Int32Array, Int32Array]:
        """Number connected pixels; what is on the other side of a step is not connected.

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
        links = np.zeros((2 * inside.shape[0] - 1, 2 * inside.shape[1] - 1), np.uint8)  # pixels, and between them
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
        """Return a part of it, of rows and columns; its pixels are numbered anew, so it has no rays."""
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
        """Tell the pixels of the surface that a spot is on: about as far, and no step between; shape (H, W)."""
        known = self.depth_m[spot & np.isfinite(self.depth_m)]
        middle = float(np.median(known)) if len(known) else np.nan
        labels, _ = self.regions(np.abs(self.depth_m - middle) <= _SAME_SIDE * middle)
        own = np.bincount(labels[spot], minlength=1)
        own[0] = 0
        return np.asarray((labels == own.argmax()) & (labels > 0))


def whole_dots(lattice: DotLattice, points_m: Float64Array, area_m2: Float64Array, at_step: BoolArray) -> BoolArray:
    """Tell the dots of which nothing is hidden, by their area: the grid around tells how much they are stretched.

    Parameters
    ----------
    lattice : DotLattice
    points_m : float64, shape (N, 3)
    area_m2 : float64, shape (N,)
        That each spot shows.
    at_step : bool, shape (N,)
        Others are whole.

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


def dot_covariance(
    surface: SeenSurface, pixels: Float64Array, points_m: Float64Array, depth_sigma_m: Float64Array
) -> Float64Array:
    """Return the covariance of each dot's place in space, from the errors of its centroid and of its depth.

    A centroid that is off by a pixel moves the dot along the surface, farther where the surface is steeper.

    Parameters
    ----------
    surface : SeenSurface
    pixels : float64, shape (N, 2)
        Centroids in the tactile image, ``(u, v)``.
    points_m : float64, shape (N, 3)
        Dots in the tactile camera's frame; nan where there is no depth.
    depth_sigma_m : float64, shape (N,)
        Standard deviation of each depth.

    Returns
    -------
    float64, shape (N, 3, 3)
        Square metres.
    """
    height, width = surface.depth_m.shape
    u, v = np.rint(pixels).astype(np.intp).T
    at_edge = surface.near_step(_EDGE_NEAR_PX)[v.clip(0, height - 1), u.clip(0, width - 1)]
    centroid_sigma = np.where(at_edge, _EDGE_SIGMA_PX, _CENTROID_SIGMA_PX)
    depth = points_m[:, 2:]
    rays = points_m / depth
    across = np.zeros((len(pixels), 3, 2))
    across[:, 0, 0], across[:, 1, 1] = points_m[:, 2] / surface.intrinsics.fx, points_m[:, 2] / surface.intrinsics.fy
    along = (across + rays[:, :, None] * surface.slopes(pixels)[:, None, :]) * centroid_sigma[:, None, None]
    away = rays * depth_sigma_m[:, None]
    return np.asarray(along @ along.transpose(0, 2, 1) + away[:, :, None] * away[:, None, :])


def _steps(depth_m: Float64Array, axis: int, focal_px: float) -> BoolArray:
    first, second = (np.take(depth_m, range(start, depth_m.shape[axis] - 1 + start), axis) for start in (0, 1))
    return np.abs(second - first) > _STEP * np.minimum(first, second) / focal_px


def _near(step_right: BoolArray, step_down: BoolArray, reach_px: int) -> BoolArray:
    """Tell the pixels that are at most so far from one beside a step."""
    beside = np.zeros((step_right.shape[0], step_down.shape[1]), np.uint8)
    beside[:, :-1] |= step_right
    beside[:, 1:] |= step_right
    beside[:-1] |= step_down
    beside[1:] |= step_down
    return np.asarray(cv2.dilate(beside, np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)) > 0)


def _slopes_of_own_side(depth_m: Float64Array, rows: AnyArray, columns: AnyArray) -> Any:
    """Return changes of depth from pixel to pixel along u and v, (M, 2), by quadratics, and where these had enough."""
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
    return fits[:, 1:3], same.sum(axis=1) >= _FEWEST_PX
