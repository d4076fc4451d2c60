"""The tolerance test of each pixel, compiled: sixteen pixels at once, in float32 with one fixed order of operations.

`tactune.core.lab.reference` repeats that order in NumPy, so both give the same bits on every input. Nothing
here uses fast-math, and threads split the work by rows only.

The arguments of the kernels are grouped in the tuples below. Flat arrays of pixels have at least `LANES` elements.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from ...model.arrays import AnyArray, Float32Array, Int32Array, Int64Array, Uint8Array, Uint16Array
from .colors import lanes_in_range
from .compiling import inline, kernel
from .lenses import project_lanes
from .simd import (
    LANES,
    absolute,
    bits,
    count_trailing_zeros,
    flags,
    float_scratch,
    floats,
    floor,
    gather,
    gather_colors,
    greater,
    ints,
    lane_numbers,
    lesser,
    load,
    load_colors,
    store,
    store_numbers,
    store_points,
    to_floats,
    to_ints,
    where,
)

_float_vector, _three_vectors = float_scratch(LANES), float_scratch(3 * LANES)

#: Rows of an image tile; it is `LANES` columns wide.
TILE_ROWS: Final = 8

#: Bound of the rounding error of a sum, as a share of its terms; at least ten times as large.
SLACK = np.float32(1e-5)
_HALF = np.float32(0.5)
_ZERO = np.float32(0.0)
_NAN = np.float32(np.nan)
_NONE = np.int32(0)
_SATURATED = np.int32(65535)
_ALL_LANES = (1 << LANES) - 1


def flat(image: AnyArray, min_length: int = LANES) -> AnyArray:
    """Return an image's elements in a row, padded with zeros to at least ``min_length`` elements."""
    pixels = np.ascontiguousarray(image).reshape(-1)
    if len(pixels) >= min_length:
        return pixels
    padded = np.pad(pixels, (0, min_length - len(pixels)))
    padded.flags.writeable = pixels.flags.writeable  # for another type the kernels would be compiled again
    return padded


def planes_of(table: Float32Array) -> Float32Array:
    """Return a table (H, W, n) as n flat planes, one after another, each padded to a whole vector."""
    return np.concatenate([flat(np.ascontiguousarray(table[..., i])) for i in range(table.shape[2])])


class DepthImages(NamedTuple):
    """Raw depth images of one frame."""

    #: flat: Counts; 0 and 65535 are no depth.
    proximity: Uint16Array
    tactile: Uint16Array


class ImageSizes(NamedTuple):
    """Width and height of the proximity and of the tactile depth image, pixels."""

    width: int
    height: int
    tactile_width: int
    tactile_height: int


class AlignmentTables(NamedTuple):
    """An alignment model: the tactile pixel and the expected tactile depth of each proximity pixel."""

    rigid: bool  # Otherwise a homography
    size: ImageSizes
    proximity_unit_m: np.float32  # Metres of one proximity count
    tactile_unit_m: np.float32  # Metres of one tactile count, after depth correction
    tactile_offset_m: np.float32  # Added to it
    translation_m: Float32Array  # (3,): Of ``T_t_p``, metres
    planes: Float32Array  # flat: x, then y, then z of each proximity ray in the tactile frame; empty for a homography
    table: Int32Array  # flat: Tactile pixel of each proximity pixel, -1 for none; empty for the rigid model
    lens: int  # Lens model of the tactile camera, as in `lenses`
    camera: Float32Array  # (9,): Its parameters, from `lenses.lens_parameters`


class Region(NamedTuple):
    """A rectangle of proximity pixels; ``right`` and ``bottom`` are exclusive."""

    left: int
    top: int
    right: int
    bottom: int


class DepthLimits(NamedTuple):
    """Nearest and farthest proximity depth considered (metres, float32), and the tolerance t (float32)."""

    nearest_m: np.float32
    farthest_m: np.float32
    tolerance: np.float32


class PixelTest(NamedTuple):
    """Everything but the colour that decides about a pixel."""

    alignment: AlignmentTables
    region: Region
    limits: DepthLimits
    rays: Float32Array  # flat: x / z, then y / z of each proximity ray


class ColorLookup(NamedTuple):
    """Where the colour of a proximity point is looked up."""

    separate: bool  # Whether the colour camera stands apart; otherwise the other fields are not used
    transform: Float32Array  # (12,): Rotation (row by row) and translation (metres) from the depth to the colour frame
    lens: int  # Lens model of the colour camera, as in `AlignmentTables`
    camera: Float32Array
    width: int  # Of the colour image
    height: int


class ColorTest(NamedTuple):
    """The colour mask of one frame."""

    lookup: ColorLookup
    image: Uint8Array  # flat: Proximity colours, RGB
    hsv: Int64Array  # (6,): Range of colours that are masked, from `colors.hsv_limits`; empty for no mask


class CandidateArrays(NamedTuple):
    """Where `find_candidates` writes."""

    pixels: Int64Array  # (H * W,): Flat pixels
    points: Float32Array  # (H * W * 3,): Their points x, y, z, metres
    counts: Int64Array  # (H,): Number of candidates from a row on


@inline
def plane_size(size: Any) -> Any:
    """Return the number of elements of a plane of proximity pixels."""
    return max(size.width * size.height, LANES)


@inline
def vector_place(v: Any, u: Any, width: Any, size: Any) -> Any:
    """Return where to load the pixels from (v, u) on, and how many lanes lie before u.

    At the very end of an image the vector begins a few pixels earlier, so that it does not reach beyond the end.
    """
    start = v * width + u
    place = min(start, size - LANES)
    return place, start - place


@inline
def lane_columns(u: Any, before: Any) -> Any:
    """Return each lane's column; lanes before ``u`` have a column below ``u``."""
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
def store_lanes(out: Any, start: Any, count: Any, lanes: Any, before: Any, buffer: Any) -> None:
    """Write lanes ``before`` onwards to elements ``start`` to ``start + count - 1``, at most `LANES` of them.

    ``buffer`` holds one vector. With ``count`` >= `LANES`, ``before`` must be 0.
    """
    if count >= LANES:
        store(out, start, lanes)
    else:
        store(buffer, 0, lanes)
        for i in range(count):
            out[start + i] = buffer[before + i]


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
def both_depths(place: Any, depth: Any, valid: Any, tactile: Any, alignment: Any) -> Any:
    """Return dp and dt of the tolerance test, each followed by the lanes that have it.

    ``place`` is the first lane's proximity pixel, ``depth`` the proximity depth (metres) of the ``valid`` lanes.
    """
    size = alignment.size
    if alignment.rigid:
        planes, translation = alignment.planes, alignment.translation_m
        z = load(planes, 2 * plane_size(size) + place) * depth + floats(translation[2])
        has_expected = valid & (z > floats(_ZERO))
        x = load(planes, place) * depth + floats(translation[0])
        y = load(planes, plane_size(size) + place) * depth + floats(translation[1])
        u, v = project_lanes(x, y, z, alignment.lens, alignment.camera)
        inside, partner = nearest_pixel(u, v, size.tactile_width, size.tactile_height)
        inside = inside & has_expected
        expected = z
    else:
        partner = load(alignment.table, place)
        inside = valid & (partner >= ints(_NONE))
        has_expected = valid
        expected = depth
    seen = gather(tactile, where(inside, partner, ints(_NONE)))
    measured = to_floats(seen) * floats(alignment.tactile_unit_m) + floats(alignment.tactile_offset_m)
    return expected, has_expected, measured, inside & is_depth(seen)


@inline
def within_tolerance(dp: Any, dt: Any, tolerance: Any) -> Any:
    """Return in which lanes both depths pass the tolerance test, |dp - dt| <= t |dp|; `accepted_range` bounds it."""
    return absolute(dp - dt) <= floats(tolerance) * absolute(dp)


@inline
def accepted_range(low: Any, high: Any, tolerance: Any, margin: Any) -> Any:
    """Return the range of measured depths `within_tolerance` of an expected one from low to high, and a margin."""
    share = floats(tolerance)
    slack = floats(SLACK) * greater(absolute(low), absolute(high)) + floats(margin)
    lowest = lesser(low - share * absolute(low), high - share * absolute(high)) - slack
    highest = greater(low + share * absolute(low), high + share * absolute(high)) + slack
    return lowest, highest


@inline
def colors_seen(x: Any, y: Any, depth: Any, place: Any, color: Any) -> Any:
    """Return red, green and blue of points (metres, depth frame), and the lanes that the colour camera sees.

    ``place`` is the first lane's depth pixel, ``color`` a `ColorTest`.
    """
    lookup = color.lookup
    if lookup.separate:
        transform = lookup.transform
        cx = floats(transform[0]) * x + floats(transform[1]) * y
        cx = cx + floats(transform[2]) * depth + floats(transform[9])
        cy = floats(transform[3]) * x + floats(transform[4]) * y
        cy = cy + floats(transform[5]) * depth + floats(transform[10])
        cz = floats(transform[6]) * x + floats(transform[7]) * y
        cz = cz + floats(transform[8]) * depth + floats(transform[11])
        cu, cv = project_lanes(cx, cy, cz, lookup.lens, lookup.camera)
        inside, there = nearest_pixel(cu, cv, lookup.width, lookup.height)
        red, green, blue = gather_colors(color.image, where(inside, there, ints(_NONE)))
        seen = inside & (cz > floats(_ZERO))
    else:
        red, green, blue = load_colors(color.image, place)
        seen = flags(_ALL_LANES)
    return red, green, blue, seen


@inline
def is_masked(x: Any, y: Any, depth: Any, place: Any, color: Any) -> Any:
    """Return in which lanes the colour of points is known and lies in the mask's range."""
    red, green, blue, seen = colors_seen(x, y, depth, place, color)
    return lanes_in_range(red, green, blue, color.hsv) & seen


@kernel
def align_rows(images: Any, alignment: Any, region: Any, expected: Any, measured: Any, first: Any, last: Any) -> None:
    """Write both sides of the tolerance test (float32, flat, metres) for some rows of `DepthImages`; nan for none."""
    width, pixels = alignment.size.width, plane_size(alignment.size)
    buffer = _float_vector()
    for v in range(first, last):
        for u in range(0, width, LANES):
            place, before = vector_place(v, u, width, pixels)
            count = load(images.proximity, place)
            depth = to_floats(count) * floats(alignment.proximity_unit_m)
            column = lane_columns(u, before)
            valid = is_depth(count) & within(column, max(u, region.left), region.right)
            if v < region.top or v >= region.bottom:
                valid = valid & (column < ints(_NONE))
            dp, has_dp, dt, has_dt = both_depths(place, depth, valid, images.tactile, alignment)
            start = v * width + u
            store_lanes(expected, start, width - u, where(has_dp, dp, floats(_NAN)), before, buffer)
            store_lanes(measured, start, width - u, where(has_dt, dt, floats(_NAN)), before, buffer)


@inline
def _append_points(x: Any, y: Any, depth: Any, place: Any, chosen: Any, kept: Any, buffer: Any, out: Any) -> Any:
    """Append the pixels and points of the lanes in the bits ``chosen``; return the new number of points.

    ``place`` is the first lane's pixel, ``kept`` the number of points so far; ``buffer`` holds three vectors.
    """
    if chosen == _ALL_LANES:
        store_points(out.points, 3 * kept, x, y, depth)
        store_numbers(out.pixels, kept, place)
        kept += LANES
    else:
        store(buffer, 0, x)
        store(buffer, LANES, y)
        store(buffer, 2 * LANES, depth)
        while chosen != 0:
            lane = count_trailing_zeros(chosen)
            out.pixels[kept] = place + lane
            out.points[3 * kept] = buffer[lane]
            out.points[3 * kept + 1] = buffer[LANES + lane]
            out.points[3 * kept + 2] = buffer[2 * LANES + lane]
            kept += 1
            chosen &= chosen - 1
    return kept


@kernel
def find_candidates(images: Any, test: Any, color: Any, tiles: Any, out: Any, first: Any, last: Any) -> None:
    """Find the pixels of rows ``first`` to ``last - 1`` that pass the tolerance test and the colour mask.

    Parameters
    ----------
    images, test, color : DepthImages, PixelTest, ColorTest
    tiles : bool, shape (rows of image tiles, tiles in a row)
        False where `coarse` has shown that a tile of `TILE_ROWS` x `LANES` pixels has no candidate.
    out : CandidateArrays
        Written from element ``first * width`` on, in the order of the pixels; their number to ``counts[first]``.
    """
    alignment, region, limits, rays = test.alignment, test.region, test.limits, test.rays
    width, pixels = alignment.size.width, plane_size(alignment.size)
    buffer = _three_vectors()
    kept = first * width
    for v in range(max(first, region.top), min(last, region.bottom)):
        for u in range(region.left // LANES * LANES, region.right, LANES):
            if not tiles[v // TILE_ROWS, u // LANES]:
                continue
            place, before = vector_place(v, u, width, pixels)
            count = load(images.proximity, place)
            depth = to_floats(count) * floats(alignment.proximity_unit_m)
            column = lane_columns(u, before)
            valid = is_depth(count) & within(column, max(u, region.left), region.right)
            valid = valid & (depth >= floats(limits.nearest_m)) & (depth <= floats(limits.farthest_m))
            if bits(valid) == 0:
                continue
            dp, _, dt, has_dt = both_depths(place, depth, valid, images.tactile, alignment)
            passes = has_dt & within_tolerance(dp, dt, limits.tolerance)
            if bits(passes) == 0:
                continue
            x = load(rays, place) * depth
            y = load(rays, pixels + place) * depth
            if color.hsv.shape[0] > 0:
                passes = passes & ~is_masked(x, y, depth, place, color)
            kept = _append_points(x, y, depth, place, bits(passes), kept, buffer, out)
    out.counts[first] = kept - first * width
