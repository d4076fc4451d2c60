"""The cloud laid out on its image grid, with a margin, for kernels that look at windows of pixels."""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import Any, Final

import numpy as np

from ...model.arrays import Float32Array, Float64Array, IndexArray, Int64Array
from ...model.clouds import ray_table
from ...model.intrinsics import Intrinsics
from ..kernels.compiling import kernel
from ..kernels.simd import LANES

#: Largest windows of the two searches, pixels from the centre to the side.
MOST_TILE_RADIUS: Final = 10
MOST_SINGLE_RADIUS: Final = 63

#: Pixels around the image that never hold a point.
MARGIN: Final = 80

#: Where there is no point, a plane holds one this far away, metres.
FAR: Final = np.float32(1e9)
#: A cloud with larger coordinates is not laid out; distances beyond are not told apart, metres.
FARTHEST: Final = np.float32(1e7)

#: What the columns of a list of tiles hold: row and column of lane 0, one bit for each lane that has a
#: point, number of the first such point, and the place of lane 0 in the planes.
ROW, COLUMN, MASK, NUMBER, PLACE = range(5)


class Grid:
    """Buffers for one image size; one cloud at a time lies in them.

    Attributes
    ----------
    xs, ys, zs : float32, flat
        Coordinates of the point in each pixel, rows of ``stride`` elements, ``MARGIN`` pixels around.
    tiles : int64, shape (n, 5)
        Every run of `LANES` pixels, starting at a multiple, that has points.
    """

    def __init__(self, intrinsics: Intrinsics) -> None:
        height, width = intrinsics.shape
        self.width = width
        self.stride = -(-width // LANES) * LANES + 2 * MARGIN
        size = (height + 2 * MARGIN) * self.stride
        self.xs, self.ys = np.zeros(size, np.float32), np.zeros(size, np.float32)
        self.zs = np.full(size, FAR)
        self._tiles = np.empty((height * -(-width // LANES), 5), np.int64)
        self.tiles = self._tiles[:0]
        self.columns, self.rows = (padded_planes(planes) for planes in side_planes(intrinsics))
        self.offsets = ring_offsets(MOST_TILE_RADIUS, self.stride)

    def lay(self, points: Float32Array, pixels: IndexArray) -> bool:
        """Put a cloud down: points (N, 3) of ascending flat pixels; return whether it is near enough for that."""
        count, farthest = _lay(points, pixels, self.width, self.stride, self.xs, self.ys, self.zs, self._tiles)
        self.tiles = self._tiles[:count]
        return bool(farthest < FARTHEST)

    def clear(self, pixels: IndexArray) -> None:
        """Take the cloud away again."""
        _clear(pixels, self.width, self.stride, self.xs, self.ys, self.zs)
        self.tiles = self._tiles[:0]


class GridPool:
    """Grids that lie ready; each is lent to one search at a time."""

    def __init__(self) -> None:
        self._free: list[tuple[Intrinsics, Grid]] = []
        self._lock = threading.Lock()

    def borrow(self, intrinsics: Intrinsics) -> Grid:
        """Return a grid without points."""
        with self._lock:
            for i, (camera, grid) in enumerate(self._free):
                if camera == intrinsics:
                    del self._free[i]
                    return grid
        return Grid(intrinsics)

    def give_back(self, intrinsics: Intrinsics, grid: Grid) -> None:
        """Keep a cleared grid for the next search, in the place of the one unused longest."""
        with self._lock:
            self._free = [*self._free[-3:], (intrinsics, grid)]


@lru_cache(maxsize=8)
def side_planes(intrinsics: Intrinsics) -> tuple[Float64Array, Float64Array]:
    """Return unit normals of planes through the camera that bound all pixels beyond a column or row.

    Entry ``[side, i]`` is (n, n_z) with ``n . point >= 0`` for every point seen at column (or row) i
    or farther out; sides are left, right for columns and top, bottom for rows. Lens distortion bends
    columns, so the outermost ray of all of them is taken, which keeps the bound on the safe side.
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
    """Return n and n_z of both sides as one flat array; beyond the image lie planes that bound nothing."""
    count = planes.shape[1]
    padded = np.zeros((4, count + 2 * MARGIN + LANES), np.float32)
    padded[1::2] = -FAR
    padded[0:2, MARGIN : MARGIN + count] = planes[0].T
    padded[2:4, MARGIN : MARGIN + count] = planes[1].T
    return padded.ravel()


def ring_offsets(radius: int, stride: int) -> Int64Array:
    """Return the way from a pixel to all in a square around it, ring after ring."""
    v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    order = np.argsort(np.maximum(abs(v), abs(u)).ravel(), kind="stable")
    return np.ascontiguousarray((v * stride + u).ravel()[order], dtype=np.int64)


@kernel
def _lay(points: Any, pixels: Any, width: Any, stride: Any, xs: Any, ys: Any, zs: Any, tiles: Any) -> Any:
    count = 0
    farthest = np.float32(0.0)
    row = -1
    next_row = 0
    next_tile = 0
    for i in range(len(pixels)):
        pixel = pixels[i]
        if pixel >= next_row:
            row = pixel // width
            next_row = (row + 1) * width
            next_tile = row * width
        column = pixel - row * width
        if pixel >= next_tile:
            start = column // LANES * LANES
            next_tile = row * width + start + LANES
            tiles[count, ROW] = row
            tiles[count, COLUMN] = start
            tiles[count, MASK] = 0
            tiles[count, NUMBER] = i
            tiles[count, PLACE] = (row + MARGIN) * stride + MARGIN + start
            count += 1
        lane = column - tiles[count - 1, COLUMN]
        place = tiles[count - 1, PLACE] + lane
        tiles[count - 1, MASK] |= 1 << lane
        x = points[i, 0]
        y = points[i, 1]
        z = points[i, 2]
        farthest = max(farthest, abs(x), abs(y), abs(z))
        xs[place] = x
        ys[place] = y
        zs[place] = z
    return count, farthest


@kernel
def _clear(pixels: Any, width: Any, stride: Any, xs: Any, ys: Any, zs: Any) -> None:
    for i in range(len(pixels)):
        row = pixels[i] // width
        place = (row + MARGIN) * stride + MARGIN + pixels[i] - row * width
        xs[place] = 0.0
        ys[place] = 0.0
        zs[place] = FAR
