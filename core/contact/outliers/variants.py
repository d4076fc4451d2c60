"""Faster ways to tell outliers, whose inliers differ from the exact ones. None is used unless asked for.

Each takes what `statistical.statistical_inliers` takes, so that a pipeline can be given one instead. How
many points each decides differently is measured by ``tactune bench``.
"""

from __future__ import annotations

import numpy as np

from ...model.arrays import BoolArray, Float32Array, IndexArray
from ...model.intrinsics import Intrinsics
from .statistical import NeighbourMemory, near_means, statistical_inliers
from .threshold import below_threshold


def windowed_inliers(
    points: Float32Array,
    pixels: IndexArray,
    intrinsics: Intrinsics,
    k: int,
    ratio: float,
    memory: NeighbourMemory | None = None,
) -> BoolArray:
    """Look for the k nearest in a fixed window only, that of the smallest odd square of at least 4 k pixels.

    A mean is too large where one of the k nearest lies outside, which is where noise in depth is several
    pixels' width: outliers are found a little too often there.
    """
    if len(points) == 0:
        return np.zeros(0, bool)
    k = min(k, len(points))
    if k < 2:
        return np.zeros(len(points), bool)
    window = int(np.ceil((np.sqrt(4 * k) - 1) / 2))
    return np.asarray(below_threshold(near_means(points, pixels, intrinsics, k, min(window, 10)), ratio))


def strided_inliers(
    points: Float32Array,
    pixels: IndexArray,
    intrinsics: Intrinsics,
    k: int,
    ratio: float,
    memory: NeighbourMemory | None = None,
) -> BoolArray:
    """Look for the k / 4 nearest among every second row and column only.

    Each of the four interleaved images is searched by itself; all share one threshold. Means of fewer
    neighbours scatter more, which decides about one point in a hundred differently.
    """
    means = np.full(len(points), np.nan)
    v, u = np.divmod(pixels, intrinsics.width)
    for row in (0, 1):
        for column in (0, 1):
            chosen = np.flatnonzero((v % 2 == row) & (u % 2 == column))
            fewer = min(max(2, round(k / 4)), len(chosen))
            if fewer < 2:
                continue
            half = _every_second(intrinsics, row, column)
            places = v[chosen] // 2 * half.width + u[chosen] // 2
            means[chosen] = near_means(points[chosen], places, half, fewer)
    known = np.isfinite(means)
    inliers = np.zeros(len(points), bool)
    if known.any():
        inliers[known] = below_threshold(means[known], ratio)
    return inliers


def voxel_inliers(
    points: Float32Array,
    pixels: IndexArray,
    intrinsics: Intrinsics,
    k: int,
    ratio: float,
    memory: NeighbourMemory | None = None,
) -> BoolArray:
    """Judge one point for each cube, and all others in it as that one.

    The cube is as wide as two pixels at the cloud's mean depth. Outliers that share a cube with a good
    point are kept, and the other way round.
    """
    if len(points) == 0:
        return np.zeros(0, bool)
    side = 2.0 * float(points[:, 2].mean()) / min(intrinsics.fx, intrinsics.fy)
    cells = np.floor(points / np.float32(side)).astype(np.int64)
    cells -= cells.min(axis=0)
    across, down, _ = cells.max(axis=0) + 1
    _, chosen, cube = np.unique(
        (cells[:, 2] * down + cells[:, 1]) * across + cells[:, 0], return_index=True, return_inverse=True
    )
    order = np.argsort(chosen)
    fewer = max(2, round(k * len(chosen) / len(points)))
    judged = np.zeros(len(chosen), bool)
    picked = chosen[order]
    judged[order] = statistical_inliers(points[picked], pixels[picked], intrinsics, fewer, ratio)
    return np.asarray(judged[cube.reshape(-1)])


def _every_second(intrinsics: Intrinsics, row: int, column: int) -> Intrinsics:
    """Return the camera that sees every second row and column of another, from these on."""
    return intrinsics.model_copy(
        update={
            "width": (intrinsics.width - column + 1) // 2, "height": (intrinsics.height - row + 1) // 2,
            "fx": intrinsics.fx / 2, "fy": intrinsics.fy / 2,
            "cx": (intrinsics.cx - column) / 2, "cy": (intrinsics.cy - row) / 2,
        }
    )  # fmt: skip
