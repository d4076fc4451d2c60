"""Mean distance to the k nearest points, exactly: ring after ring of pixels around each point, in float64.

Neighbours in space are neighbours in the image. A ring is left as soon as nothing outside it can be
nearer than the k-th neighbour found so far.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.arrays import Float32Array, Float64Array, IndexArray
from ...model.intrinsics import Intrinsics
from ..kernels.compiling import kernel
from ..kernels.threads import in_parallel, scratch
from .grid import side_planes

#: A point whose neighbours are not certain after this many rings is looked up in a k-d tree.
_MOST_RINGS = 32
#: Points that one thread takes at a time.
_PART = 1024


def mean_neighbour_distances(
    points: Float32Array,
    pixels: IndexArray,
    intrinsics: Intrinsics,
    k: int,
    chosen: IndexArray | None = None,
) -> Float64Array:
    """Return each point's mean distance to its k nearest points, itself included, in metres.

    Differences, squares and sums are those of Open3D, to the last bit.

    Parameters
    ----------
    points : float32, shape (N, 3)
        Metres, camera frame, z > 0, in row-major pixel order.
    pixels : int, shape (N,)
        Flat pixel of each point.
    intrinsics : Intrinsics
        Of the camera that sees the points in these pixels.
    k : int
        At most N.
    chosen : int, shape (M,), optional
        Numbers of the points wanted; the means are theirs.
    """
    chosen = np.arange(len(points)) if chosen is None else chosen
    numbers = np.full(intrinsics.height * intrinsics.width, -1, np.int32)
    numbers[pixels] = np.arange(len(points), dtype=np.int32)
    numbers = numbers.reshape(intrinsics.shape)
    means = np.empty(len(chosen))
    planes = side_planes(intrinsics)

    def search(part: int) -> None:
        first, last = part * _PART, min((part + 1) * _PART, len(chosen))
        best = scratch("best", k, np.float64)
        _ring_search(chosen, points, pixels, numbers, *planes, k, _MOST_RINGS, first, last, best, means)

    in_parallel(search, -(-len(chosen) // _PART))
    uncertain = np.isnan(means)
    if uncertain.any():
        means[uncertain] = tree_means(points, points[chosen[uncertain]], k)
    return means


def tree_means(points: Float32Array, queries: Float32Array, k: int) -> Float64Array:
    """Return the mean distance of each query to its k nearest of the points, by a k-d tree."""
    from scipy.spatial import cKDTree  # most clouds need none, and it is slow to import

    distances, _ = cKDTree(points).query(queries, k)
    return np.asarray(np.reshape(distances, (-1, k)).mean(axis=1))


@kernel
def _insert(best: Any, found: Any, k: Any, squared: Any) -> Any:
    """Insert into the ascending list of the k best squared distances; return its length."""
    if found < k:
        slot = found
        found += 1
    elif squared < best[k - 1]:
        slot = k - 1
    else:
        return found
    while slot > 0 and best[slot - 1] > squared:
        best[slot] = best[slot - 1]
        slot -= 1
    best[slot] = squared
    return found


@kernel
def _bound_beyond(x: Any, y: Any, z: Any, u: Any, v: Any, ring: Any, columns: Any, rows: Any) -> Any:
    """Return the least distance from a point to anything seen outside the square of a ring."""
    bound = np.inf
    left, right, top, bottom = u - ring - 1, u + ring + 1, v - ring - 1, v + ring + 1
    if left >= 0:
        bound = min(bound, -(columns[0, left, 0] * x + columns[0, left, 1] * z))
    if right < columns.shape[1]:
        bound = min(bound, -(columns[1, right, 0] * x + columns[1, right, 1] * z))
    if top >= 0:
        bound = min(bound, -(rows[0, top, 0] * y + rows[0, top, 1] * z))
    if bottom < rows.shape[1]:
        bound = min(bound, -(rows[1, bottom, 0] * y + rows[1, bottom, 1] * z))
    return max(bound, 0.0)


@kernel
def _ring_search(
    chosen: Any, points: Any, pixels: Any, numbers: Any, columns: Any, rows: Any, k: Any, most_rings: Any,
    first: Any, last: Any, best: Any, means: Any
) -> None:  # fmt: skip
    """Write the mean distances of chosen points ``first`` to ``last - 1``; nan where ``most_rings`` settle nothing."""
    height, width = numbers.shape
    for wanted in range(first, last):
        i = chosen[wanted]
        v, u = pixels[i] // width, pixels[i] % width
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        best[0] = 0.0
        found = 1
        settled = False
        for ring in range(most_rings + 1):
            top, bottom = max(v - ring, 0), min(v + ring, height - 1)
            left, right = max(u - ring, 0), min(u + ring, width - 1)
            for row in range(top, bottom + 1):
                whole_row = row == v - ring or row == v + ring
                step = 1 if whole_row else 2 * ring
                column = left if whole_row or left == u - ring else u + ring
                while column <= right:
                    j = numbers[row, column]
                    if j >= 0 and j != i:
                        dx = x - np.float64(points[j, 0])
                        dy = y - np.float64(points[j, 1])
                        dz = z - np.float64(points[j, 2])
                        found = _insert(best, found, k, dx * dx + dy * dy + dz * dz)
                    column += max(step, 1)
            if found == k:
                bound = _bound_beyond(x, y, z, u, v, ring, columns, rows)
                if bound * bound >= best[k - 1]:
                    settled = True
                    break
        if settled:
            total = 0.0
            for n in range(k):
                total += np.sqrt(best[n])
            means[wanted] = total / k
        else:
            means[wanted] = np.nan
