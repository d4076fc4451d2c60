"""The cloud in planes of its image grid, with a margin, for kernels that search windows of pixels."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np

from ...model.arrays import Float32Array, Float64Array, IndexArray, Int64Array
from ...model.clouds import ray_table
from ...model.intrinsics import Intrinsics
from ..kernels.compiling import kernel
from ..kernels.simd import LANES

#: Largest windows of `row_search` and `point_search`, pixels from the centre to the side.
MAX_ROW_RADIUS: Final = 10
MAX_POINT_RADIUS: Final = 63

#: Pixels around the image that never hold a point.
MARGIN: Final = 80

#: The planes hold this depth where there is no point, metres.
FAR: Final = np.float32(1e9)
#: A cloud with larger coordinates is not searched in the grid; larger distances are not distinguished, metres.
FARTHEST: Final = np.float32(1e7)

#: Columns of the list of runs: row and column of lane 0, one bit for each lane that has a point, number of the first
#: such point, and the place of lane 0 in the planes.
ROW, COLUMN, MASK, NUMBER, PLACE = range(5)


class GridPlanes(NamedTuple):
    """What the searches read of a `Grid`."""

    width: int  # Pixels in a row of the image
    stride: int  # Elements in a row of the planes
    xs: Float32Array  # flat: Coordinates of the point in each pixel, metres, with `MARGIN` pixels around the image
    ys: Float32Array
    zs: Float32Array
    offsets: Int64Array  # Offsets in the planes from a pixel to all pixels of a square around it, ring by ring
    columns: Float32Array  # flat: Side planes from `padded_planes`
    rows: Float32Array


class Grid:
    """Buffers for the image of one camera, which hold one cloud at a time, for one thread at a time.

    ``runs`` (n, 5) are all runs of `LANES` pixels of a row, starting at a multiple of `LANES`, that have points.
    """

    def __init__(self, intrinsics: Intrinsics) -> None:
        height, width = intrinsics.shape
        stride = -(-width // LANES) * LANES + 2 * MARGIN
        size = (height + 2 * MARGIN) * stride
        self.planes = GridPlanes(
            width,
            stride,
            np.zeros(size, np.float32),
            np.zeros(size, np.float32),
            np.full(size, FAR),
            ring_offsets(MAX_ROW_RADIUS, stride),
            *(padded_planes(planes) for planes in side_planes(intrinsics)),
        )
        self._runs = np.empty((height * -(-width // LANES), 5), np.int64)
        self.runs = self._runs[:0]

    def lay(self, points: Float32Array, pixels: IndexArray) -> bool:
        """Fill in a cloud, points (N, 3) of ascending flat pixels; return whether all coordinates are in range."""
        count, farthest = _lay(points, pixels, self.planes, self._runs)
        self.runs = self._runs[:count]
        return bool(farthest < FARTHEST)

    def clear(self, pixels: IndexArray) -> None:
        """Remove the cloud."""
        _clear(pixels, self.planes)
        self.runs = self._runs[:0]


@lru_cache(maxsize=8)
def side_planes(intrinsics: Intrinsics) -> tuple[Float64Array, Float64Array]:
    """Return unit normals of planes through the camera that bound all pixels beyond a column or row.

    Entry ``[side, i]`` is (n, n_z) with ``n . point >= 0`` for every point seen at column (or row) i or farther out.
    The sides are left and right for columns, top and bottom for rows. Lens distortion bends columns, so the outermost
    ray of each column is used: the bound stays valid.
    """

    def planes(slopes: Float64Array) -> Float64Array:
        farther_left = np.maximum.accumulate(slopes.max(axis=0))
        farther_right = np.minimum.accumulate(slopes.min(axis=0)[::-1])[::-1]
        left = np.stack([-np.ones_like(farther_left), farther_left], axis=1)
        right = np.stack([np.ones_like(farther_right), -farther_right], axis=1)
        both = np.stack([left, right])
        return np.asarray(both / np.linalg.norm(both, axis=2, keepdims=True))

    wide = ray_table(intrinsics).astype(np.float64)
    return planes(wide[:, :, 0]), planes(wide[:, :, 1].T)


def padded_planes(planes: Float64Array) -> Float32Array:
    """Return n and n_z of both sides as one flat array, padded with planes that bound nothing."""
    count = planes.shape[1]
    padded = np.zeros((4, count + 2 * MARGIN + LANES), np.float32)
    padded[1::2] = -FAR
    padded[0:2, MARGIN : MARGIN + count] = planes[0].T
    padded[2:4, MARGIN : MARGIN + count] = planes[1].T
    return padded.ravel()


def ring_offsets(radius: int, stride: int) -> Int64Array:
    """Return the offsets from a pixel to all pixels of the square around it, ring by ring."""
    v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    order = np.argsort(np.maximum(abs(v), abs(u)).ravel(), kind="stable")
    return np.ascontiguousarray((v * stride + u).ravel()[order], dtype=np.int64)


@kernel
def _lay(points: Any, pixels: Any, planes: Any, runs: Any) -> Any:
    """Write points to the planes and list the runs that have some; return their number and the largest coordinate."""
    width, stride = planes.width, planes.stride
    count = 0
    farthest = np.float32(0.0)
    row = -1
    next_row = 0
    next_run = 0
    for i in range(len(pixels)):
        pixel = pixels[i]
        if pixel >= next_row:
            row = pixel // width
            next_row = (row + 1) * width
            next_run = row * width
        column = pixel - row * width
        if pixel >= next_run:
            start = column // LANES * LANES
            next_run = row * width + start + LANES
            runs[count, ROW] = row
            runs[count, COLUMN] = start
            runs[count, MASK] = 0
            runs[count, NUMBER] = i
            runs[count, PLACE] = (row + MARGIN) * stride + MARGIN + start
            count += 1
        lane = column - runs[count - 1, COLUMN]
        place = runs[count - 1, PLACE] + lane
        runs[count - 1, MASK] |= 1 << lane
        x = points[i, 0]
        y = points[i, 1]
        z = points[i, 2]
        farthest = max(farthest, abs(x), abs(y), abs(z))
        planes.xs[place] = x
        planes.ys[place] = y
        planes.zs[place] = z
    return count, farthest


@kernel
def _clear(pixels: Any, planes: Any) -> None:
    for i in range(len(pixels)):
        row = pixels[i] // planes.width
        place = (row + MARGIN) * planes.stride + MARGIN + pixels[i] - row * planes.width
        planes.xs[place] = 0.0
        planes.ys[place] = 0.0
        planes.zs[place] = FAR
