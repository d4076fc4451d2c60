"""Mean distance to the k nearest points, one point at a time, sixteen neighbours at once.

For the points that `row_search` leaves open: they lie at edges or among few others and need larger windows.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...model.arrays import Float32Array, IndexArray
from ..kernels.compiling import inline, kernel
from ..kernels.simd import (
    LANES,
    as_ints,
    bits,
    count_trailing_zeros,
    doubles,
    float_scratch,
    floats,
    ints,
    lesser,
    load,
    multiply_add,
    sqrt,
    store,
    to_doubles,
    total,
    where,
)
from .grid import FARTHEST, MARGIN, MAX_POINT_RADIUS
from .row_search import PLANE_SLACK, SQUARE_SLACK

_ZERO = np.float32(0.0)
_HUGE = np.float32(1e30)
_NONE = np.int32(0)

#: The first window has one vector a row; each further window has twice as many.
_FIRST_RADIUS = 7
#: Number of groups that the points are split into when a point is compared with all.
_GROUPS = 16
#: Interpolation steps. After these the values between the bounds are visited one by one.
_STEPS = 10
#: Bisection steps for an upper bound of the k-th smallest; each halves the range of exponents.
_BOUND_STEPS = 24
_TINY = np.float32(1e-18)

_squares = float_scratch((2 * MAX_POINT_RADIUS + 1) * ((2 * MAX_POINT_RADIUS + LANES) // LANES) * LANES)
_minima, _nearest = float_scratch(LANES), float_scratch(_GROUPS * LANES)


class Cloud(NamedTuple):
    """A cloud: points (float32, shape (N, 3), metres) and their flat pixels (int, shape (N,)), ascending."""

    points: Float32Array
    pixels: IndexArray


@inline
def _side_distance(normal: Any, normal_z: Any, across: Any, z: Any) -> Any:
    """Return the distance between a point and a side plane, minus the rounding error."""
    a = np.float64(normal) * across
    b = np.float64(normal_z) * z
    return -(a + b) - PLANE_SLACK * (abs(a) + abs(b))


@inline
def _bound_beyond(x: Any, y: Any, z: Any, u: Any, v: Any, radius: Any, grid: Any) -> Any:
    """Return a lower bound of the squared distance from a point to all points outside its window."""
    columns, rows = grid.columns, grid.rows
    width, height = columns.shape[0] // 4, rows.shape[0] // 4
    left, right = MARGIN + u - radius - 1, MARGIN + u + radius + 1
    top, bottom = MARGIN + v - radius - 1, MARGIN + v + radius + 1
    bound = _side_distance(columns[left], columns[width + left], x, z)
    bound = min(bound, _side_distance(columns[2 * width + right], columns[3 * width + right], x, z))
    bound = min(bound, _side_distance(rows[top], rows[height + top], y, z))
    bound = min(bound, _side_distance(rows[2 * height + bottom], rows[3 * height + bottom], y, z))
    return np.float32(min(max(bound, 0.0), FARTHEST) ** 2) * SQUARE_SLACK


@inline
def _squares_in_window(squares: Any, x: Any, y: Any, z: Any, u: Any, v: Any, radius: Any, grid: Any) -> Any:
    """Write the squared distances to the points of a window; return the number of vectors written."""
    across = (2 * radius + LANES) // LANES
    vectors = 0
    for row in range(v - radius, v + radius + 1):
        place = (row + MARGIN) * grid.stride + MARGIN + u - radius
        for part in range(across):
            dx = floats(x) - load(grid.xs, place + part * LANES)
            dy = floats(y) - load(grid.ys, place + part * LANES)
            dz = floats(z) - load(grid.zs, place + part * LANES)
            store(squares, vectors * LANES, multiply_add(dz, dz, multiply_add(dy, dy, dx * dx)))
            vectors += 1
    return vectors


@inline
def _count_within(squares: Any, vectors: Any, threshold: Any) -> Any:
    """Return the number of squared distances up to a threshold."""
    within = ints(_NONE)
    for i in range(vectors):
        within = within - as_ints(load(squares, i * LANES) <= floats(threshold))
    return total(within)


@inline
def _next_above(squares: Any, vectors: Any, threshold: Any, minima: Any) -> Any:
    """Return the smallest squared distance above a threshold."""
    least = floats(_HUGE)
    for i in range(vectors):
        square = load(squares, i * LANES)
        least = lesser(least, where(square <= floats(threshold), floats(_HUGE), square))
    store(minima, 0, least)
    smallest = minima[0]
    for lane in range(1, LANES):
        smallest = min(smallest, minima[lane])
    return smallest


@inline
def _mean_of_nearest(squares: Any, vectors: Any, limit: Any, within_limit: Any, k: Any, minima: Any) -> Any:
    """Return the mean root of the k smallest of ``squares``; ``within_limit`` >= k of them lie within ``limit``."""
    within_high = within_limit
    low = np.float32(-1.0)
    high = limit
    within_low = 0
    threshold = high
    within = within_high
    for _ in range(_STEPS):
        if within == k or within == k - 1:
            break
        if within < k:
            low = threshold
            within_low = within
        else:
            high = threshold
            within_high = within
        start = max(low, _ZERO)
        share = (np.float32(k) - np.float32(within_low)) / np.float32(within_high - within_low)
        threshold = start + (high - start) * share
        within = _count_within(squares, vectors, threshold)
    if within > k:
        threshold = low
        within = within_low
    beyond = threshold
    while within < k:
        beyond = _next_above(squares, vectors, threshold, minima)
        reached = _count_within(squares, vectors, beyond)
        if reached > k:
            break
        threshold = beyond
        within = reached

    summed = doubles(0.0)
    for j in range(vectors):
        square = load(squares, j * LANES)
        summed = summed + to_doubles(where(square <= floats(threshold), sqrt(square), floats(_ZERO)))
    missing = k - within
    return (total(summed) + missing * np.sqrt(np.float64(beyond))) / k


@kernel
def search_points(cloud: Any, first: Any, last: Any, grid: Any, k: Any, max_radius: Any, means: Any) -> None:
    """Write the mean distance to the k nearest points where it is nan; leave nan where no window is large enough.

    ``first`` to ``last - 1`` are numbers of points of a `Cloud` that lies in the `GridPlanes`; ``max_radius`` is the
    largest window, at most `MAX_POINT_RADIUS`; ``k`` and ``means`` as in `row_search.search_rows`, as precise.
    """
    squares, minima = _squares(), _minima()
    for i in range(first, last):
        if means[i] == means[i]:
            continue
        v = cloud.pixels[i] // grid.width
        u = cloud.pixels[i] - v * grid.width
        x, y, z = cloud.points[i, 0], cloud.points[i, 1], cloud.points[i, 2]
        radius = _FIRST_RADIUS
        while radius <= max_radius:
            limit = _bound_beyond(x, y, z, u, v, radius, grid)
            vectors = _squares_in_window(squares, x, y, z, u, v, radius, grid)
            within = _count_within(squares, vectors, limit)
            if within >= k:
                means[i] = _mean_of_nearest(squares, vectors, limit, within, k, minima)
                break
            radius += radius + 1


@inline
def _bound_of_nearest(nearest: Any, k: Any) -> Any:
    """Return an upper bound of the k-th smallest of ``nearest`` that few others lie below."""
    high = _ZERO
    low = _HUGE
    for i in range(_GROUPS * LANES):
        high = max(high, nearest[i])
        low = min(low, nearest[i])
    low = max(low, _TINY)
    within = _GROUPS * LANES
    for _ in range(_BOUND_STEPS):
        if within <= k + k // 2:
            break
        middle = np.float32(np.sqrt(low * high))
        found = _count_within(nearest, _GROUPS, middle)
        if found >= k:
            high = middle
            within = found
        else:
            low = middle
    return high


@inline
def _squares_to_all(i: Any, planes: Any, vectors: Any, squares: Any, nearest: Any) -> None:
    """Write the squared distances from a point to all, and the least ones of each group."""
    xs, ys, zs = planes
    x, y, z = floats(xs[i]), floats(ys[i]), floats(zs[i])
    for group in range(_GROUPS):
        store(nearest, group * LANES, floats(_HUGE))
    for j in range(vectors):
        dx, dy, dz = x - load(xs, j * LANES), y - load(ys, j * LANES), z - load(zs, j * LANES)
        square = multiply_add(dz, dz, multiply_add(dy, dy, dx * dx))
        group = j % _GROUPS * LANES
        store(squares, j * LANES, square)
        store(nearest, group, lesser(load(nearest, group), square))


@kernel
def search_all(chosen: Any, planes: Any, count: Any, k: Any, squares: Any, kept: Any, means: Any) -> None:
    """Write the mean distance of chosen points to their k nearest, comparing each with every point of the cloud.

    ``chosen`` (M,) are numbers of points, ``planes`` x, y and z of ``count`` points, float32, metres, padded with
    points far away to a whole vector; ``squares`` and ``kept`` are buffers of float32 with an element for every point
    and two vectors more; ``k`` and ``means`` as in `search_points`.
    """
    vectors = (count + LANES - 1) // LANES
    nearest, minima = _nearest(), _minima()
    for i in chosen:
        _squares_to_all(i, planes, vectors, squares, nearest)
        # The k smallest of the groups' least distances are distances, so the k-th of them bounds the k-th of all.
        bound = _bound_of_nearest(nearest, k) if k <= _GROUPS * LANES else _HUGE
        found = 0
        for j in range(vectors):
            near = bits(load(squares, j * LANES) <= floats(bound))
            while near != 0:
                kept[found] = squares[j * LANES + count_trailing_zeros(near)]
                found += 1
                near &= near - 1
        found = min(found, count)
        farthest = _ZERO
        for j in range(found):
            farthest = max(farthest, kept[j])
        store(kept, found, floats(_HUGE))
        means[i] = _mean_of_nearest(kept, (found + LANES - 1) // LANES, farthest, found, k, minima)
