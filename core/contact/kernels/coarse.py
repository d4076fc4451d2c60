"""Finds the image tiles that cannot hold contact, from the ranges of depth in the tiles of both images.

The answer is certain: every bound is widened by more than the rounding error of float32. A proximity tile sees, over
all its rays and its range of depth, a rectangle of the tactile image. If no tactile depth in that rectangle comes
within the tolerance of any depth expected there, no pixel of the tile passes the test.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...model.arrays import AnyArray, BoolArray, Float32Array, Int32Array
from .compiling import inline, kernel
from .lenses import PINHOLE
from .simd import (
    LANES,
    absolute,
    bits,
    count_trailing_zeros,
    counts,
    flags,
    float_scratch,
    floats,
    floor,
    gather,
    greater,
    greater_counts,
    int_scratch,
    ints,
    largest_count,
    least_count,
    lesser,
    lesser_counts,
    load,
    load_counts,
    store,
    to_floats,
    to_ints,
    where,
)
from .tolerance import SLACK, TILE_ROWS, AlignmentTables, DepthImages, DepthLimits, accepted_range

#: A rectangle of at most this many tiles in each direction is tested at once first; a larger one is rare.
_SPAN = 3

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE_COUNT = np.uint16(1)
_NO_COUNT, _ALL_COUNTS = np.uint16(0), np.uint16(65535)
#: At least ten times the rounding error, in pixels.
_PIXEL_SLACK = np.float32(0.05)
#: A tile with points nearer to the plane of the tactile camera is never ruled out, metres.
_MIN_Z = np.float32(1e-6)
_FARTHEST_PIXEL = np.float32(1e6)
_corners, _lowest, _highest = int_scratch(4 * LANES), float_scratch(LANES), float_scratch(LANES)
_NOTHING, _ONE = np.int32(0), np.int32(1)


class TileBuffers(NamedTuple):
    """Ranges of raw counts by tile: least, then largest; the least is larger where there is no depth."""

    proximity: Int32Array  # (2, N): of N proximity tiles, filled up to whole vectors
    tactile: Int32Array  # (2, M): of M tactile tiles and a margin without depth
    spread: Int32Array  # (4, M): over `_SPAN` tiles to the right, then over a square of `_SPAN` x `_SPAN` tiles


@inline
def _tile_grid(width: Any, height: Any) -> Any:
    """Return the number of rows and columns of tiles that cover an image."""
    return (height + TILE_ROWS - 1) // TILE_ROWS, (width + LANES - 1) // LANES


tile_grid: Callable[[int, int], tuple[int, int]] = _tile_grid.py_func


class CoarseTest:
    """The coarse test of one alignment model, with its tables and buffers. For one thread at a time."""

    def __init__(self, alignment: AlignmentTables) -> None:
        width, height, tactile_width, tactile_height = alignment.size
        self.shape = tile_grid(width, height)
        self.every_tile = np.ones(self.shape, np.bool_), self.shape[0] * self.shape[1]
        # With a distorted lens the corners of a rectangle do not bound its projection.
        self.possible = not alignment.rigid or alignment.lens == PINHOLE
        if not self.possible:
            return
        self._alignment = alignment
        if alignment.rigid:
            parts = np.split(alignment.planes, 3)
            self._tables = np.concatenate([bound for part in parts for bound in _bounds(part, width, height)])
        else:
            rectangles = _rectangles(alignment.table, width, height, tactile_width)
            self._tables = np.concatenate([_filled(bound.astype(np.float32)) for bound in rectangles])
        rows, columns = tile_grid(tactile_width, tactile_height)
        count = (rows + 2 * _SPAN) * columns + 2 * LANES
        self._buffers = TileBuffers(
            np.empty((2, _vector_elements(self.shape)), np.int32),
            np.full((2, count), [[1 << 16], [-1]], np.int32),
            np.full((4, count), [[1 << 16], [-1]] * 2, np.int32),
        )
        self._tiles = np.empty(self.shape, np.bool_)

    def tiles(self, images: DepthImages, limits: DepthLimits, margin_m: float = 0.0) -> tuple[BoolArray, int]:
        """Return which tiles may hold contact, and their number; the next call overwrites the array.

        Both depths may differ by ``margin_m`` beyond the tolerance.
        """
        if not self.possible:
            return self.every_tile
        count = _mark_tiles(
            images, self._alignment, self._tables, limits, np.float32(margin_m), self._buffers, self._tiles
        )
        return self._tiles, count


def _vector_elements(shape: tuple[int, int]) -> int:
    """Return the number of tiles, rounded up to whole vectors."""
    return -(-shape[0] * shape[1] // LANES) * LANES


def _filled(tiles: AnyArray) -> AnyArray:
    """Return values by tile as a flat array, filled up to whole vectors."""
    return np.pad(tiles.ravel(), (0, _vector_elements(tiles.shape) - tiles.size), mode="edge")


def _blocks(image: AnyArray, filling: Any) -> AnyArray:
    """Return an image (H, W) as tiles (rows, columns, pixels)."""
    rows, columns = tile_grid(image.shape[1], image.shape[0])
    padded = np.full((rows * TILE_ROWS, columns * LANES), filling, image.dtype)
    padded[: image.shape[0], : image.shape[1]] = image
    tiles = padded.reshape(rows, TILE_ROWS, columns, LANES).swapaxes(1, 2)
    return tiles.reshape(rows, columns, -1)


def _bounds(plane: Float32Array, width: int, height: int) -> list[Float32Array]:
    """Return the least and largest value of a plane of pixels by tile."""
    image = plane[: width * height].reshape(height, width)
    return [_filled(_blocks(image, np.inf).min(axis=2)), _filled(_blocks(image, -np.inf).max(axis=2))]


def _rectangles(table: Int32Array, width: int, height: int, tactile_width: int) -> list[Int32Array]:
    """Return left, right, top and bottom of the tactile pixels that each tile looks up; right < left for none."""
    partners = table[: width * height].reshape(height, width)
    bounds = []
    for coordinate in (partners % tactile_width, partners // tactile_width):
        none = partners < 0
        bounds.append(_blocks(np.where(none, 1 << 20, coordinate), 1 << 20).min(axis=2))
        bounds.append(_blocks(np.where(none, -1, coordinate), -1).max(axis=2))
    return bounds


@inline
def _extend(low: Any, high: Any, count: Any) -> Any:
    """Extend ranges by counts. Both ends are off by one, so that the invalid counts 0 and 65535 wrap around."""
    return lesser_counts(low, count - counts(_ONE_COUNT)), greater_counts(high, count + counts(_ONE_COUNT))


@kernel
def _ranges_of_tiles(image: Any, width: Any, height: Any, lows: Any, highs: Any) -> None:
    """Write the least and largest valid count of each tile; the least is larger where there is none.

    Two tiles at once fill a cache line. Near the end of the image vectors begin earlier and include neighbours.
    """
    last_place = image.shape[0] - LANES
    tile = 0
    for first in range(0, height, TILE_ROWS):
        for column in range(0, width, 2 * LANES):
            place = first * width + column
            low, high = counts(_ALL_COUNTS), counts(_NO_COUNT)
            next_low, next_high = low, high
            if first + TILE_ROWS <= height and column + 2 * LANES <= width:
                for _ in range(TILE_ROWS):
                    low, high = _extend(low, high, load_counts(image, place))
                    next_low, next_high = _extend(next_low, next_high, load_counts(image, place + LANES))
                    place += width
            else:
                for _ in range(first, min(first + TILE_ROWS, height)):
                    low, high = _extend(low, high, load_counts(image, min(place, last_place)))
                    beside = load_counts(image, min(place + LANES, last_place))
                    next_low, next_high = _extend(next_low, next_high, beside)
                    place += width
            lows[tile] = np.int32(least_count(low)) + _ONE
            highs[tile] = np.int32(largest_count(high)) - _ONE
            tile += 1
            if column + LANES < width:
                lows[tile] = np.int32(least_count(next_low)) + _ONE
                highs[tile] = np.int32(largest_count(next_high)) - _ONE
                tile += 1


@inline
def _widen(low: Any, high: Any, a: Any, b: Any) -> Any:
    """Extend a range by the sum of two terms and its rounding error."""
    both = a + b
    slack = floats(SLACK) * (absolute(a) + absolute(b))
    return lesser(low, both - slack), greater(high, both + slack)


@inline
def _transformed(low: Any, high: Any, depth: Any, translation: Any) -> Any:
    """Return the range of one coordinate, in the tactile frame, of points at a depth on rays from low to high."""
    huge = floats(np.float32(np.inf))
    shift = floats(translation)
    first, last = _widen(huge, floats(_ZERO) - huge, low * depth, shift)
    return _widen(first, last, high * depth, shift)


@inline
def _pixel_range(low: Any, high: Any, near_z: Any, far_z: Any, focal: Any, centre: Any) -> Any:
    """Return the range of pixel coordinates of ``low`` to ``high`` over ``near_z`` to ``far_z``."""
    first = lesser(low / near_z, low / far_z) * floats(focal) + floats(centre)
    last = greater(high / near_z, high / far_z) * floats(focal) + floats(centre)
    slack = floats(_PIXEL_SLACK)
    return first - slack - floats(SLACK) * absolute(first), last + slack + floats(SLACK) * absolute(last)


@inline
def _rectangle_at(depth: Any, tables: Any, start: Any, alignment: Any) -> Any:
    """Return left, right, top, bottom (tactile pixels) and the range of z that tiles see at one depth, metres."""
    plane, camera, translation = tables.shape[0] // 6, alignment.camera, alignment.translation_m
    z_low, z_high = _transformed(
        load(tables, 4 * plane + start), load(tables, 5 * plane + start), depth, translation[2]
    )  # fmt: skip
    x_low, x_high = _transformed(load(tables, start), load(tables, plane + start), depth, translation[0])
    y_low, y_high = _transformed(
        load(tables, 2 * plane + start), load(tables, 3 * plane + start), depth, translation[1]
    )  # fmt: skip
    left, right = _pixel_range(x_low, x_high, z_low, z_high, camera[0], camera[2])
    top, bottom = _pixel_range(y_low, y_high, z_low, z_high, camera[1], camera[3])
    return left, right, top, bottom, z_low, z_high


@inline
def _tile_of(pixel: Any, step: Any, count: Any) -> Any:
    """Return the tile (row or column) of a pixel coordinate, clipped to the image."""
    limited = lesser(greater(pixel, floats(_ZERO)), floats(_FARTHEST_PIXEL))
    tile = to_ints(floor((limited + floats(_HALF)) * floats(np.float32(1.0 / step))))
    return where(tile > ints(np.int32(count - 1)), ints(np.int32(count - 1)), tile)


@inline
def _measured_within(low_count: Any, high_count: Any, lowest: Any, highest: Any, alignment: Any) -> Any:
    """Tell for one tactile tile (scalars) whether its range of counts reaches into a range of depths."""
    a = np.float32(low_count) * alignment.tactile_unit_m + alignment.tactile_offset_m
    b = np.float32(high_count) * alignment.tactile_unit_m + alignment.tactile_offset_m
    return low_count <= high_count and min(a, b) <= highest and max(a, b) >= lowest


@inline
def _any_reaches(corners: Any, lane: Any, lowest: Any, highest: Any, tactile: Any, columns: Any, alignment: Any) -> Any:
    """Tell whether any tactile tile of a lane's rectangle has a depth from ``lowest`` to ``highest``."""
    found = False
    for row in range(corners[2 * LANES + lane], corners[3 * LANES + lane] + 1):
        if found:
            break
        for column in range(corners[lane], corners[LANES + lane] + 1):
            tile = row * columns + column
            if _measured_within(tactile[0, tile], tactile[1, tile], lowest, highest, alignment):
                found = True
                break
    return found


@inline
def _proximity_range(ranges: Any, start: Any, alignment: Any, limits: Any) -> Any:
    """Return the proximity depths of tiles within the limits, from near to far, metres, and whether there are any."""
    low, high = load(ranges[0], start), load(ranges[1], start)
    near = greater(to_floats(low) * floats(alignment.proximity_unit_m), floats(limits.nearest_m))
    far = lesser(to_floats(high) * floats(alignment.proximity_unit_m), floats(limits.farthest_m))
    return near, far, (low <= high) & (near <= far)


@inline
def _seen_at(near: Any, far: Any, tables: Any, start: Any, plane: Any, alignment: Any) -> Any:
    """Return left, right, top, bottom (tactile pixels) and the range of expected depths of tiles from near to far."""
    if alignment.rigid:
        left, right, top, bottom, low, high = _rectangle_at(near, tables, start, alignment)
        far_left, far_right, far_top, far_bottom, far_low, far_high = _rectangle_at(far, tables, start, alignment)
        left, right = lesser(left, far_left), greater(right, far_right)
        top, bottom = lesser(top, far_top), greater(bottom, far_bottom)
        low, high = lesser(low, far_low), greater(high, far_high)
    else:
        left, right = load(tables, start), load(tables, plane + start)
        top, bottom = load(tables, 2 * plane + start), load(tables, 3 * plane + start)
        low, high = near, far
    return left, right, top, bottom, low, high


@inline
def _square_reaches(spread: Any, place: Any, lowest: Any, highest: Any, alignment: Any) -> Any:
    """Tell whether the squares of `_SPAN` tiles at ``place`` have a depth from ``lowest`` to ``highest``."""
    low, high = gather(spread[2], place), gather(spread[3], place)
    a = to_floats(low) * floats(alignment.tactile_unit_m) + floats(alignment.tactile_offset_m)
    b = to_floats(high) * floats(alignment.tactile_unit_m) + floats(alignment.tactile_offset_m)
    return (lesser(a, b) <= highest) & (greater(a, b) >= lowest) & (low <= high)


@inline
def _measure_ranges(images: Any, size: Any, tiles: Any, buffers: Any) -> None:
    """Fill the buffers with the ranges of counts of all tiles of both images."""
    lows, highs = buffers.proximity[0], buffers.proximity[1]
    _ranges_of_tiles(images.proximity, size.width, size.height, lows, highs)
    for i in range(tiles.size, lows.shape[0]):
        lows[i] = 1
        highs[i] = 0
    rows, columns = _tile_grid(size.tactile_width, size.tactile_height)
    _ranges_of_tiles(
        images.tactile, size.tactile_width, size.tactile_height, buffers.tactile[0], buffers.tactile[1]
    )  # fmt: skip
    _spread(buffers.tactile, buffers.spread, rows * columns, columns)


@kernel
def _mark_tiles(images: Any, alignment: Any, tables: Any, limits: Any, margin: Any, buffers: Any, tiles: Any) -> Any:
    """Write which tiles may hold contact, `LANES` tiles at once; return their number.

    Parameters
    ----------
    images, alignment, limits, buffers : DepthImages, AlignmentTables, DepthLimits, TileBuffers
    tables : float32, flat
        As `CoarseTest` makes them: for the rigid model least and largest x, y and z of the rotated rays of each tile;
        for a homography left, right, top and bottom of the tactile pixels that each tile looks up.
    margin : float32
        Metres that both depths may differ beyond the tolerance.
    tiles : bool, shape (rows, columns)
    """
    size = alignment.size
    tactile_rows, tactile_columns = _tile_grid(size.tactile_width, size.tactile_height)
    _measure_ranges(images, size, tiles, buffers)
    flat_tiles, plane = tiles.reshape(tiles.size), buffers.proximity.shape[1]
    corners, lowest_of, highest_of = _corners(), _lowest(), _highest()
    active = 0
    for start in range(0, plane, LANES):
        for i in range(start, min(start + LANES, flat_tiles.shape[0])):
            flat_tiles[i] = False
        near, far, has_depth = _proximity_range(buffers.proximity, start, alignment, limits)
        if bits(has_depth) == 0:
            continue
        left, right, top, bottom, expected_low, expected_high = _seen_at(near, far, tables, start, plane, alignment)
        too_near = has_depth & (expected_low < floats(_MIN_Z)) if alignment.rigid else flags(0)
        sees = (right >= floats(-_HALF)) & (left < floats(np.float32(size.tactile_width) - _HALF)) & (left <= right)
        sees = sees & (bottom >= floats(-_HALF)) & (top < floats(np.float32(size.tactile_height) - _HALF))
        lowest, highest = accepted_range(expected_low, expected_high, limits.tolerance, margin)

        # First all lanes at once, by the range of depths over a square of tiles that holds the rectangle.
        first_column, last_column = _tile_of(left, LANES, tactile_columns), _tile_of(right, LANES, tactile_columns)
        first_row, last_row = _tile_of(top, TILE_ROWS, tactile_rows), _tile_of(bottom, TILE_ROWS, tactile_rows)
        fits = (last_column - first_column < ints(np.int32(_SPAN))) & (last_row - first_row < ints(np.int32(_SPAN)))
        place = first_row * ints(np.int32(tactile_columns)) + first_column
        place = where(has_depth & ~too_near, place, ints(_NOTHING))
        reaches = _square_reaches(buffers.spread, place, lowest, highest, alignment)
        remaining = bits(has_depth & (too_near | (sees & (reaches | ~fits))))
        if remaining == 0:
            continue

        # Then each remaining lane, by the ranges of the rectangle's own tiles.
        store(corners, 0, first_column)
        store(corners, LANES, last_column)
        store(corners, 2 * LANES, first_row)
        store(corners, 3 * LANES, last_row)
        store(lowest_of, 0, lowest)
        store(highest_of, 0, highest)
        certain = bits(too_near)
        while remaining != 0:
            lane = count_trailing_zeros(remaining)
            remaining &= remaining - 1
            if (certain >> lane) & 1 == 1 or _any_reaches(
                corners, lane, lowest_of[lane], highest_of[lane], buffers.tactile, tactile_columns, alignment
            ):
                flat_tiles[start + lane] = True
                active += 1
    return active


@kernel
def _spread(ranges: Any, spread: Any, count: Any, columns: Any) -> None:
    """Write the range of each tile with its neighbours to the right, then with those below as well.

    At the end of a row the neighbours are the first tiles of the next row. The range is then too wide, which is safe.
    """
    for i in range(0, count + _SPAN * columns, LANES):
        low, high = load(ranges[0], i), load(ranges[1], i)
        for other in range(1, _SPAN):
            low = lesser(low, load(ranges[0], i + other))
            high = greater(high, load(ranges[1], i + other))
        store(spread[0], i, low)
        store(spread[1], i, high)
    for i in range(0, count, LANES):
        low, high = load(spread[0], i), load(spread[1], i)
        for other in range(1, _SPAN):
            low = lesser(low, load(spread[0], i + other * columns))
            high = greater(high, load(spread[1], i + other * columns))
        store(spread[2], i, low)
        store(spread[3], i, high)
