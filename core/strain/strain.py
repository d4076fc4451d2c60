"""Membrane strain from a printed grid of dots, seen in one colour and depth image (Yin et al.)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Final

import cv2
import numpy as np
from scipy.spatial import cKDTree

from ..errors import TactuneError
from ..model.arrays import BoolArray, Float64Array, IndexArray, Int64Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame
from .dots import DOT_WIDTHS_PX, Spots, find_dots
from .lattice import DotLattice, order_dots
from .surface import SeenSurface, dot_covariance, dot_points, surface_between, whole_dots

#: Distance of neighbouring dots on the flat sheet, metres, unless said otherwise.
SPACING_M: Final = 0.010
SPACING_RANGE_M: Final = (0.001, 0.1)
#: Dots in order below which there is no grid, and their share of all dark spots where they are.
_FEWEST_DOTS, _FEWEST_SHARE = 16, 0.5
#: A spot so near to the middle between two, as a share of their distance, lies between them.
_BETWEEN_SHARE: Final = 0.25
#: Spots of different sizes that are nearer are one.
_SAME_SPOT_PX: Final = 3.0
#: Depth is averaged over this much before indentations are compared, as a Gaussian's sigma, pixels.
_INDENTATION_SIGMA_PX: Final = 4.0
#: Half the sides of the squares of pairs over which strain is fitted, and the terms of the fits.
_REACHES: Final = ((1, 1), (1, 3), (2, 6), (3, 6))
#: A wider fit is believed while it agrees with the narrower ones within so many standard deviations.
_AGREES_WITHIN: Final = 3.5
_FEWEST_OVER_TERMS: Final = 3
#: A pair whose length over that of the pairs around it is beyond this, or one over it, is misread.
_LARGEST_RATIO: Final = 1.35
#: Rows and columns cross at right angles on the sheet. Where the cosine in space is beyond this, a diagonal of the
#: grid, or a spot that is no dot, has been taken for a side; and each side is crossed at least so often.
_LARGEST_COSINE: Final = 0.5
_FEWEST_CROSSINGS: Final = 2
#: What no average over neighbours takes away: noise that is fixed to the scene, and bends of the strain between dots.
_LASTING_SIGMA: Final = 0.007


class StrainError(TactuneError):
    """A frame in which strain cannot be measured."""


@dataclass(frozen=True, eq=False)
class StrainMeasurement:
    """Strain of one frame. All dots are in the tactile camera.

    Attributes
    ----------
    pixels : float64, shape (N, 2)
        Dots in order, ``(u, v)``.
    points_m : float64, shape (N, 3)
        The same in the tactile camera's frame; nan where there is no depth.
    lattice : DotLattice
        Rows, columns and pieces.
    length, width : AxisStrain
        Along the rows, which run more along u, and along the columns.
    """

    pixels: Float64Array
    points_m: Float64Array
    lattice: DotLattice
    length: AxisStrain
    width: AxisStrain

    @property
    def dots(self) -> int:
        """Number of dots in order."""
        return len(self.pixels)

    def at_dots(self) -> Float64Array:
        """Return the strain map: mean strain between each dot and its neighbours, along length and width.

        Returns
        -------
        float64, shape (N, 2)
            nan where there is no neighbour.
        """
        columns = []
        for axis in (self.length, self.width):
            ends = axis.pairs.ravel()
            count = np.bincount(ends, minlength=self.dots)
            total = np.bincount(ends, np.repeat(axis.strain, 2), minlength=self.dots)
            columns.append(np.where(count > 0, total / np.maximum(count, 1), np.nan))
        return np.column_stack(columns)


@dataclass(frozen=True, eq=False)
class _Grid:
    """Dots in order, where they are in space, and the neighbours along length and width that are believed."""

    surface: SeenSurface
    pixels: Float64Array
    points_m: Float64Array
    depth_sigma_m: Float64Array
    lattice: DotLattice
    sides: tuple[Int64Array, Int64Array]


def measure_strain(frame: SensorFrame, rig: Rig, spacing_m: float = SPACING_M) -> StrainMeasurement:
    """Measure strain from the grid of dots in a frame, as the tactile camera sees it.

    Parameters
    ----------
    frame : SensorFrame
        With a tactile colour image.
    rig : Rig
    spacing_m : float
        Distance of neighbouring dots on the flat sheet.

    Raises
    ------
    StrainError
        The frame has no tactile colour, or no grid is found, or there is no depth where it is.
    FrameError
        The frame belongs to another rig.
    """
    check_spacing(spacing_m)
    frame.check_against(rig)
    if frame.tactile_color is None:
        raise StrainError(
            f"frame {frame.sequence} has no tactile colour image; record the tactile camera's colour, too"
        )
    height, width = frame.tactile_color.shape[:2]
    if (height, width) != frame.tactile_depth.shape:
        raise StrainError(
            f"frame {frame.sequence}: the tactile colour image is {width} x {height} pixels, the depth image "
            f"{frame.tactile_depth.shape[1]} x {frame.tactile_depth.shape[0]}; align colour to depth"
        )
    camera = rig.tactile
    depth_m = _depth_m(frame.tactile_depth, camera)
    if not np.isfinite(depth_m).any():
        raise StrainError(f"frame {frame.sequence} has no tactile depth at all; check the tactile camera and its range")
    grid = _find_grid(frame, depth_m, camera)
    lattice = grid.lattice
    covariance_m2 = dot_covariance(grid.surface, grid.pixels, grid.points_m, grid.depth_sigma_m)
    places = np.column_stack([lattice.piece, lattice.cells])
    axes = []
    for pairs, name in zip(grid.sides, ("length", "width"), strict=True):
        strain = axis_strain(pairs, grid.points_m, covariance_m2, spacing_m, places)
        if len(strain.pairs) == 0:
            raise StrainError(
                f"frame {frame.sequence}: {len(grid.pixels)} dots are seen, but no neighbours along the {name} have "
                "depth; see that the tactile camera's depth covers the membrane"
            )
        axes.append(strain)
    return StrainMeasurement(grid.pixels, grid.points_m, lattice, *axes)


def check_spacing(spacing_m: float) -> None:
    """Refuse a spacing that cannot be meant.

    Raises
    ------
    StrainError
        It is not between 1 and 100 mm.
    """
    low, high = SPACING_RANGE_M
    if not (math.isfinite(spacing_m) and low <= spacing_m <= high):
        raise StrainError(
            f"the dots' spacing is {1e3 * spacing_m:g} mm; give the distance of neighbours on the flat sheet, "
            f"{1e3 * low:g} to {1e3 * high:g} mm"
        )


def indentation_m(frame: SensorFrame, untouched: SensorFrame, rig: Rig) -> float:
    """Return how far the membrane has come towards the tactile camera where it came farthest, metres.

    Noise is averaged over some pixels first; 0 where nothing came nearer.

    Raises
    ------
    StrainError
        The frames have no pixel with depth in common.
    """
    depths = [_depth_m(one.tactile_depth, rig.tactile) for one in (untouched, frame)]
    moved = depths[0] - depths[1]
    seen = np.isfinite(moved)
    if not seen.any():
        raise StrainError(
            f"frame {frame.sequence} and the untouched membrane have no pixel with tactile depth in common; "
            "check that the tactile camera sees the membrane"
        )
    weight, total = (
        cv2.GaussianBlur(image.astype(np.float64), (0, 0), _INDENTATION_SIGMA_PX)
        for image in (seen, np.where(seen, moved, 0.0))
    )
    return max(float((total / np.maximum(weight, 1e-9))[seen & (weight > 0.5)].max(initial=0.0)), 0.0)


def _depth_m(counts: Uint16Array, camera: DepthCamera) -> Float64Array:
    return np.where(valid_depth(counts), counts * camera.depth_unit_m, np.nan)


def _linked(depth_m: Float64Array, focal_px: float, pixels: Float64Array, first: int, second: int) -> bool:
    return surface_between(depth_m, focal_px, pixels[first], pixels[second])


def _usable(depth_m: Float64Array, focal_px: float, pixels: Float64Array, points: Float64Array) -> bool:
    """Whether two neighbours have places in space and the surface between them is seen."""
    return bool(np.isfinite(points).all()) and surface_between(depth_m, focal_px, pixels[0], pixels[1])


def _sides(
    lattice: DotLattice,
    depth_m: Float64Array,
    focal_px: float,
    pixels: Float64Array,
    points: Float64Array,
    all_spots: cKDTree,
) -> tuple[Int64Array, Int64Array]:
    """Return the neighbours along the length and along the width whose distance can be believed."""
    usable = []
    for axis in (1, 0):
        pairs = _without_one_between(lattice.neighbours(axis), pixels, all_spots)
        seen = [_usable(depth_m, focal_px, pixels[pair], points[pair]) for pair in pairs]
        usable.append(pairs[np.array(seen, bool)])
    along, across = usable
    return along[crossed(along, across, points)], across[crossed(across, along, points)]


def _without_one_between(pairs: Int64Array, pixels: Float64Array, all_spots: cKDTree) -> Int64Array:
    """Return the pairs that skip no dot: rows that have grown apart by a wrong step may do where they meet."""
    ends = pixels[pairs]
    gap, _ = all_spots.query(ends.mean(axis=1)) if len(pairs) else (np.empty(0), None)
    kept: Int64Array = pairs[gap > _BETWEEN_SHARE * np.hypot(*(ends[:, 1] - ends[:, 0]).T)]
    return kept


def _ordered_anew(
    lattice: DotLattice,
    loose: Int64Array,
    linked: Callable[[Float64Array, int, int], bool],
    pixels: Float64Array,
) -> DotLattice:
    """Put dots without a neighbour in order once more, among themselves.

    Where a piece has grown over a steep wall by a wrong step, everything behind is sheared by a row.
    """
    again = order_dots(pixels[loose], partial(linked, pixels[loose]))
    found = again.piece >= 0
    cells, piece = lattice.cells.copy(), lattice.piece.copy()
    cells[loose[found]] = again.cells[found]
    piece[loose[found]] = again.piece[found] + lattice.piece.max() + 1
    return DotLattice(cells, piece)


def _find_grid(frame: SensorFrame, depth_m: Float64Array, camera: DepthCamera) -> _Grid:
    """Return the dots in order, from the dot size, or all together, that gives most neighbours to believe."""
    assert frame.tactile_color is not None
    surface = SeenSurface.of(depth_m, camera.intrinsics)
    found = [find_dots(frame.tactile_color, width_px, surface) for width_px in DOT_WIDTHS_PX]
    grids = []
    for spots in [*found, _merged(found)]:
        lattice = order_dots(spots.pixels, partial(_linked, depth_m, camera.intrinsics.fx, spots.pixels))
        ordered = lattice.piece >= 0
        if ordered.sum() >= max(_FEWEST_DOTS, _FEWEST_SHARE * len(spots)):
            kept = DotLattice(lattice.cells[ordered], lattice.piece[ordered])
            tree = cKDTree(spots.pixels)
            grids.append(_in_space(spots.some(ordered), tree, kept, frame.tactile_depth, surface, camera))
    if not grids:
        most = max(map(len, found))
        raise StrainError(
            f"frame {frame.sequence}: no grid of dots is seen in the tactile colour image ({most} dark spots, not in "
            "rows and columns); print a square grid of dark dots on the membrane, lit evenly and in focus "
            "(simulated: sim:cup?grid=dots)"
        )
    return max(grids, key=lambda grid: sum(map(len, grid.sides)))


def _in_space(
    spots: Spots,
    all_spots: cKDTree,
    lattice: DotLattice,
    counts: Uint16Array,
    surface: SeenSurface,
    camera: DepthCamera,
) -> _Grid:
    """Bring dots into space, and those that no neighbour there confirms in order once more."""
    pixels, focal_px, depth_m = spots.pixels, camera.intrinsics.fx, surface.depth_m
    points, sigma = dot_points(counts, camera, pixels)
    sides = _sides(lattice, depth_m, focal_px, pixels, points, all_spots)
    loose = np.setdiff1d(np.arange(len(pixels)), np.concatenate(sides))
    lattice = _ordered_anew(lattice, loose, partial(_linked, depth_m, focal_px), pixels)
    whole = whole_dots(lattice, points, spots.area_m2, spots.at_step)
    sides = _sides(lattice, depth_m, focal_px, pixels, points, all_spots)
    along, across = (pairs[whole[pairs].all(axis=1)] for pairs in sides)
    return _Grid(surface, pixels, points, sigma, lattice, (along, across))


def _merged(found: list[Spots]) -> Spots:
    """Return spots of all sizes, each once."""
    together = found[0]
    for more in found[1:]:
        spots = more
        if len(together) and len(more):
            spots = more.some(np.asarray(cKDTree(together.pixels).query(more.pixels)[0] > _SAME_SPOT_PX))
        together = Spots(
            np.concatenate([together.pixels, spots.pixels]),
            np.concatenate([together.area_m2, spots.area_m2]),
            np.concatenate([together.at_step, spots.at_step]),
        )
    return together


@dataclass(frozen=True, eq=False)
class AxisStrain:
    """Strain along one direction of the grid.

    Attributes
    ----------
    pairs : int64, shape (M, 2)
        Numbers of neighbouring dots.
    strain : float64, shape (M,)
        Distance over spacing, minus 1, noise averaged.
    sigma : float64, shape (M,)
        Standard deviation of ``strain``.
    raw : float64, shape (M,)
        The same as ``strain`` from both dots alone.
    """

    pairs: Int64Array
    strain: Float64Array
    sigma: Float64Array
    raw: Float64Array

    @property
    def largest(self) -> float:
        """The largest strain."""
        return float(self.strain.max())

    @property
    def largest_sigma(self) -> float:
        """Standard deviation of the largest strain."""
        return float(self.sigma[np.argmax(self.strain)])


def axis_strain(
    pairs: Int64Array,
    points_m: Float64Array,
    covariance_m2: Float64Array,
    spacing_m: float,
    places: Int64Array,
) -> AxisStrain:
    """Compare distances between neighbours with their spacing on the flat sheet.

    Parameters
    ----------
    pairs : int64, shape (M, 2)
    points_m : float64, shape (N, 3)
        The dots in the camera's frame.
    covariance_m2 : float64, shape (N, 3, 3)
        How well each is known.
    spacing_m : float
    places : int64, shape (N, 3)
        Piece, row and column of each dot.
    """
    start, end = points_m[pairs[:, 0]], points_m[pairs[:, 1]]
    length = np.linalg.norm(end - start, axis=1)
    direction = (end - start) / length[:, None]
    both = covariance_m2[pairs[:, 0]] + covariance_m2[pairs[:, 1]]
    variance = np.einsum("ni,nij,nj->n", direction, both, direction)
    raw, sigma = length / spacing_m - 1.0, np.sqrt(variance) / spacing_m
    where = places[pairs[:, 0]]
    kept = _plausible(where, raw)
    pairs, raw, sigma, where = pairs[kept], raw[kept], sigma[kept], where[kept]
    strain, spread = _smoothed(where, raw, sigma)
    return AxisStrain(pairs, strain, np.hypot(spread, _LASTING_SIGMA), raw)


def crossed(pairs: Int64Array, crossing: Int64Array, points_m: Float64Array) -> BoolArray:
    """Tell which neighbours are crossed at their ends by neighbours of the other direction, nearly at right angles.

    Parameters
    ----------
    pairs, crossing : int64, shape (M, 2) and (K, 2)
        Of one direction and of the other.
    points_m : float64, shape (N, 3)

    Returns
    -------
    bool, shape (M,)
    """
    along, across = (_directions(points_m[ends]) for ends in (pairs, crossing))
    at: dict[int, list[int]] = {}
    for number, ends in enumerate(crossing):
        for dot in ends:
            at.setdefault(int(dot), []).append(number)
    kept = np.zeros(len(pairs), bool)
    for number, (start, end) in enumerate(pairs):
        met = at.get(int(start), []) + at.get(int(end), [])
        cosines = np.abs(across[met] @ along[number]).tolist()
        kept[number] = len(met) >= _FEWEST_CROSSINGS and median(cosines) <= _LARGEST_COSINE
    return kept


def _directions(ends: Float64Array) -> Float64Array:
    """Return unit vectors from the first to the second of points, shape (M, 2, 3)."""
    ways = ends[:, 1] - ends[:, 0]
    return np.asarray(ways / np.maximum(np.linalg.norm(ways, axis=1), 1e-12)[:, None])


def _around(where: Int64Array, number: int, reach: int) -> IndexArray:
    """Return the numbers of the pairs in a square around one, of the same piece."""
    apart = np.abs(where - where[number])
    return np.flatnonzero((apart[:, 0] == 0) & (apart[:, 1] <= reach) & (apart[:, 2] <= reach))


def _plausible(where: Int64Array, raw: Float64Array) -> BoolArray:
    """Tell the pairs whose length some neighbours on the grid confirm that are confirmed themselves."""
    kept, before = np.ones(len(raw), bool), -1
    while np.count_nonzero(kept) != before:
        before = int(np.count_nonzero(kept))
        numbers = np.flatnonzero(kept)
        kept[numbers] = _confirmed(where[numbers], raw[numbers])
    return kept


def _confirmed(where: Int64Array, raw: Float64Array) -> BoolArray:
    kept = np.zeros(len(raw), bool)
    for number in range(len(raw)):
        around = raw[_around(where, number, 1)]
        ratio = (1.0 + around) / (1.0 + raw[number])
        alike = (ratio < _LARGEST_RATIO) & (ratio > 1.0 / _LARGEST_RATIO)
        kept[number] = np.count_nonzero(alike) > 2 and 2 * np.count_nonzero(alike) > len(around)
    return kept


def _smoothed(where: Int64Array, raw: Float64Array, sigma: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Fit polynomials around each pair, the wider ones while they agree with the narrower (Lepski's rule)."""
    strain, spread = raw.copy(), sigma.copy()
    for number in range(len(raw)):
        low, high = raw[number] - _AGREES_WITHIN * sigma[number], raw[number] + _AGREES_WITHIN * sigma[number]
        for reach, terms in _REACHES:
            around = _around(where, number, reach)
            if len(around) < terms + _FEWEST_OVER_TERMS:
                break
            row, column = (where[around, 1:] - where[number, 1:]).T.astype(np.float64)
            design = np.stack(
                [np.ones(len(row)), row, column, row * row, row * column, column * column][:terms], axis=1
            )
            weighted = design / sigma[around, None] ** 2
            normal = design.T @ weighted
            if np.linalg.cond(normal) > 1e9:
                break
            covariance = np.linalg.inv(normal)
            value, error = float(covariance[0] @ (weighted.T @ raw[around])), float(np.sqrt(covariance[0, 0]))
            low, high = max(low, value - _AGREES_WITHIN * error), min(high, value + _AGREES_WITHIN * error)
            if low > high:
                break
            if error < spread[number]:
                strain[number], spread[number] = value, error
    return strain, spread


@dataclass(frozen=True, eq=False)
class GridCells:
    """Squares of the grid of which all four dots are seen.

    Attributes
    ----------
    corners : int64, shape (K, 4)
        Numbers of the dots, once around.
    length, width : float64, shape (K,)
        Mean strain of the two sides along the length and along the width.
    """

    corners: Int64Array
    length: Float64Array
    width: Float64Array

    @property
    def largest(self) -> Float64Array:
        """The larger of both, shape (K,)."""
        return np.maximum(self.length, self.width)


def grid_cells(measured: StrainMeasurement) -> GridCells:
    """Return the squares whose four sides have been measured."""
    along, across = _strain_by_pair(measured.length), _strain_by_pair(measured.width)
    below = dict(across.keys())
    corners = [
        (a, b, below[b], below[a]) for a, b in along if a in below and b in below and (below[a], below[b]) in along
    ]
    length = [(along[a, b] + along[d, c]) / 2 for a, b, c, d in corners]
    width = [(across[a, d] + across[b, c]) / 2 for a, b, c, d in corners]
    return GridCells(np.array(corners, np.int64).reshape(-1, 4), np.array(length, float), np.array(width, float))


def _strain_by_pair(axis: AxisStrain) -> dict[tuple[int, int], float]:
    return {(int(a), int(b)): float(strain) for (a, b), strain in zip(axis.pairs, axis.strain, strict=True)}
