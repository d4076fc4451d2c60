"""The membrane on square cells of tactile pixels: its shape by local quadratic fits, its curvature, its balance.

A fit in a Gaussian window gives the second derivatives of the surface averaged over that window, also beside holes.
Nothing is mirrored at the rim: cells without enough membrane in their window have no curvature.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Float64Array, Uint16Array
from ...model.clouds import valid_depth
from ...model.intrinsics import Intrinsics
from ..kernels.quadric import bend_quadrics, solve_quadrics

#: Side of a cell, pixels, and share of its pixels that must have depth.
CELL_PX: Final = 8
_MIN_SHARE: Final = 0.5
#: Where the depth falls or rises more steeply, a surface ends; one of less than this share of the largest is not the
#: membrane.
_STEEPEST, _SURFACE_SHARE = 3.0, 0.05
#: Smallest share of a window that must be seen for a curvature, and for a depth.
_WINDOW_SHARE, _DEPTH_SHARE = 0.6, 0.3
_POWERS: Final = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
#: Powers of the moments of a window, and which of them the products of two of these have.
_MOMENTS: Final = tuple((x, y) for x in range(5) for y in range(5 - x))
_PLACES: Final = np.array([[_MOMENTS.index((a + c, b + d)) for c, d in _POWERS] for a, b in _POWERS])


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

    def to_image(self, values: Float64Array | BoolArray, shape: tuple[int, int]) -> Float32Array:
        """Return values of the cells on the pixels of an image, interpolated; nan beyond the cells."""
        import cv2

        rows, columns = self.pixels
        image = np.full(shape, np.nan, np.float32)
        size = columns.stop - columns.start, rows.stop - rows.start
        image[self.pixels] = cv2.resize(values.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        return image

    def points(self, depth_m: Float64Array) -> Float64Array:
        return np.stack([self.x * depth_m, self.y * depth_m, depth_m], axis=-1)


class Shape(NamedTuple):
    """Coefficients of the fits, (6, H, W) over cells, nan where too little is seen; the seen share of each window."""

    fit: Float64Array
    share: Float64Array
    growth: Float64Array  # Of the curvature's standard deviation, against a window that is seen whole


def cells(counts: Uint16Array, unit_m: float, offset_m: float, side: float) -> tuple[Float64Array, Float64Array]:
    """Return the mean depth of each cell, metres, and its share of pixels with depth.

    Both are 0 where that share is too small, at steps of the depth, and on small surfaces between steps, which are not
    the membrane. ``side`` is that of a cell over the focal length.
    """
    import cv2

    height, width = (size // CELL_PX * CELL_PX for size in counts.shape)
    part = np.ascontiguousarray(counts[:height, :width])
    seen = cv2.inRange(part, 1.0, 65534.0)
    valid = cv2.bitwise_and(part, part, mask=seen)
    size = width // CELL_PX, height // CELL_PX
    share = cv2.resize(seen, size, interpolation=cv2.INTER_AREA).astype(np.float64) / 255
    total = cv2.resize(valid.astype(np.float32), size, interpolation=cv2.INTER_AREA).astype(np.float64)
    share[share < _MIN_SHARE] = 0.0
    depth = np.divide(total, share, out=np.zeros_like(total), where=share > 0) * unit_m + offset_m
    near, far = (np.where(share > 0, depth, beyond) for beyond in (np.inf, -np.inf))
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    with np.errstate(invalid="ignore", over="ignore"):
        is_even = cv2.dilate(far, cross) - cv2.erode(near, cross) < 2 * _STEEPEST * side * depth
    labels = np.asarray(cv2.connectedComponents(is_even.view(np.uint8), connectivity=4)[1])
    sizes = np.bincount(labels[is_even], minlength=1)
    on_membrane = is_even & (sizes >= _SURFACE_SHARE * sizes.max())[labels]
    return np.where(on_membrane, depth, 0.0), np.where(on_membrane, share, 0.0)


def fit(depth_m: Float64Array, share: Float64Array, sigma: float, curved: bool = True) -> Shape:
    """Fit a quadratic to the depth about each cell, in a Gaussian window of ``sigma`` cells."""
    import cv2

    powers, variance = _window(sigma)

    def averages(image: Float64Array, of: tuple[tuple[int, int], ...]) -> Float64Array:
        found = np.empty((len(of), *image.shape))
        for plane, (x, y) in zip(found, of, strict=True):
            cv2.sepFilter2D(image, cv2.CV_64F, powers[x], powers[y], dst=plane, borderType=cv2.BORDER_CONSTANT)
        return found

    moments, right = averages(share, _MOMENTS), averages(share * depth_m, _POWERS)
    seen = moments[0]
    found, growth = np.empty_like(right), np.empty_like(seen)
    usable = seen > (_WINDOW_SHARE if curved else _DEPTH_SHARE)
    solve_quadrics(moments, _PLACES, right, usable, np.empty((7, 6, usable.shape[1])), found, growth)
    scale = np.array([1.0, sigma, sigma, sigma**2, sigma**2, sigma**2])[:, None, None]
    return Shape(found / scale, seen, np.sqrt(np.maximum(growth / variance, 1.0)))


@lru_cache(maxsize=8)
def _window(sigma: float) -> tuple[list[Float64Array], float]:
    """Return a Gaussian window times powers of the way from its centre, and the variance of the curvature by it."""
    reach = math.ceil(2.5 * sigma)
    steps = np.arange(-reach, reach + 1.0)
    window = np.exp(-(steps**2) / (2 * sigma**2))
    window /= window.sum()
    powers = [window * (steps / sigma) ** power for power in range(5)]
    sums = [power.sum() for power in powers]
    whole = np.linalg.inv([[sums[a + c] * sums[b + d] for c, d in _POWERS] for a, b in _POWERS])
    return powers, float(whole[3, 3] + whole[5, 5])


def curvature(shape: Shape, grid: Grid) -> tuple[Float64Array, Float64Array]:
    """Return twice the mean curvature and the larger principal one, 1/m; nan if unknown.

    They are positive where the membrane bulges away from the camera.
    """
    twice_mean, largest = np.empty_like(shape.share), np.empty_like(shape.share)
    bend_quadrics(shape.fit, grid.x, grid.y, *grid.side, twice_mean, largest)
    return twice_mean, largest


class Balance(NamedTuple):
    """Integrals over the membrane around a contact; each is (3,)."""

    air: Float64Array
    pull: Float64Array
    pressed: Float64Array


def balance(points: Float64Array, weight: Float64Array, pressure: Float64Array) -> Balance:
    """Return what air, tension and contact pressure sum up to on the membrane where ``weight``, (H, W), is 1.

    The contact force F in a region of weight w balances the air and the pull of the membrane around it:
    F = - p int w n dA + T int grad(w) dA, where n points away from the camera. Returned are the first integral, the
    second, and int w q n dA for the contact pressure q, (H, W), over triangles between the points, (H, W, 3), of
    neighbouring cells. The weight must fall to 0 in the free membrane, where the tension T is about constant. Only
    slopes enter the first two, no curvature.
    """
    rows, columns = np.flatnonzero((weight > 0).any(axis=1)), np.flatnonzero((weight > 0).any(axis=0))
    found = Balance(np.zeros(3), np.zeros(3), np.zeros(3))
    if not len(rows):
        return found
    box = slice(max(rows[0] - 1, 0), rows[-1] + 2), slice(max(columns[0] - 1, 0), columns[-1] + 2)
    p, w = points[box], weight[box]
    load = w * pressure[box]
    for second, third in (((0, 1), (1, 1)), ((1, 1), (1, 0))):
        corners = [_corner(p, 0, 0), _corner(p, *second), _corner(p, *third)]
        weights, loads = ([_corner(each, *place) for place in ((0, 0), second, third)] for each in (w, load))
        mean = sum(weights[1:], weights[0]) / 3
        used = (mean > 0) & np.isfinite(corners[0] + corners[1] + corners[2]).all(axis=-1)
        a, b, c = (corner[used] for corner in corners)
        normal = _cross(b - a, c - a)
        found.air[:] += mean[used] @ normal / 2
        found.pressed[:] += sum(loads[1:], loads[0])[used] @ normal / 6
        unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        sides = zip(weights, (c - b, a - c, b - a), strict=True)
        pulled = np.sum([each[used, None] * side for each, side in sides], axis=0)
        found.pull[:] += _cross(unit, pulled).sum(axis=0) / 2
    return found


def _cross(a: Float64Array, b: Float64Array) -> Float64Array:
    """Return the cross product of vectors, (N, 3); `numpy.cross` takes longer for some thousand of them."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _corner(image: Float64Array, row: int, column: int) -> Float64Array:
    height, width = image.shape[:2]
    return image[row : height - 1 + row, column : width - 1 + column]


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
