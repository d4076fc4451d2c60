"""The membrane on square cells of tactile pixels: its shape by local quadratic fits, its curvature, its balance.

A fit in a Gaussian window gives the second derivatives of the surface averaged over that window, also beside holes.
Nothing is mirrored at the rim: cells without enough membrane in their window have no curvature.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Float64Array, Uint16Array
from ...model.clouds import valid_depth
from ...model.intrinsics import Intrinsics
from ..kernels.quadric import solve_quadrics

#: Side of a cell, pixels, and share of its pixels that must have depth.
CELL_PX: Final = 8
_MIN_SHARE: Final = 0.5
#: Smallest share of a window that must be seen for a curvature, and for a depth.
_WINDOW_SHARE, _DEPTH_SHARE = 0.6, 0.3
_POWERS: Final = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


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


def cells(counts: Uint16Array, unit_m: float, offset_m: float) -> tuple[Float64Array, Float64Array]:
    """Return the mean depth of each cell, metres, and its share of pixels with depth, 0 where that is too small."""
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
    return np.where(share > 0, depth, 0.0), share


def fit(depth_m: Float64Array, share: Float64Array, sigma: float, curved: bool = True) -> Shape:
    """Fit a quadratic to the depth about each cell, in a Gaussian window of ``sigma`` cells."""
    import cv2

    reach = math.ceil(2.5 * sigma)
    steps = np.arange(-reach, reach + 1.0)
    window = np.exp(-(steps**2) / (2 * sigma**2))
    window /= window.sum()
    powers = [window * (steps / sigma) ** power for power in range(5)]

    def average(image: Float64Array, x: int, y: int) -> Float64Array:
        return np.asarray(cv2.sepFilter2D(image, cv2.CV_64F, powers[x], powers[y], borderType=cv2.BORDER_CONSTANT))

    moments = {(x, y): average(share, x, y) for x in range(5) for y in range(5 - x)}
    weighted = share * depth_m
    right = np.stack([average(weighted, x, y) for x, y in _POWERS])
    matrix = np.stack([np.stack([moments[a + c, b + d] for c, d in _POWERS]) for a, b in _POWERS])
    seen = moments[0, 0]
    found, growth = np.empty_like(right), np.empty_like(seen)
    usable = seen > (_WINDOW_SHARE if curved else _DEPTH_SHARE)
    solve_quadrics(matrix, right, usable, np.empty((7, 6)), found, growth)
    scale = np.array([1.0, sigma, sigma, sigma**2, sigma**2, sigma**2])[:, None, None]
    sums = [power.sum() for power in powers]
    whole = np.linalg.inv([[sums[a + c] * sums[b + d] for c, d in _POWERS] for a, b in _POWERS])
    return Shape(found / scale, seen, np.sqrt(np.maximum(growth / (whole[3, 3] + whole[5, 5]), 1.0)))


def curvature(shape: Shape, grid: Grid) -> tuple[Float64Array, Float64Array]:
    """Return twice the mean curvature and the larger principal one, 1/m; nan if unknown.

    They are positive where the membrane bulges away from the camera.
    """
    (du, dv), (z, zu, zv, zuu, zuv, zvv) = grid.side, shape.fit
    zu, zv, zuu, zuv, zvv = zu / du, zv / dv, 2 * zuu / du**2, zuv / (du * dv), 2 * zvv / dv**2
    x, y = grid.x, grid.y

    def vector(a: Float64Array, b: Float64Array, c: Float64Array) -> Float64Array:
        return np.stack([a, b, c])

    p_u, p_v = vector(z + x * zu, y * zu, zu), vector(x * zv, z + y * zv, zv)
    p_uu, p_vv = vector(2 * zu + x * zuu, y * zuu, zuu), vector(x * zvv, 2 * zv + y * zvv, zvv)
    p_uv = vector(zv + x * zuv, zu + y * zuv, zuv)
    e, f, g = (p_u * p_u).sum(0), (p_u * p_v).sum(0), (p_v * p_v).sum(0)
    normal = np.cross(p_u, p_v, axis=0)
    area = np.sqrt((normal**2).sum(0))
    low, mid, high = (normal * p_uu).sum(0) / area, (normal * p_uv).sum(0) / area, (normal * p_vv).sum(0) / area
    square = e * g - f * f
    mean = -(e * high - 2 * f * mid + g * low) / square / 2
    apart = np.sqrt(np.maximum(mean * mean - (low * high - mid * mid) / square, 0.0))
    return np.asarray(2 * mean), np.asarray(mean + apart)


def balance(points: Float64Array, weight: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return what air and tension contribute to the force on the membrane where ``weight``, (H, W), is 1; each (3,).

    The contact force F in a region of weight w balances the air and the pull of the membrane around it:
    F = - p int w n dA + T int grad(w) dA, where n points away from the camera. Returned are the first integral and the
    second, over triangles between the points, (H, W, 3), of neighbouring cells. The weight must fall to 0 in the free
    membrane, where the tension T is about constant. Only slopes enter, no curvature.
    """
    rows, columns = np.flatnonzero((weight > 0).any(axis=1)), np.flatnonzero((weight > 0).any(axis=0))
    if not len(rows):
        return np.zeros(3), np.zeros(3)
    box = slice(max(rows[0] - 1, 0), rows[-1] + 2), slice(max(columns[0] - 1, 0), columns[-1] + 2)
    p, w = points[box], weight[box]
    air, pull = np.zeros(3), np.zeros(3)
    for second, third in (((0, 1), (1, 1)), ((1, 1), (1, 0))):
        corners = [_corner(p, 0, 0), _corner(p, *second), _corner(p, *third)]
        weights = [_corner(w, 0, 0), _corner(w, *second), _corner(w, *third)]
        mean = (weights[0] + weights[1] + weights[2]) / 3
        used = (mean > 0) & np.isfinite(corners[0] + corners[1] + corners[2]).all(axis=-1)
        a, b, c = (corner[used] for corner in corners)
        normal = np.cross(b - a, c - a)
        air += (mean[used, None] * normal).sum(axis=0) / 2
        unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        sides = zip(weights, (c - b, a - c, b - a), strict=True)
        pull += np.cross(unit, sum(each[used, None] * side for each, side in sides)).sum(axis=0) / 2
    return air, pull


def _corner(image: Float64Array, row: int, column: int) -> Float64Array:
    height, width = image.shape[:2]
    return image[row : height - 1 + row, column : width - 1 + column]


def inner(known: BoolArray) -> BoolArray:
    """Return the cells all of whose neighbours are known."""
    import cv2

    return np.asarray(cv2.erode(known.view(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0)
