"""The membrane on square cells of tactile pixels: its shape by local quadratic fits, its curvature, its balance.

A fit in a Gaussian window gives the second derivatives of the surface averaged over that window, also beside holes.
Nothing is mirrored at the rim: cells without enough membrane in their window have no curvature.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from ...model.arrays import AnyArray, BoolArray, Float32Array, Float64Array, Int32Array, Uint16Array
from ...model.clouds import valid_depth
from ...model.intrinsics import Intrinsics
from ..kernels.quadric import CELL_PX, POWERS, add_triangles, average_cells, bend_quadrics, fit_quadrics

#: Share of a cell's pixels that must have depth.
_MIN_SHARE: Final = 0.5
#: Where the depth falls or rises more steeply, a surface ends; one of less than this share of the largest is not the
#: membrane.
_STEEPEST, _SURFACE_SHARE = 3.0, 0.05
#: Smallest share of a window that must be seen for a curvature, and for a depth.
_WINDOW_SHARE, _DEPTH_SHARE = 0.6, 0.3

#: Cells that are fitted side by side: what they need stays in the processor's cache.
_BLOCK: Final = 512

#: Mean depth of the cells, metres, and the share of their pixels with depth.
Cells = tuple[Float64Array, Float64Array]


class Grid(NamedTuple):
    """The cells about the membrane: rays of their centres, x / z and y / z, (H, W), and side over the focal length."""

    x: Float64Array
    y: Float64Array
    side: tuple[float, float]
    pixels: tuple[slice, slice]  # Rows and columns of the image that the cells cover

    @classmethod
    def of(cls, lens: Intrinsics, counts: Uint16Array) -> Grid:
        """Return the cells that hold the pixels with depth, and a frame of two cells."""
        seen = [np.flatnonzero(valid_depth(counts).any(axis=axis)) // CELL_PX for axis in (1, 0)]
        sizes = (size // CELL_PX for size in counts.shape)
        ranges = [
            (max(int(found[0]) - 2, 0), min(int(found[-1]) + 3, size)) for found, size in zip(seen, sizes, strict=True)
        ]
        v, u = np.mgrid[tuple(slice(*each) for each in ranges)] * CELL_PX + (CELL_PX - 1) / 2
        rays = lens.normalise(np.stack([u, v], axis=-1).reshape(-1, 2)).reshape(*u.shape, 2)
        rows, columns = (slice(CELL_PX * first, CELL_PX * end) for first, end in ranges)
        return cls(rays[..., 0], rays[..., 1], (CELL_PX / lens.fx, CELL_PX / lens.fy), (rows, columns))

    def on_pixels(self, values: AnyArray) -> Float32Array:
        """Return values of the cells on the pixels that the cells cover, interpolated."""
        import cv2

        rows, columns = self.pixels
        size = columns.stop - columns.start, rows.stop - rows.start
        return np.asarray(cv2.resize(values.astype(np.float32, copy=False), size, interpolation=cv2.INTER_LINEAR))

    def numbers(self, shape: tuple[int, int]) -> Int32Array:
        """Return the flat number of each pixel's cell, flat; 0 beyond the cells."""
        found = np.zeros(shape, np.int32)
        cells = np.arange(self.x.size).reshape(self.x.shape)
        found[self.pixels] = cells.repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)
        return found.reshape(-1)

    def part(self, cells: BoolArray) -> tuple[Grid, tuple[slice, slice]]:
        """Return the part that holds the cells that are true and those beside them, and its rows and columns."""
        found = (np.flatnonzero(cells.any(axis=axis)) for axis in (1, 0))
        rows, columns = (slice(max(int(each[0]) - 1, 0), int(each[-1]) + 2) for each in found)
        down, across = (
            slice(side.start + CELL_PX * own.start, min(side.start + CELL_PX * own.stop, side.stop))
            for own, side in zip((rows, columns), self.pixels, strict=True)
        )
        return Grid(self.x[rows, columns], self.y[rows, columns], self.side, (down, across)), (rows, columns)

    def points(self, depth_m: Float64Array) -> Float64Array:
        return np.stack([self.x * depth_m, self.y * depth_m, depth_m], axis=-1)


def halved(grid: Grid) -> Grid:
    """Return cells of twice the side."""
    side = 2 * grid.side[0], 2 * grid.side[1]
    return Grid(_means(grid.x), _means(grid.y), side, grid.pixels)


def halved_cells(depth_m: Float64Array, share: Float64Array) -> Cells:
    """Return what `cells` returns, in cells of twice the side."""
    wide = _means(share)
    return _means(share * depth_m) / np.maximum(wide, 1e-9), wide


def _means(values: Float64Array) -> Float64Array:
    """Return the means of four values each."""
    import cv2

    height, width = values.shape
    even = cv2.copyMakeBorder(values, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(even, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


class Shape(NamedTuple):
    """Coefficients of the fits, (6, H, W) over cells; nan where too little is seen."""

    fit: Float64Array
    growth: Float64Array  # Of the curvature's standard deviation, against a window that is seen whole


def cells(counts: Uint16Array, unit_m: float, offset_m: float, grid: Grid) -> Cells:
    """Return the mean depth of each cell, metres, and its share of pixels with depth.

    Both are 0 where that share is too small, at steps of the depth, and on small surfaces between steps, which are not
    the membrane.
    """
    import cv2

    depth, share = np.empty_like(grid.x), np.empty_like(grid.x)
    rows, columns = grid.pixels
    sums = np.empty((2, columns.stop - columns.start), np.int32)
    average_cells(counts, rows.start, columns.start, 1, sums, depth, share)
    depth = depth * unit_m + offset_m
    seen = share >= _MIN_SHARE
    near, far = (np.where(seen, depth, beyond) for beyond in (np.inf, -np.inf))
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    with np.errstate(invalid="ignore", over="ignore"):
        is_even = seen & (cv2.dilate(far, cross) - cv2.erode(near, cross) < 2 * _STEEPEST * grid.side[0] * depth)
    labels = np.asarray(cv2.connectedComponents(is_even.view(np.uint8), connectivity=4)[1])
    sizes = np.bincount(labels[is_even], minlength=1)
    on_membrane = is_even & (sizes >= _SURFACE_SHARE * sizes.max())[labels]
    return np.where(on_membrane, depth, 0.0), np.where(on_membrane, share, 0.0)


def fit(depth_m: Float64Array, share: Float64Array, sigma: float, curved: bool = True) -> Shape:
    """Fit a quadratic to the depth about each cell, in a Gaussian window of ``sigma`` cells."""
    powers, variance = _window(sigma)
    (height, width), reach = share.shape, powers.shape[1] // 2
    images = np.zeros((2, height + 2 * reach, width + 2 * reach), np.float32)
    inner = np.s_[:, reach : reach + width]
    middle_m = float(depth_m.sum() / max(np.count_nonzero(depth_m), 1))
    images[0, reach:-reach][inner], images[1, reach:-reach][inner] = share, share * (depth_m - middle_m)
    found, growth = np.empty((6, height, width + 2 * reach)), np.empty((height, width + 2 * reach))
    across, moments, work = (
        np.empty(shape, np.float32) for shape in ((8, images[0].size), (8, 5, _BLOCK), (7, 6, _BLOCK))
    )
    least = np.float32(_WINDOW_SHARE if curved else _DEPTH_SHARE)
    fit_quadrics(
        images.reshape(2, -1), powers.astype(np.float32), least, across, moments, work, found.reshape(6, -1),
        growth.reshape(-1),
    )  # fmt: skip
    fit = found[:, *inner] / (sigma ** POWERS.sum(axis=1))[:, None, None]
    fit[0] += middle_m
    return Shape(fit, np.sqrt(np.maximum(growth[inner] / variance, 1.0)))


@lru_cache(maxsize=8)
def _window(sigma: float) -> tuple[Float64Array, float]:
    """Return a Gaussian window times powers of the way from its centre, and the variance of the curvature by it."""
    reach = math.ceil(2.5 * sigma)
    steps = np.arange(-reach, reach + 1.0)
    window = np.exp(-(steps**2) / (2 * sigma**2))
    window /= window.sum()
    powers = window * (steps / sigma) ** np.arange(5)[:, None]
    sums = powers.sum(axis=1)
    whole = np.linalg.inv([[sums[a + c] * sums[b + d] for c, d in POWERS] for a, b in POWERS])
    return powers, float(whole[3, 3] + whole[5, 5])


def curvature(shape: Shape, grid: Grid) -> Float64Array:
    """Return twice the mean curvature, the larger principal one, 1/m, and the noise of the first; nan if unknown.

    Curvatures are positive where the membrane bulges away from the camera. The noise is the standard deviation as a
    multiple of that of a membrane across the ray.
    """
    found = np.empty((3, *grid.x.shape))
    bend_quadrics(shape.fit, grid.x, grid.y, *grid.side, *found)
    found[2] *= shape.growth
    return found


def balance(points: Float64Array, weight: Float64Array, pressure: Float64Array) -> Float64Array:
    """Return what air, tension and contact pressure sum up to on the membrane where ``weight``, (H, W), is 1.

    The contact force F in a region of weight w balances the air and the pull of the membrane around it:
    F = - p int w n dA + T int grad(w) dA, where n points away from the camera. Returned are the first integral, the
    second, and int w q n dA for the contact pressure q, (H, W), over triangles between the points, (H, W, 3), of
    neighbouring cells. The weight must fall to 0 in the free membrane, where the tension T is about constant. Only
    slopes enter the first two, no curvature.
    """
    found = np.zeros((3, 3))
    add_triangles(points, weight, weight * pressure, found)
    return found


def filled(depth_m: Float64Array) -> tuple[Float64Array, BoolArray, BoolArray]:
    """Return the depth with holes closed, the cells of holes, and those away from the rim.

    How a hole is closed does not matter to the balance: the area that a closed line spans does not depend on the
    surface between, in any direction.
    """
    import cv2

    known = np.isfinite(depth_m).view(np.uint8)
    whole = np.zeros_like(known)
    lines = cv2.findContours(known, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    cv2.drawContours(whole, lines, -1, 1, cv2.FILLED)
    holes = (whole > known).view(np.uint8)
    if holes.any():
        closed = cv2.inpaint(np.nan_to_num(depth_m).astype(np.float32), holes, 3, cv2.INPAINT_NS)
        depth_m = np.where(holes > 0, closed, depth_m)
    return depth_m, holes > 0, np.asarray(cv2.erode(whole, np.ones((3, 3), np.uint8), borderValue=0) > 0)
