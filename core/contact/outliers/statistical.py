"""Statistical outlier removal on an organised cloud: Open3D's inliers, point for point."""

from __future__ import annotations

from functools import partial

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Float64Array, IndexArray
from ...model.intrinsics import Intrinsics
from ..kernels.simd import LANES
from ..kernels.threads import in_parallel, scratch
from . import threshold
from .grid import MOST_SINGLE_RADIUS, NUMBER, Grid, GridPool
from .rings import mean_neighbour_distances, tree_means
from .single import part_coordinates, search_all, search_single
from .threshold import below_threshold, surely_below_threshold
from .tiles import search_tiles

#: Up to so many points a k-d tree is faster than laying a grid out.
_TREE_POINTS = 64
#: Up to so many distances are rather computed than looked up in a k-d tree, and fewer on one thread alone.
_MOST_PAIRS, _PAIRS_ALONE = 150_000_000, 1_000_000
#: Windows of single points hold at most this share of the number of points, but for the least.
_WINDOW_SHARE, _LEAST_SINGLE_RADIUS = 0.25, 7
#: Tiles and points compared with all others that one thread takes at a time.
_TILES, _COMPARED = 192, 16

_grids = GridPool()


class NeighbourMemory:
    """The mean distances found last, for the same points and k once more with another ratio.

    Used for one frame after another, it keeps the array that they lie in. For one thread at a time.
    """

    def __init__(self) -> None:
        self._of: tuple[Float32Array, int] | None = None
        self._means = np.empty(0)
        self._room = np.empty(0)

    def room(self, count: int) -> Float64Array:
        """Return an array for so many means; what was remembered is forgotten."""
        self._of = None
        if len(self._room) < count:
            self._room = np.empty(count + count // 2)
        return self._room[:count]

    def recall(self, points: Float32Array, k: int) -> Float64Array | None:
        """Return the means of this very array of points, if remembered."""
        return self._means if self._of is not None and self._of[0] is points and self._of[1] == k else None

    def remember(self, points: Float32Array, k: int, means: Float64Array) -> None:
        """Keep the means."""
        self._of, self._means = (points, k), means


def statistical_inliers(
    points: Float32Array,
    pixels: IndexArray,
    intrinsics: Intrinsics,
    k: int,
    ratio: float,
    memory: NeighbourMemory | None = None,
) -> BoolArray:
    """Return which points are inliers, by Open3D's definition.

    A point's mean distance to its k nearest points, itself included, must be positive and below the
    mean of all these plus ``ratio`` times their standard deviation (Bessel's correction). As in
    Open3D, a lone point, coinciding points and k = 1 have no inliers.

    The means are found in float32 first. Only where a point lies so near to the threshold that
    rounding could decide are they summed in float64, and only where that leaves doubt, too, are they
    found once more in Open3D's own order.

    Parameters
    ----------
    points : float32, shape (N, 3)
        Metres, camera frame, z > 0, in row-major pixel order.
    pixels : int, shape (N,)
        Flat pixel of each point.
    intrinsics : Intrinsics
        Of the camera that sees the points in these pixels.
    k : int
        Neighbours averaged, the point itself counting as one (PCL's k is one less).
    ratio : float
        Standard deviations allowed.
    memory : NeighbourMemory, optional
        Saves the search where only the ratio has changed.

    Returns
    -------
    bool, shape (N,)
    """
    if len(points) == 0:
        return np.zeros(0, bool)
    k = min(k, len(points))
    if len(points) > _TREE_POINTS and k > 1:
        means = memory.recall(points, k) if memory is not None else None
        if means is None:
            means = near_means(points, pixels, intrinsics, k, memory=memory)
            if memory is not None:
                memory.remember(points, k, means)
        inliers = surely_below_threshold(means, ratio, threshold.UNCERTAINTY)
        if inliers is None:
            means = precise_means(points, pixels, intrinsics, k)
            inliers = surely_below_threshold(means, ratio, threshold.PRECISE_UNCERTAINTY)
        if inliers is not None:
            return inliers
    return np.asarray(below_threshold(mean_neighbour_distances(points, pixels, intrinsics, k), ratio))


def near_means(
    points: Float32Array,
    pixels: IndexArray,
    intrinsics: Intrinsics,
    k: int,
    window: int = 0,
    memory: NeighbourMemory | None = None,
) -> Float64Array:
    """Return each point's mean distance to its k nearest, to within `threshold.UNCERTAINTY` of itself.

    Parameters as in `statistical_inliers`, with 1 < k <= N; ``window`` as in `tiles.search_tiles`. With a
    ``memory`` the result lies in its array.
    """
    grid = _grids.borrow(intrinsics)
    try:
        if not grid.lay(points, pixels):
            return tree_means(points, points, k)
        means = memory.room(len(points)) if memory is not None else np.empty(len(points))
        radius = _largest_worthwhile_radius(len(points))
        search = partial(_search_part, grid, points, pixels, k, window, radius, means)
        in_parallel(search, -(-len(grid.tiles) // _TILES))
    finally:
        grid.clear(pixels)
        _grids.give_back(intrinsics, grid)
    left = np.flatnonzero(np.isnan(means))
    if len(left) == 0:
        return means
    if len(left) * len(points) > _MOST_PAIRS:
        means[left] = tree_means(points, points[left], k)
    else:
        compare_with_all(left, points, k, means)
    return means


def compare_with_all(left: IndexArray, points: Float32Array, k: int, means: Float64Array) -> None:
    """Write the mean distance of the points numbered in ``left`` to their k nearest, looking at every point."""
    planes = tuple(scratch(name, len(points) + LANES, np.float32) for name in ("xs", "ys", "zs"))
    part_coordinates(points, *planes)
    compare = partial(_search_all, left, planes, len(points), k, means)
    if len(left) * len(points) <= _PAIRS_ALONE:
        compare(slice(None))
    else:
        parts = -(-len(left) // _COMPARED)
        in_parallel(lambda part: compare(slice(part * _COMPARED, (part + 1) * _COMPARED)), parts)


def precise_means(points: Float32Array, pixels: IndexArray, intrinsics: Intrinsics, k: int) -> Float64Array:
    """Return the means of `near_means` to within `threshold.PRECISE_UNCERTAINTY` of themselves."""
    means = np.full(len(points), np.nan)
    grid = _grids.borrow(intrinsics)
    try:
        if grid.lay(points, pixels):
            in_parallel(partial(_search_tiles, grid, k, 0, True, means), -(-len(grid.tiles) // _TILES))
    finally:
        grid.clear(pixels)
        _grids.give_back(intrinsics, grid)
    left = np.flatnonzero(np.isnan(means))
    if len(left):
        means[left] = mean_neighbour_distances(points, pixels, intrinsics, k, left)
    return means


def _search_tiles(grid: Grid, k: int, window: int, precise: bool, means: Float64Array, part: int) -> None:
    tiles = grid.tiles[part * _TILES : (part + 1) * _TILES]
    search_tiles(tiles, grid.xs, grid.ys, grid.zs, grid.offsets, grid.columns, grid.rows, k, window, precise, means)


def _search_part(
    grid: Grid,
    points: Float32Array,
    pixels: IndexArray,
    k: int,
    window: int,
    radius: int,
    means: Float64Array,
    part: int,
) -> None:
    """Search some tiles' points together, and those that this leaves one by one."""
    tiles = grid.tiles[part * _TILES : (part + 1) * _TILES]
    end = (part + 1) * _TILES
    first = tiles[0, NUMBER]
    last = grid.tiles[end, NUMBER] if end < len(grid.tiles) else len(points)
    planes = grid.xs, grid.ys, grid.zs
    search_tiles(tiles, *planes, grid.offsets, grid.columns, grid.rows, k, window, False, means)
    search_single(
        first, last, points, pixels, grid.width, grid.stride, *planes, grid.columns, grid.rows, k, radius, means
    )


def _largest_worthwhile_radius(count: int) -> int:
    """Return the largest window for single points that is a small part of the work of looking at all points."""
    radius = MOST_SINGLE_RADIUS
    while radius > _LEAST_SINGLE_RADIUS and (2 * radius + 1) ** 2 > _WINDOW_SHARE * count:
        radius //= 2
    return radius


def _search_all(
    left: IndexArray, planes: tuple[Float32Array, ...], count: int, k: int, means: Float64Array, chosen: slice
) -> None:
    squares, kept = (scratch(name, count + 2 * LANES, np.float32) for name in ("squares", "kept"))
    search_all(left[chosen], count, *planes, k, squares, kept, means)
