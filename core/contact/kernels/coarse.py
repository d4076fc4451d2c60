"""Finds the tiles of an image that cannot hold contact, from the ranges of depth in tiles of both images.

The answer is certain: every bound is widened by more than float32 can be wrong. A proximity tile sees,
over all its rays and its range of depth, a rectangle of the tactile image; if no tactile depth in
there comes within the tolerance of any depth expected there, no pixel of the tile passes the test.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.arrays import AnyArray, BoolArray, Float32Array, Int32Array, Uint16Array
from ..alignment import AlignmentModel
from .chain import TILE_ROWS
from .compiling import inline, kernel
from .lenses import PINHOLE
from .simd import (
    LANES,
    absolute,
    bits,
    count_trailing_zeros,
    counts,
    flags,
    floats,
    floor,
    greater,
    greater_counts,
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
from .simd_memory import float_scratch, gather, int_scratch

#: So many neighbouring tiles are looked at together at first; a rectangle rarely spans more.
_SPAN = 3

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE_COUNT = np.uint16(1)
_NO_COUNT, _ALL_COUNTS = np.uint16(0), np.uint16(65535)
#: Wider than rounding by a factor of ten at least: pixels, and shares of the terms of a sum.
_PIXEL_SLACK = np.float32(0.05)
_SLACK = np.float32(1e-5)
#: A tile with points nearer to the tactile camera's own plane is never ruled out, metres.
_LEAST_Z = np.float32(1e-6)
_FARTHEST_PIXEL = np.float32(1e6)
_box, _least, _most = int_scratch(4 * LANES), float_scratch(LANES), float_scratch(LANES)
_NOTHING, _ONE = np.int32(0), np.int32(1)


def tile_grid(width: int, height: int) -> tuple[int, int]:
    """Return how many rows and columns of tiles cover an image."""
    return -(-height // TILE_ROWS), -(-width // LANES)


class CoarseTest:
    """The test for one alignment model, with its tables and buffers. For one thread at a time."""

    def __init__(self, model: AlignmentModel) -> None:
        width, height, tactile_width, tactile_height = model.size
        rigid, _, planes, table, lens, _ = model.tables
        self.shape = tile_grid(width, height)
        self._all = np.ones(self.shape, np.bool_)
        # What a distorted lens makes of a rectangle is not enclosed by its corners.
        self.possible = not rigid or lens == PINHOLE
        if not self.possible:
            return
        self._model = model
        if rigid:
            parts = np.split(planes, 3)
            self._tables = np.concatenate([bound for part in parts for bound in _bounds(part, width, height)])
        else:
            rectangles = _rectangles(table, width, height, tactile_width)
            self._tables = np.concatenate([_filled(bound.astype(np.float32)) for bound in rectangles])
        cell_rows, cell_columns = tile_grid(tactile_width, tactile_height)
        room = (cell_rows + 2 * _SPAN) * cell_columns + 2 * LANES
        self._ranges = np.empty((2, _room(self.shape)), np.int32)
        # Beyond the last tile there is no depth.
        self._cells = np.full((2, room), [[1 << 16], [-1]], np.int32)
        self._wide = np.full((4, room), [[1 << 16], [-1]] * 2, np.int32)
        self._tiles = np.empty(self.shape, np.bool_)

    def tiles(
        self,
        proximity: Uint16Array,
        tactile: Uint16Array,
        limits: Float32Array,
        margin_m: float = 0.0,
    ) -> tuple[BoolArray, int]:
        """Return which tiles may hold contact, and how many; the array is used again next time.

        Parameters
        ----------
        proximity, tactile : uint16, flat
        limits : float32
            As in `kernels.classify_rows`.
        margin_m : float
            By how much both depths may differ beyond the tolerance.
        """
        if not self.possible:
            return self._all, self._all.size
        count = _mark_tiles(
            proximity, tactile, self._model.size, self._model.tables, self._tables, limits, np.float32(margin_m),
            self._ranges, self._cells, self._wide, self._tiles,
        )  # fmt: skip
        return self._tiles, count


def _room(shape: tuple[int, int]) -> int:
    return -(-shape[0] * shape[1] // LANES) * LANES


def _filled(tiles: AnyArray) -> AnyArray:
    """Return values by tile in a row, filled up to whole vectors."""
    return np.pad(tiles.ravel(), (0, _room(tiles.shape) - tiles.size), mode="edge")


def _blocks(image: AnyArray, filling: Any) -> AnyArray:
    """Return an image (H, W) as tiles (rows, columns, pixels)."""
    rows, columns = tile_grid(image.shape[1], image.shape[0])
    padded = np.full((rows * TILE_ROWS, columns * LANES), filling, image.dtype)
    padded[: image.shape[0], : image.shape[1]] = image
    tiles = padded.reshape(rows, TILE_ROWS, columns, LANES).swapaxes(1, 2)
    return tiles.reshape(rows, columns, -1)


def _bounds(plane: Float32Array, width: int, height: int) -> list[Float32Array]:
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
def _take_in(low: Any, high: Any, count: Any) -> Any:
    """Take counts into ranges that are off by one: wrapping takes both invalid counts out of the way."""
    return lesser_counts(low, count - counts(_ONE_COUNT)), greater_counts(high, count + counts(_ONE_COUNT))


@kernel
def _ranges_of_tiles(image: Any, width: Any, height: Any, lows: Any, highs: Any) -> None:
    """Write least and largest valid count of each tile; the first is the larger where there is none.

    Two tiles at once are a cache line. Near the image's end vectors begin earlier and take neighbours in.
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
                    low, high = _take_in(low, high, load_counts(image, place))
                    next_low, next_high = _take_in(next_low, next_high, load_counts(image, place + LANES))
                    place += width
            else:
                for _ in range(first, min(first + TILE_ROWS, height)):
                    low, high = _take_in(low, high, load_counts(image, min(place, last_place)))
                    beside = load_counts(image, min(place + LANES, last_place))
                    next_low, next_high = _take_in(next_low, next_high, beside)
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
    """Take a sum of two terms into a range, with its rounding."""
    both = a + b
    slack = floats(_SLACK) * (absolute(a) + absolute(b))
    return lesser(low, both - slack), greater(high, both + slack)


@inline
def _pixel_range(low: Any, high: Any, near_z: Any, far_z: Any, focal: Any, centre: Any) -> Any:
    """Return the range of pixel coordinates of ``low`` to ``high`` over ``near_z`` to ``far_z``."""
    first = lesser(low / near_z, low / far_z) * floats(focal) + floats(centre)
    last = greater(high / near_z, high / far_z) * floats(focal) + floats(centre)
    slack = floats(_PIXEL_SLACK)
    return first - slack - floats(_SLACK) * absolute(first), last + slack + floats(_SLACK) * absolute(last)


@inline
def _cell(pixel: Any, step: Any, count: Any) -> Any:
    """Return the tile of a pixel coordinate, cut to the image."""
    limited = lesser(greater(pixel, floats(_ZERO)), floats(_FARTHEST_PIXEL))
    cell = to_ints(floor((limited + floats(_HALF)) * floats(np.float32(1.0 / step))))
    return where(cell > ints(np.int32(count - 1)), ints(np.int32(count - 1)), cell)


@kernel
def _mark_tiles(
    proximity: Any, tactile: Any, size: Any, model: Any, tables: Any, limits: Any, margin: Any, ranges: Any,
    cells: Any, wide: Any, tiles: Any
) -> Any:  # fmt: skip
    width, height, tactile_width, tactile_height = size
    rigid, units, _, _, _, camera = model
    rows, columns = tiles.shape
    cell_rows = (tactile_height + TILE_ROWS - 1) // TILE_ROWS
    cell_columns = (tactile_width + LANES - 1) // LANES
    lows, highs = ranges[0], ranges[1]
    _ranges_of_tiles(proximity, width, height, lows, highs)
    for i in range(rows * columns, lows.shape[0]):
        lows[i] = 1
        highs[i] = 0
    _ranges_of_tiles(tactile, tactile_width, tactile_height, cells[0], cells[1])
    _spread(cells, wide, cell_rows * cell_columns, cell_columns)
    wide_low, wide_high = wide[2], wide[3]

    flat_tiles = tiles.reshape(tiles.size)
    room = lows.shape[0]
    box, least, most = _box(), _least(), _most()
    active = 0
    for start in range(0, room, LANES):
        low = load(lows, start)
        high = load(highs, start)
        near = greater(to_floats(low) * floats(units[0]), floats(limits[0]))
        far = lesser(to_floats(high) * floats(units[0]), floats(limits[1]))
        open_tiles = (low <= high) & (near <= far)
        if bits(open_tiles) == 0:
            for i in range(start, min(start + LANES, flat_tiles.shape[0])):
                flat_tiles[i] = False
            continue
        always = flags(0)
        if rigid:
            huge = floats(np.float32(np.inf))
            dx_low, dx_high = load(tables, start), load(tables, room + start)
            dy_low, dy_high = load(tables, 2 * room + start), load(tables, 3 * room + start)
            dz_low, dz_high = load(tables, 4 * room + start), load(tables, 5 * room + start)
            tx, ty, tz = floats(units[3]), floats(units[4]), floats(units[5])
            z_low, z_high = _widen(huge, floats(_ZERO) - huge, dz_low * near, tz)
            z_low, z_high = _widen(z_low, z_high, dz_high * near, tz)
            far_low, far_high = _widen(huge, floats(_ZERO) - huge, dz_low * far, tz)
            far_low, far_high = _widen(far_low, far_high, dz_high * far, tz)
            always = open_tiles & (lesser(z_low, far_low) < floats(_LEAST_Z))
            x_low, x_high = _widen(huge, floats(_ZERO) - huge, dx_low * near, tx)
            x_low, x_high = _widen(x_low, x_high, dx_high * near, tx)
            y_low, y_high = _widen(huge, floats(_ZERO) - huge, dy_low * near, ty)
            y_low, y_high = _widen(y_low, y_high, dy_high * near, ty)
            left, right = _pixel_range(x_low, x_high, z_low, z_high, camera[0], camera[2])
            top, bottom = _pixel_range(y_low, y_high, z_low, z_high, camera[1], camera[3])
            x_low, x_high = _widen(huge, floats(_ZERO) - huge, dx_low * far, tx)
            x_low, x_high = _widen(x_low, x_high, dx_high * far, tx)
            y_low, y_high = _widen(huge, floats(_ZERO) - huge, dy_low * far, ty)
            y_low, y_high = _widen(y_low, y_high, dy_high * far, ty)
            far_left, far_right = _pixel_range(x_low, x_high, far_low, far_high, camera[0], camera[2])
            far_top, far_bottom = _pixel_range(y_low, y_high, far_low, far_high, camera[1], camera[3])
            left, right = lesser(left, far_left), greater(right, far_right)
            top, bottom = lesser(top, far_top), greater(bottom, far_bottom)
            expected_low, expected_high = lesser(z_low, far_low), greater(z_high, far_high)
        else:
            left, right = load(tables, start), load(tables, room + start)
            top, bottom = load(tables, 2 * room + start), load(tables, 3 * room + start)
            expected_low, expected_high = near, far
        sees = (right >= floats(-_HALF)) & (left < floats(np.float32(tactile_width) - _HALF)) & (left <= right)
        sees = sees & (bottom >= floats(-_HALF)) & (top < floats(np.float32(tactile_height) - _HALF))

        tolerance = floats(limits[2])
        slack = floats(_SLACK) * greater(absolute(expected_low), absolute(expected_high)) + floats(margin)
        lowest = lesser(
            expected_low - tolerance * absolute(expected_low), expected_high - tolerance * absolute(expected_high)
        ) - slack  # fmt: skip
        highest = greater(
            expected_low + tolerance * absolute(expected_low), expected_high + tolerance * absolute(expected_high)
        ) + slack  # fmt: skip
        first_column = _cell(left, LANES, cell_columns)
        last_column = _cell(right, LANES, cell_columns)
        first_row = _cell(top, TILE_ROWS, cell_rows)
        last_row = _cell(bottom, TILE_ROWS, cell_rows)
        fits = (last_column - first_column < ints(np.int32(_SPAN))) & (last_row - first_row < ints(np.int32(_SPAN)))
        place = first_row * ints(np.int32(cell_columns)) + first_column
        place = where(open_tiles & ~always, place, ints(_NOTHING))
        cell_low, cell_high = gather(wide_low, place), gather(wide_high, place)
        one_end = to_floats(cell_low) * floats(units[1]) + floats(units[2])
        other_end = to_floats(cell_high) * floats(units[1]) + floats(units[2])
        reaches = (lesser(one_end, other_end) <= highest) & (greater(one_end, other_end) >= lowest)
        reaches = reaches & (cell_low <= cell_high)
        doubtful = open_tiles & (always | (sees & (reaches | ~fits)))
        remaining = bits(doubtful)
        certain = bits(always)
        for i in range(start, min(start + LANES, flat_tiles.shape[0])):
            flat_tiles[i] = False
        if remaining == 0:
            continue
        store(box, 0, first_column)
        store(box, LANES, last_column)
        store(box, 2 * LANES, first_row)
        store(box, 3 * LANES, last_row)
        store(least, 0, lowest)
        store(most, 0, highest)
        while remaining != 0:
            lane = count_trailing_zeros(remaining)
            remaining &= remaining - 1
            possible = (certain >> lane) & 1 == 1
            for row in range(box[2 * LANES + lane], box[3 * LANES + lane] + 1):
                if possible:
                    break
                for column in range(box[lane], box[LANES + lane] + 1):
                    low_count, high_count = cells[0, row * cell_columns + column], cells[1, row * cell_columns + column]
                    a = np.float32(low_count) * units[1] + units[2]
                    b = np.float32(high_count) * units[1] + units[2]
                    if low_count <= high_count and min(a, b) <= most[lane] and max(a, b) >= least[lane]:
                        possible = True
                        break
            if possible:
                flat_tiles[start + lane] = True
                active += 1
    return active


@kernel
def _spread(cells: Any, wide: Any, count: Any, columns: Any) -> None:
    """Write the range of each tile with its neighbours to the right, then with those below as well.

    At the end of a row the neighbours are the next row's first: a range too wide, which does no harm.
    """
    for i in range(0, count + _SPAN * columns, LANES):
        low, high = load(cells[0], i), load(cells[1], i)
        for other in range(1, _SPAN):
            low = lesser(low, load(cells[0], i + other))
            high = greater(high, load(cells[1], i + other))
        store(wide[0], i, low)
        store(wide[1], i, high)
    for i in range(0, count, LANES):
        low, high = load(wide[0], i), load(wide[1], i)
        for other in range(1, _SPAN):
            low = lesser(low, load(wide[0], i + other * columns))
            high = greater(high, load(wide[1], i + other * columns))
        store(wide[2], i, low)
        store(wide[3], i, high)
