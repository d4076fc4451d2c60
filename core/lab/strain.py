"""Membrane strain from a printed grid of dots, seen in one colour and depth image (Yin et al.).

Dots are dark spots against the bare sheet; their centroids are ordered to rows and columns, and lifted to space by the
smoothed depth image. The strain of a neighbour pair is the median over the pairs around it. In single frames the
largest strains are within 4 points (RMS) of the simulator's, in averages of still frames within 2.5.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import cv2
import numpy as np
from scipy.spatial import cKDTree

from ..calibration.snapshots import take_snapshot
from ..errors import TactuneError
from ..model.arrays import AnyArray, BoolArray, Float64Array, IndexArray, Int64Array, spread
from ..model.clouds import valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame

#: Default distance of neighbouring dots on the flat sheet, metres.
SPACING_M: Final = 0.010
#: Largest diameters of dots that are tried, pixels; the one that orders most dots is used.
_DOT_WIDTHS_PX: Final = (11, 21, 41)
#: A dot is darker than the sheet around it by more than this, 0 to 255, and by this share of the darkest dots.
_LEAST_CONTRAST, _CONTRAST_SHARE = 12.0, 0.4
#: A dot has at least this many pixels, and its sides differ by at most this factor.
_LEAST_AREA_PX, _LONGEST_SHAPE = 3, 4.0
#: A grid has at least this many ordered dots.
_MIN_DOTS: Final = 16
#: Sigma of the Gaussian that smooths depth, pixels, and the least share of its weight that has depth.
_SIGMA_PX, _SEEN_SHARE = 4.0, 0.3
#: Neighbours differ in depth by less than this, relative to their distance across the image: else a step lies between.
_STEEPEST: Final = 2.0
#: Strains beyond these do not come from a pair of neighbours.
_LEAST_STRAIN, _MOST_STRAIN = -0.5, 2.0

#: The membrane has moved if two tiles of this side length, pixels, change by more than this number of standard
#: deviations of their noise, or if the mean square of all tiles exceeds that of noise by this factor.
_TILE_PX, _MOVED_SIGMAS, _MOVED_FACTOR = 32, 6.0, 2.0

Cell = tuple[int, int]
#: Where a dot is in the grid: piece, row and column. Steep walls may cut the grid into pieces with rows of their own.
Place = tuple[int, int, int]
#: Largest distance of a dot from its predicted place, in lattice steps.
_REACH: Final = 0.38
#: Expected places of a seed's neighbours, in lattice steps, and the largest distance from them. Dots that are not
#: ordered by the first pattern, such as the few on top of a pressed object, are tried with the four nearest alone.
_SEEDS: Final = (
    (((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)), 0.16),
    (((-1, 0), (0, -1), (0, 1), (1, 0)), 0.16),
)
#: Pieces with fewer dots are dropped.
_MIN_PIECE: Final = 9
_NEIGHBOURS: Final = 12
_STEPS: Final = ((0, 1), (0, -1), (1, 0), (-1, 0))
#: Tells whether two dots, given by index, may be neighbours.
Linked = Callable[[int, int], bool]


class StrainError(TactuneError):
    """A frame in which strain cannot be measured."""


@dataclass(frozen=True, eq=False)
class AxisStrain:
    """Strain along one direction of the grid: neighbour pairs (M, 2), their strain (M,), and the largest one."""

    pairs: Int64Array
    strain: Float64Array

    @property
    def largest(self) -> float:
        return float(self.strain.max())


@dataclass(frozen=True, eq=False)
class StrainMeasurement:
    """Strain of one frame, measured at dots seen by the tactile camera."""

    #: (N, 2): centroids of the dots that have a place in the grid.
    pixels: Float64Array
    #: Along the rows, the direction nearer to the image's u axis, and along the columns.
    length: AxisStrain
    width: AxisStrain


def measure_strain(frame: SensorFrame, rig: Rig, spacing_m: float = SPACING_M) -> StrainMeasurement:
    frame.check_against(rig)
    if frame.tactile_color is None or frame.tactile_color.shape[:2] != frame.tactile_depth.shape:
        raise StrainError(
            f"frame {frame.sequence} has no tactile colour image of the depth image's size; record it, aligned to depth"
        )
    depth_m = _smooth_depth_m(frame, rig.tactile)
    if not np.isfinite(depth_m).any():
        raise StrainError(f"frame {frame.sequence} has no tactile depth; check the tactile camera and its range")
    pixels, places = _find_grid(frame, depth_m, rig.tactile)
    points_m = _lift(pixels, depth_m, rig.tactile)
    axes = [_axis_strain(places, step, points_m, spacing_m) for step in ((0, 1), (1, 0))]
    for axis, name in zip(axes, ("length", "width"), strict=True):
        if len(axis.pairs) == 0:
            raise StrainError(f"frame {frame.sequence}: no neighbouring dots along the {name} have depth")
    return StrainMeasurement(pixels, *axes)


def average_still(frames: Sequence[SensorFrame]) -> tuple[SensorFrame, int]:
    """Return the pixelwise median of the newest frame and those before it while the membrane rests, and how many."""
    newest, still = frames[-1], [frames[-1]]
    for frame in reversed(frames[:-1]):
        if (frame.tactile_color is None) != (newest.tactile_color is None) or _moved(frame, newest):
            break
        still.append(frame)
    if len(still) == 1:
        return newest, 1
    median = replace(
        take_snapshot(still).frame,
        sequence=newest.sequence,
        proximity_time_s=newest.proximity_time_s,
        tactile_time_s=newest.tactile_time_s,
        truth=newest.truth,
    )
    return median, len(still)


def _moved(frame: SensorFrame, newest: SensorFrame) -> bool:
    """Tell whether the membrane moved by more than noise: that of a tile minus the mean of its neighbours."""
    before, now = frame.tactile_depth, newest.tactile_depth
    known = valid_depth(before) & valid_depth(now)
    moved = np.where(known, 1.0 / np.maximum(now, 1) - 1.0 / np.maximum(before, 1), 0.0)
    height, width = (size // _TILE_PX for size in known.shape)
    share, total = (
        cv2.resize(image[: height * _TILE_PX, : width * _TILE_PX], (width, height), interpolation=cv2.INTER_AREA)
        for image in (known.astype(np.float64), moved)
    )
    change = np.where(share >= 0.5, total / np.maximum(share, 1e-9), np.nan)
    aside = (change[:-2] + change[2:]) / 2 - change[1:-1], (change[:, :-2] + change[:, 2:]) / 2 - change[:, 1:-1]
    noise = np.concatenate([part[np.isfinite(part)] for part in aside])
    change = change[np.isfinite(change)]
    if not noise.size:
        return bool(change.any())
    sigmas = change / max(spread(noise) / math.sqrt(1.5), np.finfo(float).tiny)
    return bool(np.count_nonzero(np.abs(sigmas) > _MOVED_SIGMAS) > 1 or np.mean(sigmas**2) > _MOVED_FACTOR)


def _smooth_depth_m(frame: SensorFrame, camera: DepthCamera) -> Float64Array:
    """Return the tactile depth, smoothed by a Gaussian over the pixels that have one; nan where few have."""
    known = valid_depth(frame.tactile_depth)
    depth_m = np.where(known, frame.tactile_depth * camera.depth_unit_m, 0.0)
    weight, total = (cv2.GaussianBlur(image.astype(np.float64), (0, 0), _SIGMA_PX) for image in (known, depth_m))
    return np.where(weight >= _SEEN_SHARE, total / np.maximum(weight, 1e-9), np.nan)


def _lift(pixels: Float64Array, depth_m: Float64Array, camera: DepthCamera) -> Float64Array:
    """Return the points of pixels (N, 2) in the camera's frame, metres, (N, 3)."""
    column, row = np.rint(pixels).astype(np.intp).T
    return np.column_stack([camera.intrinsics.normalise(pixels), np.ones(len(pixels))]) * depth_m[row, column, None]


def _find_grid(frame: SensorFrame, depth_m: Float64Array, camera: DepthCamera) -> tuple[Float64Array, list[Place]]:
    """Return the centroids of the dots that have a place in the grid, and their places."""
    assert frame.tactile_color is not None  # `measure_strain` has checked
    gray = cv2.cvtColor(np.ascontiguousarray(frame.tactile_color), cv2.COLOR_RGB2GRAY)
    best = np.empty((0, 2)), list[Place]()
    for width_px in _DOT_WIDTHS_PX:
        pixels = _dark_spots(gray, width_px)
        if len(pixels) < _MIN_DOTS:
            continue
        points_m = _lift(pixels, depth_m, camera)

        def on_one_surface(a: int, b: int, points_m: Float64Array = points_m) -> bool:
            x, y, z = points_m[a] - points_m[b]
            return bool(abs(z) < _STEEPEST * math.hypot(x, y))

        found = order_dots(pixels, on_one_surface)
        if len(found) > len(best[1]):
            best = pixels[list(found.values())], list(found)
    if len(best[1]) < _MIN_DOTS:
        raise StrainError(f"frame {frame.sequence} shows no grid of dots; they must be dark, sharp, 3 px wide or more")
    return best


def _dark_spots(gray: AnyArray, width_px: int) -> Float64Array:
    """Return the centroids, (N, 2), of spots up to this wide that are darker than what is around them."""
    shape = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width_px, width_px))
    darker = cv2.GaussianBlur(cv2.morphologyEx(gray, cv2.MORPH_BLACKHAT, shape).astype(np.float32), (0, 0), 0.8)
    least = max(_LEAST_CONTRAST, _CONTRAST_SHARE * float(np.percentile(darker, 99)))
    count, labels, stats, _ = cv2.connectedComponentsWithStats((darker > least).astype(np.uint8))
    v, u = np.indices(gray.shape)
    total, sum_u, sum_v = (np.bincount(labels.ravel(), (darker * by).ravel(), count) for by in (1.0, u, v))
    sides = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
    dots = (stats[:, cv2.CC_STAT_AREA] >= _LEAST_AREA_PX) & (sides.max(axis=1) <= width_px)
    dots &= sides.max(axis=1) <= _LONGEST_SHAPE * sides.min(axis=1)
    dots[0] = False
    return np.column_stack([sum_u[dots] / total[dots], sum_v[dots] / total[dots]])


def _axis_strain(places: list[Place], step: Cell, points_m: Float64Array, spacing_m: float) -> AxisStrain:
    """Return the strain of the neighbours one step apart, each the median over the pairs at most one step away."""
    numbers = {place: number for number, place in enumerate(places)}
    beside = [numbers.get((piece, row + step[0], column + step[1]), -1) for piece, row, column in places]
    pairs = np.column_stack([np.arange(len(places)), beside]).astype(np.int64)
    pairs = pairs[pairs[:, 1] >= 0]
    raw = np.linalg.norm(points_m[pairs[:, 1]] - points_m[pairs[:, 0]], axis=1) / spacing_m - 1.0
    with np.errstate(invalid="ignore"):
        possible = (raw > _LEAST_STRAIN) & (raw < _MOST_STRAIN)
    pairs, raw = pairs[possible], raw[possible]
    known = {places[first]: strain for first, strain in zip(pairs[:, 0], raw.tolist(), strict=True)}
    around = list(product((-1, 0, 1), repeat=2))
    smooth = [
        np.median([known[at] for down, right in around if (at := (piece, row + down, column + right)) in known])
        for piece, row, column in known
    ]
    return AxisStrain(pairs, np.array(smooth, np.float64))


# Rows and columns: region growing from seeds along local lattice vectors


def order_dots(pixels: Float64Array, linked: Linked) -> dict[Place, int]:
    """Return the dots by their places: a piece grows from a dot with symmetric neighbours by the best predicted one."""
    free = np.ones(len(pixels), bool)
    axes: tuple[Float64Array, Float64Array] | None = None  # of the first piece
    found: dict[Place, int] = {}
    for looked, (steps, reach) in enumerate(_SEEDS):
        left = np.flatnonzero(free)
        if len(left) < _MIN_PIECE or (looked and len(left) > len(pixels) / 2):  # chance alone orders a few spots
            break
        tree = cKDTree(pixels[left])
        for _, number, right, down in sorted(_seeds(pixels[left], tree, steps, reach), key=lambda entry: entry[0]):
            if not free[left[number]]:
                continue
            vectors = _like(axes, right, down) if axes else (right, down)
            piece = _grow(pixels, left, tree, free, linked, int(left[number]), vectors)
            if len(piece) >= _MIN_PIECE:
                free[list(piece.values())] = False
                axes = axes or vectors
                found |= {(int(left[number]), *cell): dot for cell, dot in piece.items()}
    return found


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
        right, down = _like(tuple(np.eye(2)), first, around[np.argmax(aside)])  # what points right, and down
        wanted = np.array([i * right + j * down for i, j in steps])
        gaps = np.hypot(*(wanted[:, None] - around[None]).transpose(2, 0, 1)).min(axis=1)
        error = float(gaps.max()) / min(np.hypot(*right), np.hypot(*down))
        if error <= reach:
            yield error, dot, right, down


def _like(axes: Sequence[Float64Array], right: Float64Array, down: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return both vectors ordered and signed like two others."""
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
) -> dict[Cell, int]:
    """Grow a piece from a seed, always by the dot nearest to its prediction. ``left`` maps tree indices to dots."""
    piece: dict[Cell, int] = {}
    taken: set[int] = set()
    waiting: list[tuple[float, int, Cell, int]] = [(0.0, seed, (0, 0), seed)]
    while waiting:
        _, dot, cell, _ = heapq.heappop(waiting)
        if dot in taken or cell in piece:
            continue
        piece[cell] = dot
        taken.add(dot)
        for step in _STEPS:
            beside = cell[0] + step[0], cell[1] + step[1]
            if beside in piece:
                continue
            vector = _vector(pixels, piece, cell, step, vectors)
            gap, number = tree.query(pixels[dot] + vector)
            candidate = int(left[number])
            error = float(gap) / float(np.hypot(*vector))
            if error <= _REACH and free[candidate] and linked(dot, candidate):
                heapq.heappush(waiting, (error, candidate, beside, dot))
    return piece


def _vector(
    pixels: Float64Array, piece: dict[Cell, int], cell: Cell, step: Cell, vectors: tuple[Float64Array, Float64Array]
) -> Float64Array:
    """Return the predicted step from a cell to its neighbour: the mean of parallel steps nearby."""
    row, column = cell
    ways = []
    for by in ((-step[0], -step[1]), (step[1], step[0]), (-step[1], -step[0])):  # behind, and on both sides
        start = row + by[0], column + by[1]
        end = start[0] + step[0], start[1] + step[1]
        if start in piece and end in piece:
            ways.append(pixels[piece[end]] - pixels[piece[start]])
    if ways:
        return np.asarray(np.mean(ways, axis=0))
    right, down = vectors
    return step[1] * right + step[0] * down
