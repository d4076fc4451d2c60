"""Mean distance to the k nearest points, point by point, sixteen neighbours at once.

For the points that `tiles` leaves: they lie at edges or among few others and need larger windows.
"""

from __future__ import annotations

from typing import Any

import numpy as np

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
from .grid import FAR, FARTHEST, MARGIN, MOST_SINGLE_RADIUS
from .tiles import PLANE_SLACK, SQUARE_SLACK

_ZERO = np.float32(0.0)
_HUGE = np.float32(1e30)
_NONE = np.int32(0)

#: Windows fill one vector a row, then twice as many and so on.
_FIRST_RADIUS = 7
#: Groups of all points, by vectors, when a point is compared with all.
_GROUPS = 16
#: Interpolation steps, after which the bracket is walked through value by value.
_STEPS = 10
#: Steps to a bound for the k-th smallest, each halving the range of exponents.
_BOUND_STEPS = 24
_TINY = np.float32(1e-18)

_squares = float_scratch((2 * MOST_SINGLE_RADIUS + 1) * ((2 * MOST_SINGLE_RADIUS + LANES) // LANES) * LANES)
_minima, _nearest = float_scratch(LANES), float_scratch(_GROUPS * LANES)


@inline
def _side_distance(normal: Any, normal_z: Any, across: Any, z: Any) -> Any:
    """Return the distance between a point and a side plane, less what rounding may add."""
    a = np.float64(normal) * across
    b = np.float64(normal_z) * z
    return -(a + b) - PLANE_SLACK * (abs(a) + abs(b))


@inline
def _count_within(squares: Any, vectors: Any, threshold: Any) -> Any:
    within = ints(_NONE)
    for i in range(vectors):
        within = within - as_ints(load(squares, i * LANES) <= floats(threshold))
    return total(within)


@inline
def _next_above(squares: Any, vectors: Any, threshold: Any, minima: Any) -> Any:
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
    """Return the mean root of the k smallest of ``squares``, of which ``within_limit`` >= k lie within the limit."""
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
def search_single(
    first: Any, last: Any, points: Any, pixels: Any, width: Any, stride: Any, xs: Any, ys: Any, zs: Any,
    columns: Any, rows: Any, k: Any, most_radius: Any, means: Any
) -> None:  # fmt: skip
    """Find the mean distance to the k nearest of the points that have nan; leave it where no window is large enough.

    Parameters
    ----------
    first, last : int
        Numbers of points; ``last`` is exclusive.
    points, pixels
        The whole cloud, (N, 3) and (N,).
    width, stride, xs, ys, zs, columns, rows
        Of the `Grid` that it lies in.
    most_radius : int
        Largest window, at most `MOST_SINGLE_RADIUS`.
    k, means
        As in `tiles.search_tiles`, with the same precision.
    """
    squares, minima = _squares(), _minima()
    columns_end = columns.shape[0] // 4
    rows_end = rows.shape[0] // 4
    for i in range(first, last):
        if means[i] == means[i]:
            continue
        v = pixels[i] // width
        u = pixels[i] - v * width
        x = points[i, 0]
        y = points[i, 1]
        z = points[i, 2]

        radius = _FIRST_RADIUS
        vectors = 0
        limit = _ZERO
        within_high = 0
        while radius <= most_radius:
            left = MARGIN + u - radius - 1
            right = MARGIN + u + radius + 1
            top = MARGIN + v - radius - 1
            bottom = MARGIN + v + radius + 1
            bound = _side_distance(columns[left], columns[columns_end + left], x, z)
            bound = min(bound, _side_distance(columns[2 * columns_end + right], columns[3 * columns_end + right], x, z))
            bound = min(bound, _side_distance(rows[top], rows[rows_end + top], y, z))
            bound = min(bound, _side_distance(rows[2 * rows_end + bottom], rows[3 * rows_end + bottom], y, z))
            bound = max(bound, 0.0)
            limit = np.float32(min(bound, FARTHEST) ** 2) * SQUARE_SLACK

            across = (2 * radius + LANES) // LANES
            vectors = 0
            for row in range(v - radius, v + radius + 1):
                place = (row + MARGIN) * stride + MARGIN + u - radius
                for part in range(across):
                    dx = floats(x) - load(xs, place + part * LANES)
                    dy = floats(y) - load(ys, place + part * LANES)
                    dz = floats(z) - load(zs, place + part * LANES)
                    store(squares, vectors * LANES, multiply_add(dz, dz, multiply_add(dy, dy, dx * dx)))
                    vectors += 1
            within_high = _count_within(squares, vectors, limit)
            if within_high >= k:
                break
            radius += radius + 1
        if within_high < k:
            continue

        means[i] = _mean_of_nearest(squares, vectors, limit, within_high, k, minima)


@inline
def _bound_of_nearest(nearest: Any, k: Any) -> Any:
    """Return a value that at least k of ``nearest`` do not exceed, and rarely many more."""
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


@kernel
def part_coordinates(points: Any, xs: Any, ys: Any, zs: Any) -> None:
    """Write the coordinates of points (N, 3) to planes, filled up with points far away to a whole vector."""
    count = len(points)
    for j in range(count):
        xs[j], ys[j], zs[j] = points[j, 0], points[j, 1], points[j, 2]
    for j in range(count, (count + LANES - 1) // LANES * LANES):
        xs[j], ys[j], zs[j] = _ZERO, _ZERO, FAR


@kernel
def search_all(chosen: Any, count: Any, xs: Any, ys: Any, zs: Any, k: Any, squares: Any, kept: Any, means: Any) -> None:
    """Write the chosen points' mean distance to their k nearest, looking at every point of the cloud.

    Parameters
    ----------
    chosen : int, shape (M,)
        Numbers of points.
    count : int
        Points of the cloud.
    xs, ys, zs : float32
        Their coordinates from `part_coordinates`.
    squares, kept : float32
        Room for every point and two vectors more.
    k, means
        As in `search_single`.
    """
    vectors = (count + LANES - 1) // LANES
    nearest, minima = _nearest(), _minima()
    for i in chosen:
        x, y, z = floats(xs[i]), floats(ys[i]), floats(zs[i])
        # The k smallest of the groups' least distances are distances, too, so the k-th bounds the k-th of all.
        for group in range(_GROUPS):
            store(nearest, group * LANES, floats(_HUGE))
        for j in range(vectors):
            dx = x - load(xs, j * LANES)
            dy = y - load(ys, j * LANES)
            dz = z - load(zs, j * LANES)
            square = multiply_add(dz, dz, multiply_add(dy, dy, dx * dx))
            group = j % _GROUPS * LANES
            store(squares, j * LANES, square)
            store(nearest, group, lesser(load(nearest, group), square))
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
