"""Mean distance to the k nearest points, for sixteen neighbouring pixels at once."""

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
from .grid import COLUMN, FARTHEST, MARGIN, MASK, MOST_TILE_RADIUS, NUMBER, PLACE, ROW

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_HUGE = np.float32(1e30)
_NONE, _SINGLE = np.int32(0), np.int32(1)

#: More than what rounding moves a point across a side plane, as a share of the terms of that distance.
PLANE_SLACK = np.float32(4e-7)
#: Squared distances up to a squared bound times this are below it without rounding, too.
SQUARE_SLACK = np.float32(1.0 - 1e-6)

#: Squared distances that differ by this factor are in the same order without rounding, too.
_APART = np.float32(1.0 + 2e-6)

#: A window grows until at most so many of its lanes are left to `single`, ...
_FEW_UNSETTLED = 3
#: ... and a threshold is sought in so many steps, which leave about one lane in a hundred.
_STEPS = 4
_FIRST_RADIUS = 3

_squares, _sums = float_scratch((2 * MOST_TILE_RADIUS + 1) ** 2 * LANES), double_scratch(LANES)


@inline
def _nearer(bound: Any, normal: Any, normal_z: Any, across: Any, z: Any) -> Any:
    """Lower a bound to the distance between points and a side plane, less what rounding may add."""
    a = normal * across
    b = normal_z * z
    return lesser(bound, floats(_ZERO) - (a + b) - floats(PLANE_SLACK) * (absolute(a) + absolute(b)))


@inline
def bound_beyond(x: Any, y: Any, z: Any, u: Any, v: Any, radius: Any, columns: Any, rows: Any) -> Any:
    """Return less than the squared distance from each lane's point to anything seen outside its window."""
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
def _largest_known(squares: Any, count: Any) -> Any:
    """Return the largest of each lane's squared distances to points that there are."""
    largest = floats(_ZERO)
    for i in range(count):
        square = load(squares, i * LANES)
        largest = greater(largest, where(square < floats(FARTHEST * FARTHEST), square, floats(_ZERO)))
    return largest


@inline
def _exact_sums(
    squares: Any, count: Any, threshold: Any, excess: Any, k: Any, x: Any, y: Any, z: Any, place: Any, offsets: Any,
    xs: Any, ys: Any, zs: Any
) -> Any:  # fmt: skip
    """Return the sums of the k smallest distances in float64, and in which lanes they are surely the k smallest.

    That is so where the next larger squared distance lies farther off than rounding can reach.
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
    total_within = doubles(0.0)
    for i in range(count):
        inside = load(squares, i * LANES) <= reach
        if bits(inside) == 0:
            continue
        found = found - as_ints(inside)
        other = place + offsets[i]
        dx = to_doubles(x) - to_doubles(load(xs, other))
        dy = to_doubles(y) - to_doubles(load(ys, other))
        dz = to_doubles(z) - to_doubles(load(zs, other))
        total_within = total_within + where(inside, sqrt(dx * dx + dy * dy + dz * dz), doubles(0.0))
    return total_within, found == ints(np.int32(k))


@kernel
def search_tiles(
    tiles: Any, xs: Any, ys: Any, zs: Any, offsets: Any, columns: Any, rows: Any, k: Any, window: Any,
    precise: Any, means: Any
) -> None:  # fmt: skip
    """Write each point's mean distance to its k nearest, itself included; nan where that is left open.

    A tile's window of pixels grows until nothing outside can be among the k nearest. Then the k-th
    squared distance of each lane is enclosed by counting how many of the window's lie below a threshold
    and interpolating, until the count is k - 1, k or k + 1; the sum of the k smallest follows.

    Distances are float32: each is within 3 units in the last place of the exact one, and so is their
    mean, since the mean of the k smallest of a set moves no more than the set's members do.

    Parameters
    ----------
    tiles, xs, ys, zs, offsets, columns, rows
        Of a `Grid`; any part of its tiles.
    k : int
        At most the number of points.
    window : int
        0: windows grow as needed. Else: windows of this radius are trusted to hold the k nearest.
    precise : bool
        Sum distances in float64, and leave open where float32 might have chosen the wrong ones.
    means : float64, shape (N,), written
        Metres, by the points' numbers.
    """
    squares, sums = _squares(), _sums()
    radius = window if window > 0 else _FIRST_RADIUS
    seed = _ZERO
    one = ints(_SINGLE)
    minus_one = ints(np.int32(-1))
    wanted = ints(np.int32(k))
    wanted_share = floats(np.float32(k))
    for tile in range(tiles.shape[0]):
        v = tiles[tile, ROW]
        u = tiles[tile, COLUMN]
        mask = tiles[tile, MASK]
        number = tiles[tile, NUMBER]
        place = tiles[tile, PLACE]
        if count_ones(mask) <= _FEW_UNSETTLED and window == 0 and not precise:
            for i in range(count_ones(mask)):
                means[number + i] = np.nan
            continue
        x = load(xs, place)
        y = load(ys, place)
        z = load(zs, place)
        members = flags(mask)

        count = 0
        while True:
            limit = bound_beyond(x, y, z, u, v, radius, columns, rows)
            end = (2 * radius + 1) * (2 * radius + 1)
            while count < end:
                other = place + offsets[count]
                dx = x - load(xs, other)
                dy = y - load(ys, other)
                dz = z - load(zs, other)
                store(squares, count * LANES, multiply_add(dz, dz, multiply_add(dy, dy, dx * dx)))
                count += 1
            if window > 0:
                limit = _largest_known(squares, count)
            threshold = lesser(floats(seed), limit)
            within_limit = ints(_NONE)
            within = ints(_NONE)
            for i in range(count):
                square = load(squares, i * LANES)
                within_limit = within_limit - as_ints(square <= limit)
                within = within - as_ints(square <= threshold)
            unsettled = count_ones(bits(members & (within_limit < wanted)))
            if unsettled <= _FEW_UNSETTLED or radius >= MOST_TILE_RADIUS or window > 0:
                break
            radius += 1
        settled = members & (within_limit >= wanted)

        low = floats(_ZERO)
        high = limit
        within_low = ints(_NONE)
        within_high = within_limit
        step = 0
        while step < _STEPS:
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
            within = ints(_NONE)
            for i in range(count):
                within = within - as_ints(load(squares, i * LANES) <= threshold)
            step += 1
        excess = within - wanted
        good = settled & (excess <= one) & (excess >= minus_one)

        summed = doubles(0.0)
        if precise:
            summed, certain = _exact_sums(squares, count, threshold, excess, k, x, y, z, place, offsets, xs, ys, zs)
            good = good & certain
        else:
            last_within = floats(_ZERO)
            first_beyond = floats(_HUGE)
            for i in range(count):
                square = load(squares, i * LANES)
                inside = square <= threshold
                summed = summed + to_doubles(where(inside, sqrt(square), floats(_ZERO)))
                last_within = greater(last_within, where(inside, square, floats(_ZERO)))
                first_beyond = lesser(first_beyond, where(inside, floats(_HUGE), square))
            edge = sqrt(where(excess < ints(_NONE), first_beyond, last_within))
            summed = summed - to_doubles(to_floats(excess)) * to_doubles(edge)
        store(sums, 0, summed)
        is_good = bits(good)
        remaining = mask
        while remaining != 0:
            lane = count_trailing_zeros(remaining)
            means[number] = sums[lane] / k if (is_good >> lane) & 1 else np.nan
            number += 1
            remaining &= remaining - 1

        if is_good != 0:
            seed = total(where(good, threshold, floats(_ZERO))) / np.float32(count_ones(is_good))
            if unsettled == 0 and radius > 1 and window == 0:
                smaller = bound_beyond(x, y, z, u, v, radius - 1, columns, rows)
                if bits(good & (smaller < threshold)) == 0:
                    radius -= 1
