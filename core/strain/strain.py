"""Membrane strain from a grid of dots printed on it, seen in one colour and depth image (Yin et al.).

Dots are found and put in order, brought into space through the depth, and the distances between
neighbours compared with their spacing on the flat, unstretched sheet.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import cv2
import numpy as np
from scipy.spatial import cKDTree

from ..errors import TactuneError
from ..model.arrays import Float64Array, Int64Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame
from .dot_edges import SeenSurface, dot_covariance, whole_dots
from .dot_lattice import DotLattice, order_dots
from .dot_surface import dot_points, surface_between
from .dots import DOT_WIDTHS_PX, Spots, find_dots
from .field import AxisStrain, axis_strain, crossed

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
