"""Statistical outlier removal on an organised cloud, and removal of small clusters.

The inlier set is Open3D's ``remove_statistical_outlier``, computed from the image grid: neighbours
in space are neighbours in the image. A ring of pixels around a point is left as soon as nothing
outside it can be nearer than the k-th neighbour found so far.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit, prange
from scipy.spatial import cKDTree

from .clouds import ray_table
from .intrinsics import Intrinsics

Bools = npt.NDArray[np.bool_]
Points = npt.NDArray[np.float32]

#: A point whose neighbours are not certain after this many rings is looked up in a k-d tree.
_MOST_RINGS = 32


def statistical_inliers(
    points: Points, pixels: npt.NDArray[np.intp], intrinsics: Intrinsics, k: int, ratio: float
) -> Bools:
    """Return which points are inliers, by Open3D's definition.

    A point's mean distance to its k nearest points, itself included, must be positive and below the
    mean of all these plus ``ratio`` times their standard deviation (Bessel's correction). As in
    Open3D, a lone point, coinciding points and k = 1 have no inliers.

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

    Returns
    -------
    bool, shape (N,)
    """
    if len(points) == 0:
        return np.zeros(0, bool)
    means = mean_neighbour_distances(points, pixels, intrinsics, min(k, len(points)))
    return np.asarray(_below_threshold(means, ratio))


def mean_neighbour_distances(
    points: Points, pixels: npt.NDArray[np.intp], intrinsics: Intrinsics, k: int
) -> npt.NDArray[np.float64]:
    """Return each point's mean distance to its k nearest points, itself included, in metres.

    Parameters as in `statistical_inliers`; k is at most N.
    """
    numbers = np.full(intrinsics.height * intrinsics.width, -1, np.int32)
    numbers[pixels] = np.arange(len(points), dtype=np.int32)
    means = np.empty(len(points))
    planes = _side_planes(intrinsics)
    _ring_search(points, pixels, numbers.reshape(intrinsics.shape), *planes, k, _MOST_RINGS, means)
    uncertain = np.isnan(means)
    if uncertain.any():
        distances, _ = cKDTree(points).query(points[uncertain], k)
        means[uncertain] = np.reshape(distances, (-1, k)).mean(axis=1)
    return means


@lru_cache(maxsize=8)
def _side_planes(intrinsics: Intrinsics) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return unit normals of planes through the camera that bound all pixels beyond a column or row.

    Entry ``[side, i]`` is (n, n_z) with ``n . point >= 0`` for every point seen at column (or row) i
    or farther out; sides are left, right for columns and top, bottom for rows. Lens distortion bends
    columns, so the outermost ray of all of them is taken, which keeps the bound on the safe side.
    """

    def planes(slopes: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        farther_left = np.maximum.accumulate(slopes.max(axis=0))
        farther_right = np.minimum.accumulate(slopes.min(axis=0)[::-1])[::-1]
        left = np.stack([-np.ones_like(farther_left), farther_left], axis=1)
        right = np.stack([np.ones_like(farther_right), -farther_right], axis=1)
        both = np.stack([left, right])
        return np.asarray(both / np.linalg.norm(both, axis=2, keepdims=True))

    wide = ray_table(intrinsics).astype(np.float64)
    return planes(wide[:, :, 0]), planes(wide[:, :, 1].T)


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True, parallel=True)
def _ring_search(
    points: Any, pixels: Any, numbers: Any, columns: Any, rows: Any, k: Any, most_rings: Any, means: Any
) -> None:
    """Write each point's mean distance to its k nearest; nan where ``most_rings`` did not settle it."""
    height, width = numbers.shape
    chunks = (len(points) + 255) // 256
    for chunk in prange(chunks):
        best = np.empty(k, np.float64)
        for i in range(chunk * 256, min((chunk + 1) * 256, len(points))):
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
                means[i] = total / k
            else:
                means[i] = np.nan


@njit(cache=True, nogil=True)
def _below_threshold(means: Any, ratio: Any) -> Any:
    """Apply Open3D's threshold, summing in its order."""
    count = len(means)
    total = 0.0
    for value in means:
        total += value
    mean = total / count
    squares = 0.0
    for value in means:
        if value > 0:
            squares += (value - mean) * (value - mean)
    threshold = mean + ratio * np.sqrt(squares / (count - 1)) if count > 1 else np.nan
    inliers = np.empty(count, np.bool_)
    for i in range(count):
        inliers[i] = means[i] > 0 and means[i] < threshold
    return inliers


def pixel_areas_m2(depth_m: npt.NDArray[np.float32], intrinsics: Intrinsics) -> npt.NDArray[np.float64]:
    """Return the area that one pixel covers at each depth, projected across the optical axis, m^2."""
    return np.square(depth_m.astype(np.float64)) / (intrinsics.fx * intrinsics.fy)


def in_large_cluster(
    points: Points, pixels: npt.NDArray[np.intp], intrinsics: Intrinsics, min_area_mm2: float
) -> Bools:
    """Tell which points belong to an 8-connected group of pixels of at least the given area."""
    if min_area_mm2 <= 0 or len(points) == 0:
        return np.ones(len(points), bool)
    mask = np.zeros(intrinsics.height * intrinsics.width, np.uint8)
    mask[pixels] = 1
    _, labels = cv2.connectedComponents(mask.reshape(intrinsics.shape), connectivity=8)
    cluster = labels.ravel()[pixels]
    areas_mm2 = np.bincount(cluster, weights=pixel_areas_m2(points[:, 2], intrinsics)) * 1e6
    return np.asarray(areas_mm2[cluster] >= min_area_mm2)
