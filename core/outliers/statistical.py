"""Statistical outlier removal on an organised cloud: Open3D's inliers, point for point."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt

from ..intrinsics import Intrinsics
from ..threads import in_parallel
from . import threshold
from .grid import Grid, GridPool
from .rings import mean_neighbour_distances, tree_means
from .single import search_all, search_single
from .threshold import below_threshold, surely_below_threshold
from .tiles import search_tiles

Bools = npt.NDArray[np.bool_]
Points = npt.NDArray[np.float32]
Pixels = npt.NDArray[np.intp]
Distances = npt.NDArray[np.float64]

#: Up to so many points a k-d tree is faster than laying a grid out.
_TREE_POINTS = 64
#: Tiles with fewer points each are not searched together.
_POINTS_A_TILE = 2.5
#: So many points are rather compared with all others than looked up in a k-d tree.
_FEW_LEFT = 120
#: Tiles, single points and points compared with all others that one thread takes at a time.
_TILES, _SINGLES, _COMPARED = 192, 256, 16

_grids = GridPool()


class NeighbourMemory:
    """The mean distances found last, for the same points and k once more with another ratio."""

    def __init__(self) -> None:
        self._of: tuple[Points, int] | None = None
        self._means = np.empty(0)

    def recall(self, points: Points, k: int) -> Distances | None:
        """Return the means of this very array of points, if remembered."""
        return self._means if self._of is not None and self._of[0] is points and self._of[1] == k else None

    def remember(self, points: Points, k: int, means: Distances) -> None:
        """Keep the means."""
        self._of, self._means = (points, k), means


def statistical_inliers(
    points: Points, pixels: Pixels, intrinsics: Intrinsics, k: int, ratio: float, memory: NeighbourMemory | None = None
) -> Bools:
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
            means = near_means(points, pixels, intrinsics, k)
            if memory is not None:
                memory.remember(points, k, means)
        inliers = surely_below_threshold(means, ratio, threshold.UNCERTAINTY)
        if inliers is None:
            means = precise_means(points, pixels, intrinsics, k)
            inliers = surely_below_threshold(means, ratio, threshold.PRECISE_UNCERTAINTY)
        if inliers is not None:
            return inliers
    return np.asarray(below_threshold(mean_neighbour_distances(points, pixels, intrinsics, k), ratio))


def near_means(points: Points, pixels: Pixels, intrinsics: Intrinsics, k: int, window: int = 0) -> Distances:
    """Return each point's mean distance to its k nearest, to within `threshold.UNCERTAINTY` of itself.

    Parameters as in `statistical_inliers`, with 1 < k <= N; ``window`` as in `tiles.search_tiles`.
    """
    grid = _grids.borrow(intrinsics)
    try:
        if not grid.lay(points, pixels):
            return tree_means(points, points, k)
        means = np.empty(len(points))
        dense = len(points) >= _POINTS_A_TILE * len(grid.tiles)
        if dense:
            in_parallel(partial(_search_tiles, grid, k, window, False, means), -(-len(grid.tiles) // _TILES))
        left = np.flatnonzero(np.isnan(means)) if dense else np.arange(len(points))
        in_parallel(partial(_search_single, grid, left, points, pixels, k, means), -(-len(left) // _SINGLES))
    finally:
        grid.clear(pixels)
        _grids.give_back(intrinsics, grid)
    left = left[np.isnan(means[left])]
    if len(left) <= _FEW_LEFT:
        in_parallel(partial(_search_all, left, points, k, means), -(-len(left) // _COMPARED))
    else:
        means[left] = tree_means(points, points[left], k)
    return means


def precise_means(points: Points, pixels: Pixels, intrinsics: Intrinsics, k: int) -> Distances:
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


def _search_tiles(grid: Grid, k: int, window: int, precise: bool, means: Distances, part: int) -> None:
    tiles = grid.tiles[part * _TILES : (part + 1) * _TILES]
    search_tiles(tiles, grid.xs, grid.ys, grid.zs, grid.offsets, grid.columns, grid.rows, k, window, precise, means)


def _search_single(
    grid: Grid, left: Pixels, points: Points, pixels: Pixels, k: int, means: Distances, part: int
) -> None:
    chosen = left[part * _SINGLES : (part + 1) * _SINGLES]
    search_single(
        chosen, points, pixels, grid.width, grid.stride, grid.xs, grid.ys, grid.zs, grid.columns, grid.rows, k, means
    )


def _search_all(left: Pixels, points: Points, k: int, means: Distances, part: int) -> None:
    search_all(left[part * _COMPARED : (part + 1) * _COMPARED], points, k, means)
