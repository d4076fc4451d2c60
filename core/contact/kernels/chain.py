"""The per-pixel chain, compiled: sixteen pixels at once, in float32 with one fixed order of operations.

`tactune.core.bench.reference_pipeline` repeats that order in NumPy, so both give the same bits on every input: nothing
here uses fast-math, and threads only ever split rows.

All kernels take the same first arguments:

counts, tactile : uint16, flat
    Proximity and tactile counts; these and all other flat arrays have at least `LANES` elements (a plane).
size : tuple of int
    Width and height of the proximity image, then of the tactile image.
model : tuple
    Of an alignment model: ``(rigid, units, planes, table, lens, camera)``. ``units`` (float32) holds metres
    a proximity count, factor and offset from tactile counts to metres, and the translation (3).
    ``planes`` (float32, flat) holds x, y and z of each proximity ray rotated into the tactile frame;
    ``table`` (int32, flat) the tactile pixel of each proximity pixel, -1 for none. A model has one of both.
region : int64, (4,)
    Left, top, right, bottom; right and bottom exclusive.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from ...model.provenance import Provenance
from .colors import lanes_in_range
from .compiling import inline, kernel
from .lenses import project_lanes
from .simd import (
    LANES,
    absolute,
    bits,
    count_ones,
    count_trailing_zeros,
    flags,
    floats,
    floor,
    ints,
    lane_numbers,
    load,
    store,
    to_floats,
    to_ints,
    where,
)
from .simd_memory import float_scratch, gather, gather_colors, int_scratch, load_colors, store_numbers, store_points

_two_vectors, _three_vectors = float_scratch(2 * LANES), float_scratch(3 * LANES)
_int_vector = int_scratch(LANES)

#: Rows of a tile; it is `LANES` columns wide.
TILE_ROWS: Final = 8

_HALF = np.float32(0.5)
_ZERO = np.float32(0.0)
_NAN = np.float32(np.nan)
_NONE = np.int32(0)
_SATURATED = np.int32(65535)
_ALL_LANES = (1 << LANES) - 1

_NO_PROXIMITY_DEPTH = np.int32(Provenance.NO_PROXIMITY_DEPTH)
_OUTSIDE_REGION = np.int32(Provenance.OUTSIDE_REGION)
_OUTSIDE_RANGE = np.int32(Provenance.OUTSIDE_RANGE)
_NO_TACTILE_DEPTH = np.int32(Provenance.NO_TACTILE_DEPTH)
_OUTSIDE_TOLERANCE = np.int32(Provenance.OUTSIDE_TOLERANCE)
_CONTACT = np.int32(Provenance.CONTACT)


@inline
def vector_place(v: Any, u: Any, width: Any, size: Any) -> Any:
    """Return where to load the pixels from (v, u) on, and how many lanes lie before u.

    At the very end of an image the vector begins a few pixels earlier, so as not to reach beyond.
    """
    start = v * width + u
    place = min(start, size - LANES)
    return place, start - place


@inline
def lane_columns(u: Any, before: Any) -> Any:
    """Return each lane's column; of lanes before ``u`` it is below ``u``."""
    return lane_numbers() + ints(np.int32(u - before))


@inline
def within(u: Any, low: Any, high: Any) -> Any:
    """Return in which lanes integers lie from ``low`` to ``high - 1``."""
    return (u >= ints(np.int32(low))) & (u < ints(np.int32(high)))


@inline
def is_depth(counts: Any) -> Any:
    """Return in which lanes counts are a depth: neither 0 nor 65535."""
    return (counts != ints(_NONE)) & (counts != ints(_SATURATED))


@inline
def nearest_pixel(u: Any, v: Any, width: Any, height: Any) -> Any:
    """Return whether pixel coordinates lie in an image, and the flat pixel; 0 where they do not."""
    half = floats(_HALF)
    inside = (u >= floats(-_HALF)) & (u < floats(np.float32(width) - _HALF))
    inside = inside & (v >= floats(-_HALF)) & (v < floats(np.float32(height) - _HALF))
    column = to_ints(floor(where(inside, u, floats(_ZERO)) + half))
    row = to_ints(floor(where(inside, v, floats(_ZERO)) + half))
    return inside, row * ints(np.int32(width)) + column


@inline
def both_depths(place: Any, pixels: Any, depth: Any, valid: Any, tactile: Any, size: Any, model: Any) -> Any:
    """Return dp and dt of the tolerance test, and in which lanes there is each; ``pixels`` is the image's size."""
    rigid, units, planes, table, lens, camera = model
    if rigid:
        z = load(planes, 2 * pixels + place) * depth + floats(units[5])
        has_expected = valid & (z > floats(_ZERO))
        x = load(planes, place) * depth + floats(units[3])
        y = load(planes, pixels + place) * depth + floats(units[4])
        u, v = project_lanes(x, y, z, lens, camera)
        inside, partner = nearest_pixel(u, v, size[2], size[3])
        inside = inside & has_expected
        expected = z
    else:
        partner = load(table, place)
        inside = valid & (partner >= ints(_NONE))
        has_expected = valid
        expected = depth
    seen = gather(tactile, where(inside, partner, ints(_NONE)))
    measured = to_floats(seen) * floats(units[1]) + floats(units[2])
    return expected, has_expected, measured, inside & is_depth(seen)


@inline
def colors_seen(x: Any, y: Any, depth: Any, place: Any, image: Any, color: Any) -> Any:
    """Return red, green and blue at which the colour camera sees points, and in which lanes it does.

    ``place`` is the first lane's depth pixel; ``image`` and ``color`` are those of `find_candidates`.
    """
    own, transform, lens, camera, width, height = color
    if own:
        cx = floats(transform[0]) * x + floats(transform[1]) * y
        cx = cx + floats(transform[2]) * depth + floats(transform[9])
        cy = floats(transform[3]) * x + floats(transform[4]) * y
        cy = cy + floats(transform[5]) * depth + floats(transform[10])
        cz = floats(transform[6]) * x + floats(transform[7]) * y
        cz = cz + floats(transform[8]) * depth + floats(transform[11])
        cu, cv = project_lanes(cx, cy, cz, lens, camera)
        inside, there = nearest_pixel(cu, cv, width, height)
        red, green, blue = gather_colors(image, where(inside, there, ints(_NONE)))
        seen = inside & (cz > floats(_ZERO))
    else:
        red, green, blue = load_colors(image, place)
        seen = flags(_ALL_LANES)
    return red, green, blue, seen


@kernel
def align_rows(
    counts: Any, tactile: Any, size: Any, model: Any, region: Any, first: Any, last: Any, expected: Any, measured: Any
) -> None:
    """Write both sides of the tolerance test for rows ``first`` to ``last - 1``; nan where there is none.

    ``expected`` and ``measured`` are float32, flat.
    """
    width, height = size[0], size[1]
    pixels = max(width * height, LANES)
    buffer = _two_vectors()
    for v in range(first, last):
        for u in range(0, width, LANES):
            place, before = vector_place(v, u, width, pixels)
            count = load(counts, place)
            depth = to_floats(count) * floats(model[1][0])
            column = lane_columns(u, before)
            valid = is_depth(count) & within(column, max(u, region[0]), region[2])
            if v < region[1] or v >= region[3]:
                valid = valid & (column < ints(_NONE))
            dp, has_dp, dt, has_dt = both_depths(place, pixels, depth, valid, tactile, size, model)
            dp, dt = where(has_dp, dp, floats(_NAN)), where(has_dt, dt, floats(_NAN))
            if u + LANES <= width:
                store(expected, place, dp)
                store(measured, place, dt)
                continue
            store(buffer, 0, dp)
            store(buffer, LANES, dt)
            for i in range(min(LANES, width - u)):
                expected[v * width + u + i] = buffer[before + i]
                measured[v * width + u + i] = buffer[LANES + before + i]


@kernel
def classify_rows(
    counts: Any, tactile: Any, size: Any, model: Any, region: Any, limits: Any, first: Any, last: Any, provenance: Any
) -> None:
    """Write the verdict of depth, region, range and tolerance for some rows; candidates get CONTACT.

    ``limits`` (float32) holds nearest and farthest depth and the tolerance; ``provenance`` is uint8, flat.
    """
    width, height = size[0], size[1]
    pixels = max(width * height, LANES)
    buffer = _int_vector()
    for v in range(first, last):
        row_in_region = v >= region[1] and v < region[3]
        for u in range(0, width, LANES):
            place, before = vector_place(v, u, width, pixels)
            count = load(counts, place)
            depth = to_floats(count) * floats(model[1][0])
            column = lane_columns(u, before)
            has_depth = is_depth(count)
            in_region = within(column, region[0], region[2])
            if not row_in_region:
                in_region = column < ints(_NONE)
            valid = has_depth & in_region & (column >= ints(np.int32(u)))
            dp, has_dp, dt, has_dt = both_depths(place, pixels, depth, valid, tactile, size, model)
            agrees = absolute(dp - dt) <= floats(limits[2]) * absolute(dp)
            verdict = where(agrees, ints(_CONTACT), ints(_OUTSIDE_TOLERANCE))
            verdict = where(has_dp & has_dt, verdict, ints(_NO_TACTILE_DEPTH))
            out_of_range = (depth < floats(limits[0])) | (depth > floats(limits[1]))
            verdict = where(out_of_range, ints(_OUTSIDE_RANGE), verdict)
            verdict = where(in_region, verdict, ints(_OUTSIDE_REGION))
            verdict = where(has_depth, verdict, ints(_NO_PROXIMITY_DEPTH))
            if u + LANES <= width:
                store(provenance, place, verdict)
                continue
            store(buffer, 0, verdict)
            for i in range(min(LANES, width - u)):
                provenance[v * width + u + i] = np.uint8(buffer[before + i])


@kernel
def count_changed(before: Any, after: Any, noise: Any) -> Any:
    """Return how many of two depth images' pixels differ by more than ``noise`` counts, or in having a depth."""
    changed = 0
    low, high = ints(np.int32(-noise)), ints(np.int32(noise))
    last = before.shape[0] - LANES
    for start in range(0, before.shape[0], LANES):
        place = min(start, last)
        old, new = load(before, place), load(after, place)
        had, has = is_depth(old), is_depth(new)
        moved = ((new - old) > high) | ((new - old) < low)
        is_new = lane_numbers() >= ints(np.int32(start - place))
        changed += count_ones(bits(is_new & ((had ^ has) | (had & has & moved))))
    return changed


@kernel
def find_candidates(
    counts: Any, tactile: Any, size: Any, model: Any, region: Any, limits: Any, rays: Any, image: Any, color: Any,
    hsv: Any, tiles: Any, first: Any, last: Any, pixels_out: Any, points_out: Any
) -> Any:  # fmt: skip
    """Find the pixels of rows ``first`` to ``last - 1`` that pass the tolerance test and the colour mask.

    Parameters
    ----------
    rays : float32, flat
        x / z, then y / z of each proximity ray.
    image : uint8, flat
        Proximity colours.
    color : tuple
        ``(own, transform, lens, camera, width, height)``; ``own`` tells whether the colour camera stands apart,
        ``transform`` (float32, (12,)) holds rotation and translation from depth to colour, and the last two
        are the colour image's size.
    hsv : int64, (6,) or (0,)
        Range of colours to leave out, from `colors.hsv_limits`; empty for no mask.
    tiles : bool, (rows of tiles, tiles in a row)
        False where `coarse` has shown that a tile of `TILE_ROWS` x `LANES` pixels has no candidate.
    pixels_out, points_out : int64 and float32 (flat, three a point), written from point ``first * width`` on
        Those pixels and their points, in order.

    Returns
    -------
    int
        How many.
    """
    width, height = size[0], size[1]
    pixels = max(width * height, LANES)
    point = _three_vectors()
    has_mask = hsv.shape[0] > 0
    kept = first * width
    for v in range(max(first, region[1]), min(last, region[3])):
        for u in range(region[0] // LANES * LANES, region[2], LANES):
            if not tiles[v // TILE_ROWS, u // LANES]:
                continue
            place, before = vector_place(v, u, width, pixels)
            count = load(counts, place)
            depth = to_floats(count) * floats(model[1][0])
            column = lane_columns(u, before)
            valid = is_depth(count) & within(column, max(u, region[0]), region[2])
            valid = valid & (depth >= floats(limits[0])) & (depth <= floats(limits[1]))
            if bits(valid) == 0:
                continue
            dp, _, dt, has_dt = both_depths(place, pixels, depth, valid, tactile, size, model)
            passes = has_dt & (absolute(dp - dt) <= floats(limits[2]) * absolute(dp))
            if bits(passes) == 0:
                continue
            x = load(rays, place) * depth
            y = load(rays, pixels + place) * depth
            if has_mask:
                red, green, blue, seen = colors_seen(x, y, depth, place, image, color)
                passes = passes & ~(lanes_in_range(red, green, blue, hsv) & seen)
            remaining = bits(passes)
            if remaining == _ALL_LANES:
                store_points(points_out, 3 * kept, x, y, depth)
                store_numbers(pixels_out, kept, place)
                kept += LANES
                continue
            store(point, 0, x)
            store(point, LANES, y)
            store(point, 2 * LANES, depth)
            while remaining != 0:
                lane = count_trailing_zeros(remaining)
                pixels_out[kept] = place + lane
                points_out[3 * kept] = point[lane]
                points_out[3 * kept + 1] = point[LANES + lane]
                points_out[3 * kept + 2] = point[2 * LANES + lane]
                kept += 1
                remaining &= remaining - 1
    return kept - first * width
