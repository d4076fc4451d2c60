"""The loops over cells of pixels that find where a membrane in equilibrium touches the object, compiled."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Int32Array, Uint16Array
from .compiling import inline, kernel
from .membrane import derivatives

#: Upper limit of a slope: the depths of a steeper cell belong to both sides of an edge.
_MAX_SLOPE: Final = 2.0
#: Over a shorter distance no slope is measured, metres.
_MIN_RUN_M: Final = 1e-5
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_MIN_FACING, _MIN_TURN = np.float32(0.25), 0.25


class DifferenceWindow(NamedTuple):
    """What `average_cells` averages, and which pixels take part.

    Attributes
    ----------
    differences : float32, shape (H, W)
        Proximity minus tactile depth, metres.
    usable, excluded : bool, shape (H, W)
        Where both count; where neither may be contact.
    counts : uint16, shape (H, W)
        Raw proximity depth.
    unit_m, bias_m : float32
        Metres of a count; subtracted from the proximity depth.
    centre_m, limit_m : float32
        Only differences nearer than the limit to the centre are averaged.
    """

    differences: Float32Array
    usable: BoolArray
    excluded: BoolArray
    counts: Uint16Array
    unit_m: np.float32
    bias_m: np.float32
    centre_m: np.float32
    limit_m: np.float32


class Equations(NamedTuple):
    """The equations of the N cells that are solved for, cells of even row plus column first.

    A cell's sum of ``link`` times the difference to its neighbour, minus ``weight`` times its area over the square of
    ``trust_m`` times the difference to the measured gap, is its push times its area. Unknown cells are no neighbours.

    Attributes
    ----------
    places : int32, shape (N,)
        Flat places of the cells in their image.
    links : float32, shape (7, N)
        To the left, right, upper and lower neighbour; to the measured gap; the area, m^2; and the reciprocal of the sum
        of the first five.
    even : int
        Number of cells of even row plus column. No two of them are neighbours, and no two of the others.
    """

    places: Int32Array
    links: Float32Array
    even: int


class Relaxation(NamedTuple):
    """How `settle` iterates.

    Attributes
    ----------
    factor : float32
        Over-relaxation, 1 to 2.
    tolerance_m : float32
        Iteration ends when no gap changes by more, metres.
    max_sweeps : int
    """

    factor: np.float32
    tolerance_m: np.float32
    max_sweeps: int


@kernel
def average_cells(window: Any, side: Any, rays: Any, first: Any, last: Any, out: Any) -> None:
    """Write means over cells of ``side`` by ``side`` pixels, in rows ``first`` to ``last - 1`` of cells.

    The last cells may reach beyond the images.

    Parameters
    ----------
    window : DifferenceWindow
    side : int
    rays : membrane.RayWindow
        Of the images.
    out : float32, shape (6, ceil(H / side), ceil(W / side))
        Mean difference; share of the pixels that take part; that share times their mean x, y and z; and the excluded
        share.
    """
    differences, usable, excluded, counts, unit_m, bias_m, centre_m, limit_m = window
    table, top, left = rays
    pixels = np.float32(side * side)
    out[:, first:last] = _ZERO
    for row in range(first, last):
        for v in range(side * row, min(side * row + side, usable.shape[0])):
            for u in range(usable.shape[1]):
                if excluded[v, u]:
                    out[5, row, u // side] += _ONE
                if usable[v, u] and abs(differences[v, u] - centre_m) < limit_m:
                    column = u // side
                    z = np.float32(counts[v, u]) * unit_m - bias_m
                    out[0, row, column] += differences[v, u]
                    out[1, row, column] += _ONE
                    out[2, row, column] += table[top + v, left + u, 0] * z
                    out[3, row, column] += table[top + v, left + u, 1] * z
                    out[4, row, column] += z
        for column in range(out.shape[2]):
            out[0, row, column] /= max(out[1, row, column], _ONE)
            for part in range(1, out.shape[0]):
                out[part, row, column] /= pixels


@inline
def _slope_of(rise: Any, way: Any) -> Any:
    """Return the slope of a surface, at most `_MAX_SLOPE`; 0 over less than `_MIN_RUN_M`."""
    return min(max(rise / way, -_MAX_SLOPE), _MAX_SLOPE) if way > _MIN_RUN_M else 0.0


@kernel
def measure_cells(points: Any, shares: Any, min_share: Any, flat_m: Any, sides: Any, facing: Any) -> None:
    """Write the lengths of cells, and the share of a depth difference along the ray that is along the surface normal.

    Parameters
    ----------
    points : float32, shape (3, H, W)
        Of a smooth surface, running to the right and down, metres.
    shares : float32, shape (H, W)
        Where it is below ``min_share``, and at the border, a cell has sides of 1 mm and faces the camera.
    flat_m : tuple of float
        Width and height of a cell that faces the camera at a depth of 1 m.
    sides : float32, shape (2, H, W)
        Lengths to the right and down, metres.
    facing : float32, shape (H, W)
    """
    height, width = shares.shape
    sides[:], facing[:] = np.float32(1e-3), _ONE
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            if shares[v, u] < min_share:
                continue
            x_u, _, _, _, _ = derivatives(points[0], v, u)
            _, y_v, _, _, _ = derivatives(points[1], v, u)
            z_u, z_v, _, _, _ = derivatives(points[2], v, u)
            # at the end of a window the mean of its points moves by less than a cell, but along the surface
            right, down = _slope_of(z_u, x_u), _slope_of(z_v, y_v)
            z = points[2, v, u]
            ray_x, ray_y = points[0, v, u] / z, points[1, v, u] / z
            # from x = ray_x z and y = ray_y z, where ray_x grows along the row only and ray_y down the column only
            x_u = flat_m[0] * z / max(1 - right * ray_x, _MIN_TURN)
            y_v = flat_m[1] * z / max(1 - down * ray_y, _MIN_TURN)
            z_u, z_v = right * x_u, down * y_v
            y_u, x_v = ray_y * z_u, ray_x * z_v
            sides[0, v, u] = np.sqrt(x_u * x_u + y_u * y_u + z_u * z_u)
            sides[1, v, u] = np.sqrt(x_v * x_v + y_v * y_v + z_v * z_v)
            nx, ny, nz = y_u * z_v - z_u * y_v, z_u * x_v - x_u * z_v, x_u * y_v - y_u * x_v
            along = abs(nx * ray_x + ny * ray_y + nz) / np.sqrt(nx * nx + ny * ny + nz * nz)
            facing[v, u] = min(max(np.float32(along), _MIN_FACING), _ONE)


@kernel
def mark_inside(guess: Any, known: Any, largest_m: Any, largest_at_border_m: Any, inside: Any) -> Any:
    """Write which cells are solved for, and return their number; images are (H, W), with unknown cells at the border.

    They are the known cells whose guess of the gap (metres) is smaller than the first limit and, where one of the eight
    cells around them is unknown, than the second.
    """
    inside[:] = False
    count = 0
    for v in range(1, known.shape[0] - 1):
        for u in range(1, known.shape[1] - 1):
            if known[v, u] and guess[v, u] < largest_m:
                inside[v, u] = guess[v, u] < largest_at_border_m or known[v - 1 : v + 2, u - 1 : u + 2].all()
                count += inside[v, u]
    return count


@kernel
def link_cells(inside: Any, known: Any, sides: Any, weight: Any, trust_m: Any, places: Any, links: Any) -> Any:
    """Write ``places`` and ``links`` of the `Equations` of the cells inside; return ``even``.

    Parameters
    ----------
    inside, known : bool, shape (H, W)
        No cell at the border is inside.
    sides : float32, shape (2, H, W)
        From `measure_cells`.
    weight : float32, shape (H, W)
        Of the measured gap.
    trust_m : float32
        Length over which the measured gap attracts the gap, metres.
    """
    height, width = inside.shape
    count, even = 0, 0
    for parity in range(2):
        for v in range(1, height - 1):
            for u in range(1 + (v + 1 + parity) % 2, width - 1, 2):
                if not inside[v, u]:
                    continue
                here = sides[1, v, u] / sides[0, v, u]
                area = sides[0, v, u] * sides[1, v, u]
                links[0, count] = (here + sides[1, v, u - 1] / sides[0, v, u - 1]) / 2 if known[v, u - 1] else _ZERO
                links[1, count] = (here + sides[1, v, u + 1] / sides[0, v, u + 1]) / 2 if known[v, u + 1] else _ZERO
                here = _ONE / here
                links[2, count] = (here + sides[0, v - 1, u] / sides[1, v - 1, u]) / 2 if known[v - 1, u] else _ZERO
                links[3, count] = (here + sides[0, v + 1, u] / sides[1, v + 1, u]) / 2 if known[v + 1, u] else _ZERO
                links[4, count] = weight[v, u] * area / (trust_m * trust_m)
                links[5, count] = area
                total = _ZERO
                for link in range(5):
                    total += links[link, count]
                links[6, count] = _ONE / max(total, np.float32(1e-9))
                places[count] = v * width + u
                count += 1
        if parity == 0:
            even = count
    return even


@kernel
def settle(gaps: Any, width: Any, equations: Any, loads: Any, relaxation: Any) -> Any:
    """Solve for gaps that are nowhere negative by projected over-relaxation; return the number of sweeps.

    Cryer 1971, "The solution of a quadratic programming problem using systematic overrelaxation", SIAM J. Control 9.

    Parameters
    ----------
    gaps : float32, flat
        Of all cells: the start and the result. Cells that are not solved for keep theirs.
    width : int
        Of the image of cells.
    equations : Equations
    loads : float32, shape (N,)
        Measured gap times its link, minus push times area.
    relaxation : Relaxation
    """
    places, links, even = equations
    relax, tolerance_m, max_sweeps = relaxation
    for sweep in range(max_sweeps):
        change = _ZERO
        for part in range(2):
            first, last = (0, even) if part == 0 else (even, len(places))
            for i in range(first, last):
                place = places[i]
                before = gaps[place]
                pull = (
                    links[0, i] * gaps[place - 1]
                    + links[1, i] * gaps[place + 1]
                    + links[2, i] * gaps[place - width]
                    + links[3, i] * gaps[place + width]
                    + loads[i]
                )
                gap = max(before + relax * (pull * links[6, i] - before), _ZERO)
                change = max(change, abs(gap - before))
                gaps[place] = gap
        if change < tolerance_m:
            return sweep + 1
    return max_sweeps
