"""Connected groups of pixels and their area."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.arrays import BoolArray, Float32Array, IndexArray
from ...model.clouds import connected_groups, pixel_areas_m2
from ...model.intrinsics import Intrinsics
from ...model.patch import Candidates
from ..kernels.compiling import kernel


def without_small_clusters(candidates: Candidates, camera: Intrinsics, min_area_mm2: float) -> Candidates:
    """Return the candidates without connected groups of a smaller area."""
    return keep(candidates, in_large_cluster(candidates.points[:, 2], candidates.pixels, camera, min_area_mm2))


def in_large_cluster(
    depth_m: Float32Array, pixels: IndexArray, intrinsics: Intrinsics, min_area_mm2: float
) -> BoolArray:
    """Return which pixels (flat, ascending) with these depths belong to an 8-connected group of at least the area."""
    if min_area_mm2 <= 0 or len(depth_m) == 0:
        return np.ones(len(depth_m), bool)
    groups = connected_groups(pixels, intrinsics.width)
    areas_mm2 = 1e6 * np.bincount(groups, pixel_areas_m2(depth_m, intrinsics))
    return np.asarray((areas_mm2 >= min_area_mm2)[groups])


def keep(candidates: Candidates, which: BoolArray) -> Candidates:
    """Return the candidates that ``which`` (bool, shape (N,)) marks."""
    count = int(np.count_nonzero(which))
    if count == len(candidates):
        return candidates
    pixels, points = np.empty(count, np.intp), np.empty((count, 3), np.float32)
    _compact(which, candidates.pixels, candidates.points, pixels, points)
    return Candidates(pixels, points)


@kernel
def _compact(which: Any, pixels: Any, points: Any, pixels_out: Any, points_out: Any) -> None:
    count = 0
    for i in range(len(which)):
        if which[i]:
            pixels_out[count] = pixels[i]
            points_out[count, 0] = points[i, 0]
            points_out[count, 1] = points[i, 1]
            points_out[count, 2] = points[i, 2]
            count += 1
