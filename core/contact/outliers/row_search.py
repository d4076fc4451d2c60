"""Mean distance to the k nearest points, for sixteen neighbouring pixels of a row at once.

A window of pixels around the run grows until no point outside it can be among the k nearest. The k-th squared distance
of each lane is then enclosed by counting the points below a threshold and interpolating, until the count is k - 1, k or
k + 1. The sum of the k smallest distances follows. Lanes for which this fails are left to `point_search`.

Distances are float32: each is within 3 units in the last place of the exact one. So is their mean, because the mean of
the k smallest of a set moves no more than the members of the set do.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..kernels.compiling import inline, kernel
from ..kernels.simd import (
    LANES,
    absolute,
    as_ints,
    bits,
    count_ones,
    count_trailing_zeros,
    double_scratch,
    doubles,
    flags,
    float_scratch,
    floats,
    greater,
    ints,
    lesser,
    load,
    multiply_add,
    sqrt,
    store,
    to_doubles,
    to_floats,
    total,
    where,
)
from .grid import COLUMN, FARTHEST, MARGIN, MASK, MAX_ROW_RADIUS, NUMBER, PLACE, ROW

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_HUGE = np.float32(1e30)
_NONE, _SINGLE = np.int32(0), np.int32(1)

#: Larger than the rounding error of the distance to a side plane, as a share of the terms of that distance.
PLANE_SLACK = np.float32(4e-7)
#: Squared distances up to a squared bound times this factor are below the bound without rounding, too.
SQUARE_SLACK = np.float32(1.0 - 1e-6)
#: Squared distances that differ by this factor are in the same order without rounding, too.
_APART = np.float32(1.0 + 2e-6)

#: A window grows until at most this number of lanes is unsettled; these are left to `point_search`.
_FEW_UNSETTLED = 3
#: Interpolation steps; they leave about one lane in a hundred open.
_STEPS = 4
_FIRST_RADIUS = 3

_squares, _sums = float_scratch((2 * MAX_ROW_RADIUS + 1) ** 2 * LANES), double_scratch(LANES)


@inline
def _nearer(bound: Any, normal: Any, normal_z: Any, across: Any, z: Any) -> Any:
    """Lower a bound to the distance between points and a side plane, minus the rounding error."""
    a = normal * across
    b = normal_z * z
    return lesser(bound, floats(_ZERO) - (a + b) - floats(PLANE_SLACK) * (absolute(a) + absolute(b)))


@inline
def _bound_beyond(x: Any, y: Any, z: Any, u: Any, v: Any, radius: Any, grid: Any) -> Any:
    """Return a lower bound of the squared distance from each lane's point to all points outside the window."""
    columns, rows = grid.columns, grid.rows
    width = columns.shape[0] // 4
    height = rows.shape[0] // 4
    left = MARGIN + u - radius - 1
    right = MARGIN + u + radius + 1
    top = MARGIN + v - radius - 1
    bottom = MARGIN + v + radius + 1
    bound = floats(FARTHEST)
    bound = _nearer(bound, load(columns, left), load(columns, width + left), x, z)
    bound = _nearer(bound, load(columns, 2 * width + right), load(columns, 3 * width + right), x, z)
    bound = _nearer(bound, floats(rows[top]), floats(rows[height + top]), y, z)
    bound = _nearer(bound, floats(rows[2 * height + bottom]), floats(rows[3 * height + bottom]), y, z)
    bound = greater(bound, floats(_ZERO))
    return bound * bound * floats(SQUARE_SLACK)


@inline
def _extend_window(squares: Any, count: Any, end: Any, x: Any, y: Any, z: Any, place: Any, grid: Any) -> None:
    """Write the squared distances to the pixels ``count`` to ``end - 1`` of the window."""
    for i in range(count, end):
        other = place + grid.offsets[i]
        dx = x - load(grid.xs, other)
        dy = y - load(grid.ys, other)
        dz = z - load(grid.zs, other)
        store(squares, i * LANES, multiply_add(dz, dz, multiply_add(dy, dy, dx * dx)))


@inline
def _count_within(squares: Any, count: Any, threshold: Any) -> Any:
    """Return for each lane the number of squared distances up to its threshold."""
    within = ints(_NONE)
    for i in range(count):
        within = within - as_ints(load(squares, i * LANES) <= threshold)
    return within


@inline
def _count_within_both(squares: Any, count: Any, limit: Any, threshold: Any) -> Any:
    """Return for each lane the number of squared distances up to two thresholds."""
    within_limit, within = ints(_NONE), ints(_NONE)
    for i in range(count):
        square = load(squares, i * LANES)
        within_limit = within_limit - as_ints(square <= limit)
        within = within - as_ints(square <= threshold)
    return within_limit, within


@inline
def _enclose(
    squares: Any, count: Any, settled: Any, threshold: Any, within: Any, limit: Any, within_limit: Any, k: Any
) -> Any:
    """Move the threshold of each settled lane until k - 1, k or k + 1 distances lie within; return both."""
    one, minus_one = ints(_SINGLE), ints(np.int32(-1))
    wanted, wanted_share = ints(np.int32(k)), floats(np.float32(k))
    low, high = floats(_ZERO), limit
    within_low, within_high = ints(_NONE), within_limit
    for _ in range(_STEPS):
        excess = within - wanted
        wrong = settled & ((excess > one) | (excess < minus_one))
        if bits(wrong) == 0:
            break
        below = within < wanted
        low = where(below, threshold, low)
        within_low = where(below, within, within_low)
        high = where(below, high, threshold)
        within_high = where(below, within_high, within)
        share = (wanted_share - to_floats(within_low)) / to_floats(within_high - within_low)
        threshold = where(wrong, low + (high - low) * share, threshold)
        within = _count_within(squares, count, threshold)
    return threshold, within


@inline
def _sum_of_nearest(squares: Any, count: Any, threshold: Any, excess: Any) -> Any:
    """Return the sum (float64) of the k smallest distances; ``excess`` (-1, 0 or 1) more are within the threshold."""
    summed = doubles(0.0)
    last_within = floats(_ZERO)
    first_beyond = floats(_HUGE)
    for i in range(count):
        square = load(squares, i * LANES)
        inside = square <= threshold
        summed = summed + to_doubles(where(inside, sqrt(square), floats(_ZERO)))
        last_within = greater(last_within, where(inside, square, floats(_ZERO)))
        first_beyond = lesser(first_beyond, where(inside, floats(_HUGE), square))
    edge = sqrt(where(excess < ints(_NONE), first_beyond, last_within))
    return summed - to_doubles(to_floats(excess)) * to_doubles(edge)


@inline
def _precise_sum_of_nearest(
    squares: Any, count: Any, threshold: Any, excess: Any, k: Any, x: Any, y: Any, z: Any, place: Any, grid: Any
) -> Any:
    """Return the sum of the k smallest distances, each computed in float64, and the lanes in which these are certain.

    They are certain if the next larger squared distance is farther off than the rounding error.
    """
    within = floats(_ZERO)
    beyond = floats(_HUGE)
    for i in range(count):
        square = load(squares, i * LANES)
        inside = square <= threshold
        within = greater(within, where(inside, square, floats(_ZERO)))
        beyond = lesser(beyond, where(inside, floats(_HUGE), square))
    second = floats(_ZERO)
    for i in range(count):
        square = load(squares, i * LANES)
        second = greater(second, where(square < within, square, floats(_ZERO)))
    last = where(excess < ints(_NONE), beyond, where(excess > ints(_NONE), second, within))
    reach = last * floats(_APART)
    found = ints(_NONE)
    summed = doubles(0.0)
    for i in range(count):
        inside = load(squares, i * LANES) <= reach
        if bits(inside) == 0:
            continue
        found = found - as_ints(inside)
        other = place + grid.offsets[i]
        dx = to_doubles(x) - to_doubles(load(grid.xs, other))
        dy = to_doubles(y) - to_doubles(load(grid.ys, other))
        dz = to_doubles(z) - to_doubles(load(grid.zs, other))
        summed = summed + where(inside, sqrt(dx * dx + dy * dy + dz * dz), doubles(0.0))
    return summed, found == ints(np.int32(k))


@inline
def _write_means(summed: Any, good: Any, mask: Any, number: Any, k: Any, sums: Any, means: Any) -> None:
    """Write the means of the lanes in ``mask`` from point ``number`` on; nan in lanes that are not good."""
    store(sums, 0, summed)
    is_good = bits(good)
    while mask != 0:
        lane = count_trailing_zeros(mask)
        means[number] = sums[lane] / k if (is_good >> lane) & 1 else np.nan
        number += 1
        mask &= mask - 1


@kernel
def search_rows(runs: Any, grid: Any, k: Any, precise: Any, means: Any) -> None:
    """Write each point's mean distance to its k nearest points, itself included; nan where that is left open.

    Parameters
    ----------
    runs : int64, shape (n, 5)
        Any part of the runs of a `Grid`.
    grid : GridPlanes
    k : int
        At most the number of points.
    precise : bool
        Sum distances in float64, and leave points open where float32 might have chosen the wrong neighbours.
    means : float64, shape (N,)
        Written at the points' numbers, metres.
    """
    squares, sums = _squares(), _sums()
    radius = _FIRST_RADIUS
    seed = _ZERO
    wanted = ints(np.int32(k))
    for run in range(runs.shape[0]):
        v, u, mask = runs[run, ROW], runs[run, COLUMN], runs[run, MASK]
        number, place = runs[run, NUMBER], runs[run, PLACE]
        if count_ones(mask) <= _FEW_UNSETTLED and not precise:
            for i in range(count_ones(mask)):
                means[number + i] = np.nan
            continue
        x, y, z = load(grid.xs, place), load(grid.ys, place), load(grid.zs, place)
        members = flags(mask)

        count = 0
        while True:
            limit = _bound_beyond(x, y, z, u, v, radius, grid)
            end = (2 * radius + 1) * (2 * radius + 1)
            _extend_window(squares, count, end, x, y, z, place, grid)
            count = max(count, end)
            threshold = lesser(floats(seed), limit)
            within_limit, within = _count_within_both(squares, count, limit, threshold)
            unsettled = count_ones(bits(members & (within_limit < wanted)))
            if unsettled <= _FEW_UNSETTLED or radius >= MAX_ROW_RADIUS:
                break
            radius += 1

        settled = members & (within_limit >= wanted)
        threshold, within = _enclose(squares, count, settled, threshold, within, limit, within_limit, k)
        excess = within - wanted
        good = settled & (excess <= ints(_SINGLE)) & (excess >= ints(np.int32(-1)))
        if precise:
            summed, certain = _precise_sum_of_nearest(squares, count, threshold, excess, k, x, y, z, place, grid)
            good = good & certain
        else:
            summed = _sum_of_nearest(squares, count, threshold, excess)
        _write_means(summed, good, mask, number, k, sums, means)

        if bits(good) != 0:
            seed = total(where(good, threshold, floats(_ZERO))) / np.float32(count_ones(bits(good)))
            if unsettled == 0 and radius > 1:
                smaller = _bound_beyond(x, y, z, u, v, radius - 1, grid)
                if bits(good & (smaller < threshold)) == 0:
                    radius -= 1
