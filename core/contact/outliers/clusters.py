"""Connected groups of pixels and their area."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.arrays import BoolArray, Float32Array, IndexArray
from ...model.intrinsics import Intrinsics
from ...model.patch import Candidates
from ..kernels.compiling import kernel
from ..kernels.threads import scratch


def without_small_clusters(candidates: Candidates, camera: Intrinsics, min_area_mm2: float) -> Candidates:
    """Return the candidates without connected groups of a smaller area."""
    return keep(candidates, in_large_cluster(candidates.points[:, 2], candidates.pixels, camera, min_area_mm2))


def in_large_cluster(
    depth_m: Float32Array, pixels: IndexArray, intrinsics: Intrinsics, min_area_mm2: float
) -> BoolArray:
    """Return which pixels (flat, ascending) with these depths belong to an 8-connected group of at least the area."""
    if min_area_mm2 <= 0 or len(depth_m) == 0:
        return np.ones(len(depth_m), bool)
    count, is_large = len(pixels), np.empty(len(pixels), np.bool_)
    starts, parents = scratch("starts", count + 1, np.int64), scratch("parents", count, np.int64)
    areas, focal_product = scratch("areas", count, np.float64), intrinsics.fx * intrinsics.fy
    _mark_large(pixels, depth_m, intrinsics.width, focal_product, min_area_mm2, starts, parents, areas, is_large)
    return is_large


@kernel
def _root(parents: Any, run: Any) -> Any:
    while parents[run] != run:
        parents[run] = parents[parents[run]]
        run = parents[run]
    return run


@kernel
def _mark_large(
    pixels: Any, depths: Any, width: Any, focal_product: Any, min_area_mm2: Any,
    starts: Any, parents: Any, areas: Any, is_large: Any,
) -> None:  # fmt: skip
    """Join runs of neighbouring pixels to those that they touch in the row above; tell whose groups are large.

    A pixel covers the square of its depth over ``focal_product``, fx fy, as in `pixel_areas_m2`. ``starts``,
    ``parents`` and ``areas`` are buffers; the parent of a run is a run of the same group, that of the group's first run
    is itself. OpenCV's labels of a compact contact take 2 to 3 times as long and push the next frame out of the cache.
    """
    count = len(pixels)
    runs = 0
    for i in range(count):
        if i == 0 or pixels[i] != pixels[i - 1] + 1 or pixels[i] % width == 0:
            starts[runs] = i
            parents[runs] = runs
            areas[runs] = 0.0
            runs += 1
    starts[runs] = count
    above = 0
    for run in range(runs):
        first, last = pixels[starts[run]], pixels[starts[run + 1] - 1]
        row = first // width * width
        left, right = max(first - 1, row) - width, min(last + 1, row + width - 1) - width
        while pixels[starts[above + 1] - 1] < left:
            above += 1
        other = above
        while other < run and pixels[starts[other]] <= right:
            a, b = _root(parents, run), _root(parents, other)
            parents[max(a, b)] = min(a, b)
            other += 1
    for run in range(runs):
        parents[run] = _root(parents, run)
        for i in range(starts[run], starts[run + 1]):
            areas[parents[run]] += np.float64(depths[i]) * np.float64(depths[i]) / focal_product
    for run in range(runs):
        for i in range(starts[run], starts[run + 1]):
            is_large[i] = 1e6 * areas[parents[run]] >= min_area_mm2


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
