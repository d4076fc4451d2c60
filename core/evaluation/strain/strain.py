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

from ...errors import FrameError, TactuneError
from ...model.arrays import BoolArray, Float64Array, IndexArray, Int64Array, Uint16Array
from ...model.clouds import valid_depth
from ...model.frames import DepthCamera, Rig, SensorFrame
from ...preset import CameraNoise
from ...rig.noise import image_noise
from .dots import DOT_WIDTHS_PX, Spots, find_dots
from .lattice import DotLattice, order_dots
from .surface import DotFits, SeenSurface, dot_points, dot_samples, surface_between, whole_dots

#: Default distance of neighbouring dots on the flat sheet, metres.
SPACING_M: Final = 0.010
SPACING_RANGE_M: Final = (0.001, 0.1)
#: A grid has at least this many ordered dots, and at least this share of all dark spots.
_MIN_DOTS, _MIN_SHARE = 16, 0.5
#: A spot lies between two dots if it is this near to their midpoint, as a share of their distance.
_BETWEEN_SHARE: Final = 0.25
#: Spots found at two dot sizes are the same spot if they are nearer than this.
_SAME_SPOT_PX: Final = 3.0
#: Sigma of the Gaussian that smooths the change of depth before its maximum is taken, pixels.
_INDENTATION_SIGMA_PX: Final = 4.0
#: Windows for the smoothing of strain: half side length in grid steps, and number of polynomial terms.
_WINDOWS: Final = ((1, 1), (1, 3), (2, 6), (3, 6))
#: A wider window is accepted if its fit agrees with the narrower ones within this many standard deviations.
_AGREES_WITHIN: Final = 3.5
#: A fit needs this many more neighbour pairs than terms.
_MIN_SURPLUS: Final = 3
#: A neighbour pair is an outlier if its length differs from those around it by more than this ratio.
_MAX_RATIO: Final = 1.35
#: Rows and columns cross at right angles on the flat sheet. A larger cosine in space means that a diagonal of the grid
#: or a spot that is no dot was taken for a side. Each side needs this many crossing sides.
_MAX_COSINE: Final = 0.5
_MIN_CROSSINGS: Final = 2
#: Samples of the noise that tell the uncertainty.
_SAMPLES: Final = 32
#: Standard deviation that smoothing cannot reduce: noise fixed to the scene, and variation of strain between dots.
_SYSTEMATIC_SIGMA: Final = 0.007


class StrainError(TactuneError):
    """A frame in which strain cannot be measured."""


@dataclass(frozen=True, eq=False)
class StrainMeasurement:
    """Strain of one frame, measured at dots seen by the tactile camera.

    Attributes
    ----------
    pixels : float64, shape (N, 2)
        Centroids of the dots that have a place in the grid, ``(u, v)``.
    points_m : float64, shape (N, 3)
        The same dots in the tactile camera's frame, metres; nan without depth.
    lattice : DotLattice
        Row, column and grid piece of each dot.
    length, width : AxisStrain
        Strain along the rows (the direction nearer to the image's u axis) and along the columns.
    """

    pixels: Float64Array
    points_m: Float64Array
    lattice: DotLattice
    length: AxisStrain
    width: AxisStrain

    @property
    def dots(self) -> int:
        """Number of dots that have a place in the grid."""
        return len(self.pixels)

    def at_dots(self) -> Float64Array:
        """Return the mean strain between each dot and its neighbours, along length and width.

        Returns
        -------
        float64, shape (N, 2)
            nan for dots without neighbours.
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
    """Dots with places in the grid and in space, and the accepted neighbour pairs along length and width."""

    surface: SeenSurface
    pixels: Float64Array
    found: DotFits
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
        Distance of neighbouring dots on the flat sheet, metres.

    Raises
    ------
    StrainError
        The frame has no tactile colour image, no grid is found, or there is too little depth.
    FrameError
        The frame belongs to another rig.
    """
    check_spacing(spacing_m)
    frame.check_against(rig)
    if frame.tactile_color is None:
        raise StrainError(
            f"frame {frame.sequence} has no tactile colour image; record the tactile camera with its colour image"
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
    try:
        noise = image_noise(frame.tactile_depth, camera)
    except FrameError as error:
        raise StrainError(
            f"frame {frame.sequence} has tactile depth in {100 * np.isfinite(depth_m).mean():.0f} % of its pixels, too "
            "few to measure its noise; check the tactile camera and its range"
        ) from error
    grid = _find_grid(frame, depth_m, camera, noise)
    lattice, points_m = grid.lattice, grid.found.points_m
    samples_m = dot_samples(grid.surface, grid.pixels, grid.found, noise, _SAMPLES)
    places = np.column_stack([lattice.piece, lattice.cells])
    axes = []
    for pairs, name in zip(grid.sides, ("length", "width"), strict=True):
        strain = axis_strain(pairs, points_m, samples_m, spacing_m, places)
        if len(strain.pairs) == 0:
            raise StrainError(
                f"frame {frame.sequence}: {len(grid.pixels)} dots are found, but no neighbours along the {name} have "
                "depth; check that the tactile depth image covers the membrane"
            )
        axes.append(strain)
    return StrainMeasurement(grid.pixels, points_m, lattice, *axes)


def check_spacing(spacing_m: float) -> None:
    """Check the spacing of the dots on the flat sheet.

    Raises
    ------
    StrainError
        The spacing is not between 1 and 100 mm.
    """
    low, high = SPACING_RANGE_M
    if not (math.isfinite(spacing_m) and low <= spacing_m <= high):
        raise StrainError(
            f"the dots' spacing is {1e3 * spacing_m:g} mm; give the distance of neighbours on the flat sheet, "
            f"{1e3 * low:g} to {1e3 * high:g} mm"
        )


def indentation_m(frame: SensorFrame, untouched: SensorFrame, rig: Rig) -> float:
    """Return the largest displacement of the membrane towards the tactile camera, metres, at least 0.

    The change of depth is smoothed by a Gaussian first.

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
    """Tell whether both neighbours have depth and the surface between them is visible."""
    return bool(np.isfinite(points).all()) and surface_between(depth_m, focal_px, pixels[0], pixels[1])


def _sides(
    lattice: DotLattice,
    depth_m: Float64Array,
    focal_px: float,
    pixels: Float64Array,
    points: Float64Array,
    all_spots: cKDTree,
) -> tuple[Int64Array, Int64Array]:
    """Return the accepted neighbour pairs along the length and along the width, each int64, shape (M, 2)."""
    usable = []
    for axis in (1, 0):
        pairs = without_one_between(lattice.neighbours(axis), pixels, all_spots)
        seen = [_usable(depth_m, focal_px, pixels[pair], points[pair]) for pair in pairs]
        usable.append(pairs[np.array(seen, bool)])
    along, across = usable
    return along[crossed(along, across, points)], across[crossed(across, along, points)]


def without_one_between(pairs: Int64Array, pixels: Float64Array, all_spots: cKDTree) -> Int64Array:
    """Return the neighbour pairs without a dot between them; pieces that meet shifted by a row have such pairs."""
    ends = pixels[pairs]
    gap, _ = all_spots.query(ends.mean(axis=1)) if len(pairs) else (np.empty(0), None)
    kept: Int64Array = pairs[gap > _BETWEEN_SHARE * np.hypot(*(ends[:, 1] - ends[:, 0]).T)]
    return kept


def _reordered(
    lattice: DotLattice,
    loose: Int64Array,
    linked: Callable[[Float64Array, int, int], bool],
    pixels: Float64Array,
) -> DotLattice:
    """Search for grid pieces once more among dots without an accepted neighbour.

    If a piece grows across a steep wall by a wrong step, all dots behind the wall are shifted by a row.
    """
    again = order_dots(pixels[loose], partial(linked, pixels[loose]))
    found = again.piece >= 0
    cells, piece = lattice.cells.copy(), lattice.piece.copy()
    cells[loose[found]] = again.cells[found]
    piece[loose[found]] = again.piece[found] + lattice.piece.max() + 1
    return DotLattice(cells, piece)


def _find_grid(frame: SensorFrame, depth_m: Float64Array, camera: DepthCamera, noise: CameraNoise) -> _Grid:
    """Find the grid at each dot size, and at all sizes together; return the one with most accepted neighbour pairs."""
    assert frame.tactile_color is not None
    surface = SeenSurface.of(depth_m, camera.intrinsics)
    found = [find_dots(frame.tactile_color, width_px, surface) for width_px in DOT_WIDTHS_PX]
    grids = []
    for spots in [*found, _merged(found)]:
        lattice = order_dots(spots.pixels, partial(_linked, depth_m, camera.intrinsics.fx, spots.pixels))
        ordered = lattice.piece >= 0
        if ordered.sum() >= max(_MIN_DOTS, _MIN_SHARE * len(spots)):
            kept = DotLattice(lattice.cells[ordered], lattice.piece[ordered])
            tree = cKDTree(spots.pixels)
            grids.append(_in_space(spots.some(ordered), tree, kept, surface, noise))
    if not grids:
        most = max(map(len, found))
        raise StrainError(
            f"frame {frame.sequence}: no grid of dots is seen in the tactile colour image ({most} dark spots, not in "
            "rows and columns); print a square grid of dark dots on the membrane, light it evenly and focus the camera "
            "(simulated: sim:cup?grid=dots)"
        )
    return max(grids, key=lambda grid: sum(map(len, grid.sides)))


def _in_space(
    spots: Spots,
    all_spots: cKDTree,
    lattice: DotLattice,
    surface: SeenSurface,
    noise: CameraNoise,
) -> _Grid:
    """Deproject dots, reorder those without accepted neighbours, and drop pairs with partly hidden dots."""
    pixels, focal_px, depth_m = spots.pixels, surface.intrinsics.fx, surface.depth_m
    found = dot_points(surface, pixels, noise)
    points = found.points_m
    sides = _sides(lattice, depth_m, focal_px, pixels, points, all_spots)
    loose = np.setdiff1d(np.arange(len(pixels)), np.concatenate(sides))
    lattice = _reordered(lattice, loose, partial(_linked, depth_m, focal_px), pixels)
    whole = whole_dots(lattice, points, spots.area_m2, spots.at_step)
    sides = _sides(lattice, depth_m, focal_px, pixels, points, all_spots)
    along, across = (pairs[whole[pairs].all(axis=1)] for pairs in sides)
    return _Grid(surface, pixels, found, lattice, (along, across))


def _merged(found: list[Spots]) -> Spots:
    """Return the spots found at all sizes, without duplicates."""
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
    """Strain along one direction of the grid, over M pairs of neighbouring dots.

    Attributes
    ----------
    pairs : int64, shape (M, 2)
        Indices of both dots.
    strain : float64, shape (M,)
        Distance over spacing, minus 1, smoothed over neighbouring pairs. Noise lengthens distances; that is corrected.
    sigma : float64, shape (M,)
        Standard deviation of ``strain``.
    raw : float64, shape (M,)
        Distance over spacing, minus 1, without smoothing.
    largest, largest_sigma : float
        The largest strain and its standard deviation; that noise makes the largest of many too large is part of it.
    """

    pairs: Int64Array
    strain: Float64Array
    sigma: Float64Array
    raw: Float64Array
    largest: float
    largest_sigma: float


def axis_strain(
    pairs: Int64Array,
    points_m: Float64Array,
    samples_m: Float64Array,
    spacing_m: float,
    places: Int64Array,
) -> AxisStrain:
    """Compare the distances of neighbouring dots with their spacing on the flat sheet.

    Parameters
    ----------
    pairs : int64, shape (M, 2)
    points_m : float64, shape (N, 3)
        Dots in the camera's frame, metres.
    samples_m : float64, shape (N, 3, B)
        The dots with random errors added, from `dot_samples`.
    spacing_m : float
    places : int64, shape (N, 3)
        Grid piece, row and column of each dot.
    """
    raw = _lengths(points_m, pairs) / spacing_m - 1.0
    pairs = pairs[_plausible(places[pairs[:, 0]], raw)]
    if not len(pairs):
        none = np.empty(0)
        return AxisStrain(pairs, none, none, none, math.nan, math.nan)
    raw = _lengths(points_m, pairs) / spacing_m - 1.0
    samples = _lengths(samples_m, pairs) / spacing_m - 1.0
    weights = _smoothing(places[pairs[:, 0]], raw, samples.std(axis=1))
    smoothed = weights @ samples
    mean = smoothed.mean(axis=1)
    errors, strain = smoothed - mean[:, None], 2 * (weights @ raw) - mean
    excess = (strain[:, None] + errors).max(axis=0) - strain.max()
    return AxisStrain(
        pairs,
        strain,
        np.hypot(errors.std(axis=1), _SYSTEMATIC_SIGMA),
        raw,
        float(strain.max()),
        float(np.hypot(np.sqrt(np.mean(excess**2)), _SYSTEMATIC_SIGMA)),
    )


def _lengths(points_m: Float64Array, pairs: Int64Array) -> Float64Array:
    """Return the distances of pairs, (M, ...), of points, (N, 3, ...)."""
    return np.asarray(np.linalg.norm(points_m[pairs[:, 1]] - points_m[pairs[:, 0]], axis=1))


def crossed(pairs: Int64Array, crossing: Int64Array, points_m: Float64Array) -> BoolArray:
    """Tell which neighbour pairs are crossed at their ends by pairs of the other direction, nearly at right angles.

    Parameters
    ----------
    pairs, crossing : int64, shape (M, 2) and (K, 2)
        Neighbour pairs of one direction, and of the other.
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
        kept[number] = len(met) >= _MIN_CROSSINGS and median(cosines) <= _MAX_COSINE
    return kept


def _directions(ends: Float64Array) -> Float64Array:
    """Return unit vectors, (M, 3), from the first to the second point of each pair, (M, 2, 3)."""
    ways = ends[:, 1] - ends[:, 0]
    return np.asarray(ways / np.maximum(np.linalg.norm(ways, axis=1), 1e-12)[:, None])


def _around(where: Int64Array, number: int, reach: int) -> IndexArray:
    """Return the indices of the pairs of the same piece in a square window around one pair."""
    apart = np.abs(where - where[number])
    return np.flatnonzero((apart[:, 0] == 0) & (apart[:, 1] <= reach) & (apart[:, 2] <= reach))


def _plausible(where: Int64Array, raw: Float64Array) -> BoolArray:
    """Tell the pairs whose length agrees with most pairs around them; outliers are removed until none is left."""
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
        alike = (ratio < _MAX_RATIO) & (ratio > 1.0 / _MAX_RATIO)
        kept[number] = np.count_nonzero(alike) > 2 and 2 * np.count_nonzero(alike) > len(around)
    return kept


def _smoothing(where: Int64Array, raw: Float64Array, sigma: Float64Array) -> Float64Array:
    """Return the weights of all pairs in the smoothed strain of each pair, shape (M, M).

    Polynomials are fitted in windows around each pair; wider windows are used while they agree with the narrower ones
    (Lepski 1991).
    """
    weights, spread = np.eye(len(raw)), sigma.copy()
    for number in range(len(raw)):
        low, high = raw[number] - _AGREES_WITHIN * sigma[number], raw[number] + _AGREES_WITHIN * sigma[number]
        for reach, terms in _WINDOWS:
            around = _around(where, number, reach)
            if len(around) < terms + _MIN_SURPLUS:
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
            share = weighted @ covariance[0]
            value, error = float(share @ raw[around]), float(np.sqrt(covariance[0, 0]))
            low, high = max(low, value - _AGREES_WITHIN * error), min(high, value + _AGREES_WITHIN * error)
            if low > high:
                break
            if error < spread[number]:
                weights[number], spread[number] = 0.0, error
                weights[number, around] = share
    return weights


@dataclass(frozen=True, eq=False)
class GridCells:
    """Grid cells: squares of the grid whose four dots are found.

    Attributes
    ----------
    corners : int64, shape (K, 4)
        Indices of the four dots, in order around the cell.
    length, width : float64, shape (K,)
        Mean strain of both sides along the length, and along the width.
    """

    corners: Int64Array
    length: Float64Array
    width: Float64Array

    @property
    def largest(self) -> Float64Array:
        """The larger of both strains, shape (K,)."""
        return np.maximum(self.length, self.width)


def grid_cells(measured: StrainMeasurement) -> GridCells:
    """Return the grid cells whose four sides are measured."""
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
