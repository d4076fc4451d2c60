"""Statistical outlier removal on an organised cloud, with the same inliers as Open3D, point for point.

Neighbours in space are neighbours in the image. A window around a pixel grows until nothing outside can be among the k
nearest: it is farther than the four planes through the camera centre along the outermost rays of the next column or
row, also with lens distortion (`grid.side_planes`). Sixteen neighbouring pixels are searched together (`row_search`),
those at edges one by one (`point_search`), the rest against all points. Counting below a threshold and interpolating
encloses the k-th distance. Each float32 mean is within 4 x 2^-24 of the exact one, which bounds the error of the
threshold. Only if a point lies within that margin, as in about one frame of a hundred with 20,000 points and in nearly
all with 300,000, are the distances summed again in float64; and only if that leaves it open does a k-d tree decide.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Float64Array, IndexArray
from ...model.patch import Candidates
from ..kernels.compiling import kernel
from ..kernels.simd import LANES
from ..kernels.threads import get_threads, in_parallel, scratch
from .clusters import keep
from .grid import FAR, MAX_POINT_RADIUS, NUMBER, Grid
from .point_search import Cloud, search_all, search_points
from .row_search import search_rows

#: Bound of the relative error of a float32 mean: distances differ by at most 3 units in the last place from the exact
#: ones (differences exact to half a unit, squares and sums, root).
UNCERTAINTY = 4 * 2.0**-24
#: The same for means of float64 distances; covers the order of Open3D's sums, too.
PRECISE_UNCERTAINTY = 1e-9
#: Means below this may come from squares that float32 cannot represent, metres.
_MIN_MEAN_M = 1e-12

#: Up to this number of points, all distances are computed exactly.
_FEW_POINTS = 64
#: Up to this number of distances, comparing with all points is faster than a k-d tree; and on one thread.
MAX_PAIRS, MAX_PAIRS_ONE_THREAD = 150_000_000, 1_000_000
#: Windows of single points cover at most this share of the number of points, but are at least this large.
_MAX_WINDOW_SHARE, _MIN_POINT_RADIUS = 0.25, 7
#: Runs, and points compared with all others, that one thread takes at a time.
_RUNS, _COMPARED = 192, 16


def without_outliers(candidates: Candidates, grid: Grid, k: int, ratio: float) -> Candidates:
    return keep(candidates, statistical_inliers(candidates.points, candidates.pixels, grid, k, ratio))


def statistical_inliers(points: Float32Array, pixels: IndexArray, grid: Grid, k: int, ratio: float) -> BoolArray:
    """Return which points are inliers, by Open3D's definition.

    The mean distance of an inlier to its k nearest points, itself included, is positive and below the mean of all
    these distances plus ``ratio`` times their standard deviation (with Bessel's correction). As in Open3D, a single
    point, coinciding points and k = 1 have no inliers. PCL's k is one less.

    ``points``, float32 (N, 3), are metres in the frame of the grid's camera, with z > 0, in the order of their flat
    ``pixels``, (N,).
    """
    if len(points) == 0:
        return np.zeros(0, np.bool_)
    k = min(k, len(points))
    if len(points) > _FEW_POINTS and k > 1:
        for precise, uncertainty in ((False, UNCERTAINTY), (True, PRECISE_UNCERTAINTY)):
            inliers = np.empty(len(points), np.bool_)
            if _compare(near_means(points, pixels, grid, k, precise), ratio, uncertainty, inliers):
                return inliers
    return below_threshold(exact_means(points, k), ratio)


def exact_means(points: Float32Array, k: int, chosen: IndexArray | None = None) -> Float64Array:
    """Return the mean distance of points, or of chosen ones, to their k <= N nearest, with the same bits as Open3D."""
    wide = points.astype(np.float64)
    queries = wide if chosen is None else wide[chosen]
    if len(points) <= _FEW_POINTS:
        dx, dy, dz = (queries[:, None, axis] - wide[None, :, axis] for axis in range(3))
        distances = np.sort(np.sqrt(dx * dx + dy * dy + dz * dz), axis=1)[:, :k]
    else:
        from scipy.spatial import cKDTree  # slow to import, and most clouds do not need it

        distances = np.reshape(cKDTree(wide).query(queries, k, workers=get_threads())[0], (-1, k))
    # Open3D adds the distances one after another, as `numpy.cumsum` does and `numpy.sum` does not
    return np.asarray(np.cumsum(distances, axis=1)[:, -1] / k)


def near_means(points: Float32Array, pixels: IndexArray, grid: Grid, k: int, precise: bool = False) -> Float64Array:
    """Return each point's mean distance to its k nearest, 1 < k <= N, with a relative error of at most `UNCERTAINTY`.

    It is at most `PRECISE_UNCERTAINTY` if ``precise``. The calling thread's next call overwrites the array.
    """
    means = scratch("means", len(points), np.float64)[: len(points)]
    try:
        if not grid.lay(points, pixels):
            return exact_means(points, k)
        radius = MAX_POINT_RADIUS
        while radius > _MIN_POINT_RADIUS and (2 * radius + 1) ** 2 > _MAX_WINDOW_SHARE * len(points):
            radius //= 2
        search = partial(_search, grid, Cloud(points, pixels), k, radius, precise, means)
        in_parallel(search, len(grid.runs), _RUNS)
    finally:
        grid.clear(pixels)
    left = np.flatnonzero(np.isnan(means))
    if precise or len(left) * len(points) > MAX_PAIRS:
        means[left] = exact_means(points, k, left)
    elif len(left):
        compare_with_all(left, points, k, means)
    return means


def compare_with_all(left: IndexArray, points: Float32Array, k: int, means: Float64Array) -> None:
    """Write the mean distance of the points numbered in ``left`` to their k nearest, comparing with every point."""
    planes = tuple(scratch(name, len(points) + LANES, np.float32) for name in ("xs", "ys", "zs"))
    for plane, coordinates in zip(planes, points.T, strict=True):
        plane[: len(points)] = coordinates
        plane[len(points) : len(points) + LANES] = FAR

    def compare(first: int, last: int) -> None:
        squares, kept = (scratch(name, len(points) + 2 * LANES, np.float32) for name in ("squares", "kept"))
        search_all(left[first:last], planes, len(points), k, squares, kept, means)

    alone = len(left) * len(points) <= MAX_PAIRS_ONE_THREAD
    in_parallel(compare, len(left), len(left) if alone else _COMPARED)


def _search(
    grid: Grid, cloud: Cloud, k: int, radius: int, precise: bool, means: Float64Array, first: int, last: int
) -> None:
    """Search the points of the runs ``first`` to ``last - 1`` together, then one by one those that are left open."""
    search_rows(grid.runs[first:last], grid.planes, k, precise, means)
    if not precise:
        end = grid.runs[last, NUMBER] if last < len(grid.runs) else len(cloud.points)
        search_points(cloud, grid.runs[first, NUMBER], end, grid.planes, k, radius, means)


def below_threshold(means: Float64Array, ratio: float) -> BoolArray:
    """Return which exact means are positive and below Open3D's threshold, summed in its order."""
    count, positive = len(means), means > 0
    if count < 2:
        return np.zeros(count, np.bool_)
    mean = np.cumsum(means)[-1] / count
    squares = np.cumsum(np.where(positive, np.square(means - mean), 0.0))[-1]
    return np.asarray(positive & (means < mean + ratio * np.sqrt(squares / (count - 1))))


@partial(kernel, fastmath={"reassoc"})  # any order of a sum will do, so several are added up side by side
def _compare(means: Any, ratio: Any, uncertainty: Any, inliers: Any) -> Any:
    """Write which means are below the threshold of the exact means; return whether that is certain.

    If every mean has a relative error of at most the uncertainty, so has the mean of all. The standard deviation is a
    norm, so it moves by at most the norm of the errors.
    """
    count = len(means)
    total, squares, centred = 0.0, 0.0, 0.0
    for i in range(count):
        total += means[i]
        squares += means[i] * means[i]
    centre = total / count
    for i in range(count):
        centred += (means[i] - centre) * (means[i] - centre)
    threshold = centre + ratio * np.sqrt(centred / (count - 1))
    error = uncertainty * (centre + ratio * np.sqrt(squares / (count - 1))) * (1 + 1e-6)
    certain = True
    for i in range(count):
        inliers[i] = means[i] < threshold
        certain &= means[i] > _MIN_MEAN_M and abs(means[i] - threshold) > error + uncertainty * means[i]
    return certain
