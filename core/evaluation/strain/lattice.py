"""Row and column of each dot of a printed grid: region growing from seeds along local lattice vectors."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from ...model.arrays import BoolArray, Float64Array, IndexArray, Int64Array

Cell = tuple[int, int]

#: Largest distance of a dot from its predicted place, in lattice steps.
_REACH: Final = 0.38
#: Expected places of a seed's neighbours, in lattice steps, and the largest distance from them. Dots that are not
#: ordered by the first pattern, such as the few on top of a pressed object, are tried with the four nearest alone.
_SEEDS: Final = (
    (((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)), 0.16),
    (((-1, 0), (0, -1), (0, 1), (1, 0)), 0.16),
)
#: Pieces with fewer dots are dropped.
_MIN_DOTS: Final = 9
_NEIGHBOURS: Final = 12
_STEPS: Final = ((0, 1), (0, -1), (1, 0), (-1, 0))

#: Tells whether two dots, given by index, may be neighbours.
Linked = Callable[[int, int], bool]


@dataclass
class DotLattice:
    """Rows and columns of a grid. Steep walls may cut it into pieces, each with its own row and column numbers.

    Attributes
    ----------
    cells : int64, shape (N, 2)
        Row and column of each dot within its piece.
    piece : int64, shape (N,)
        Piece of each dot, numbered by descending size from 0; -1 for dots without a piece.
    """

    cells: Int64Array
    piece: Int64Array

    def neighbours(self, axis: int) -> Int64Array:
        """Return the indices of neighbouring dots, int64, shape (M, 2).

        Parameters
        ----------
        axis : int
            1: along the rows, from each column to the next; 0: along the columns.
        """
        places = {
            (int(piece), int(row), int(column)): number
            for number, (piece, (row, column)) in enumerate(zip(self.piece, self.cells, strict=True))
            if piece >= 0
        }
        down, right = (1, 0) if axis == 0 else (0, 1)
        pairs = [
            (number, places[piece, row + down, column + right])
            for (piece, row, column), number in places.items()
            if (piece, row + down, column + right) in places
        ]
        return np.array(pairs, np.int64).reshape(-1, 2)


@dataclass
class _Piece:
    """A growing piece: dot by cell, and cell by dot."""

    dots: dict[Cell, int] = field(default_factory=dict)
    cells: dict[int, Cell] = field(default_factory=dict)

    def put(self, cell: Cell, dot: int) -> None:
        self.dots[cell] = dot
        self.cells[dot] = cell


def order_dots(pixels: Float64Array, linked: Linked = lambda a, b: True) -> DotLattice:
    """Find rows and columns.

    A piece starts at a dot with eight symmetric neighbours. It then grows by the dot nearest to its predicted place;
    the prediction is the mean step between ordered dots nearby. Growth passes around missing dots. Rows are the
    direction nearer to the image's u axis.

    Parameters
    ----------
    pixels : float64, shape (N, 2)
    linked : callable
        Called with two indices; returns False if part of the surface between the dots is hidden.
    """
    cells, piece = np.zeros((len(pixels), 2), np.int64), np.full(len(pixels), -1, np.int64)
    free = np.ones(len(pixels), bool)
    axes: list[tuple[Float64Array, Float64Array]] = []
    found: list[_Piece] = []
    for looked, (steps, reach) in enumerate(_SEEDS):
        left = np.flatnonzero(free)
        if len(left) < _MIN_DOTS or (looked and len(left) > len(pixels) / 2):  # chance alone orders a few spots
            break
        tree = cKDTree(pixels[left])
        for _, number, right, down in sorted(_seeds(pixels[left], tree, steps, reach), key=lambda entry: entry[0]):
            if not free[left[number]]:
                continue
            vectors = _like(axes[0], right, down) if axes else (right, down)
            grown = _grow(pixels, left, tree, free, linked, int(left[number]), vectors)
            if len(grown.dots) >= _MIN_DOTS:
                free[list(grown.cells)] = False
                axes.append(vectors)
                found.append(grown)
    for number, grown in enumerate(sorted(found, key=lambda grown: -len(grown.dots))):
        for dot, cell in grown.cells.items():
            cells[dot], piece[dot] = cell, number
    return DotLattice(cells, piece)


def _seeds(
    pixels: Float64Array, tree: cKDTree, steps: Sequence[Cell], reach: float
) -> Iterator[tuple[float, int, Float64Array, Float64Array]]:
    """Yield seeds: irregularity of the neighbours in lattice steps, index of the dot, and both lattice vectors."""
    near = np.asarray(tree.query(pixels, min(_NEIGHBOURS + 1, len(pixels)))[1])
    for dot in range(len(pixels)):
        around = pixels[near[dot, 1:]] - pixels[dot]
        first = around[0]
        crossing = np.abs(first[0] * around[:, 1] - first[1] * around[:, 0])
        aside = crossing > 0.6 * np.hypot(*first) * np.hypot(*around.T)
        if not aside.any():
            continue
        right, down = _upright(first, around[np.argmax(aside)])
        wanted = np.array([i * right + j * down for i, j in steps])
        gaps = np.hypot(*(wanted[:, None] - around[None]).transpose(2, 0, 1)).min(axis=1)
        error = float(gaps.max()) / min(np.hypot(*right), np.hypot(*down))
        if error <= reach:
            yield error, dot, right, down


def _upright(first: Float64Array, second: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return both vectors ordered and signed: the one that points right, and the one that points down."""
    right, down = (
        (first, second) if abs(first[0]) * np.hypot(*second) >= abs(second[0]) * np.hypot(*first) else (second, first)
    )
    return right * (1 if right[0] >= 0 else -1), down * (1 if down[1] >= 0 else -1)


def _like(
    axes: tuple[Float64Array, Float64Array], right: Float64Array, down: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return both vectors ordered and signed like those of another piece."""
    if abs(float(right @ axes[0])) / np.hypot(*right) < abs(float(down @ axes[0])) / np.hypot(*down):
        right, down = down, right
    return right * (1 if right @ axes[0] >= 0 else -1), down * (1 if down @ axes[1] >= 0 else -1)


def _grow(
    pixels: Float64Array,
    left: IndexArray,
    tree: cKDTree,
    free: BoolArray,
    linked: Linked,
    seed: int,
    vectors: tuple[Float64Array, Float64Array],
) -> _Piece:
    """Grow a piece from a seed, always by the dot nearest to its prediction. ``left`` maps tree indices to dots."""
    piece = _Piece()
    waiting: list[tuple[float, int, Cell, int]] = [(0.0, seed, (0, 0), seed)]
    while waiting:
        _, dot, cell, _ = heapq.heappop(waiting)
        if dot in piece.cells or cell in piece.dots:
            continue
        piece.put(cell, dot)
        for step in _STEPS:
            beside = cell[0] + step[0], cell[1] + step[1]
            if beside in piece.dots:
                continue
            vector = _vector(pixels, piece, cell, step, vectors)
            gap, number = tree.query(pixels[dot] + vector)
            candidate = int(left[number])
            error = float(gap) / float(np.hypot(*vector))
            if error <= _REACH and free[candidate] and linked(dot, candidate):
                heapq.heappush(waiting, (error, candidate, beside, dot))
    return piece


def _vector(
    pixels: Float64Array, piece: _Piece, cell: Cell, step: Cell, vectors: tuple[Float64Array, Float64Array]
) -> Float64Array:
    """Return the predicted step from a cell to its neighbour: the mean of parallel steps nearby."""
    row, column = cell
    aside = (step[1], step[0])
    ways = []
    for start in (
        (row - step[0], column - step[1]),
        (row + aside[0], column + aside[1]),
        (row - aside[0], column - aside[1]),
    ):
        end = start[0] + step[0], start[1] + step[1]
        if start in piece.dots and end in piece.dots:
            ways.append(pixels[piece.dots[end]] - pixels[piece.dots[start]])
    if ways:
        return np.asarray(np.mean(ways, axis=0))
    right, down = vectors
    return step[1] * right + step[0] * down
