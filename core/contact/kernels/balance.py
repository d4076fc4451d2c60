"""Passes over cells of two by two pixels for the balance of the membrane, compiled."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from .compiling import inline, kernel
from .membrane import derivatives

#: Steeper cells count as that steep: their depths are of both sides of an edge. And the least way that tells a slope.
_STEEPEST: Final = 2.0
_SHORTEST_M: Final = 1e-5
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_LEAST_FACING, _LEAST_TURN = np.float32(0.25), 0.25


@kernel
def average_cells(
    differences: Any, usable: Any, depth: Any, gaps: Any, known: Any, rays: Any, top: Any, left: Any, out: Any
) -> None:
    """Write means over cells of two by two pixels of a rectangle that begins at ``top`` and ``left``.

    Parameters
    ----------
    differences, depth, gaps : float32, shape (H, W)
    usable, known : bool, shape (H, W)
    rays : float32, shape (h, w, 2)
        Of the whole image.
    out : float32, shape (7, H // 2, W // 2)
        Mean difference of usable pixels, the share of these, and times that share their x, y and z; the mean of known
        gaps; and how many of four pixels have one.
    """
    for row in range(out.shape[1]):
        for column in range(out.shape[2]):
            count, seen = _ZERO, _ZERO
            difference, x, y, z, gap = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
            for v in range(2 * row, 2 * row + 2):
                for u in range(2 * column, 2 * column + 2):
                    if known[v, u]:
                        gap += gaps[v, u]
                        seen += _ONE
                    if usable[v, u]:
                        count += _ONE
                        difference += differences[v, u]
                        x += rays[top + v, left + u, 0] * depth[v, u]
                        y += rays[top + v, left + u, 1] * depth[v, u]
                        z += depth[v, u]
            out[0, row, column] = difference / max(count, _ONE)
            out[1, row, column] = count / 4
            out[2, row, column] = x / 4
            out[3, row, column] = y / 4
            out[4, row, column] = z / 4
            out[5, row, column] = gap / max(seen, _ONE)
            out[6, row, column] = seen


@inline
def _slope_of(rise: Any, way: Any) -> Any:
    """Return how steep a surface is, at most `_STEEPEST`; over hardly any way it is flat."""
    return min(max(rise / way, -_STEEPEST), _STEEPEST) if way > _SHORTEST_M else 0.0


@kernel
def measure_cells(points: Any, shares: Any, least: Any, flat_m: Any, slope: Any, sides: Any, facing: Any) -> None:
    """Write how long cells are, and how much of a difference of depths along the ray is along the surface's normal.

    Parameters
    ----------
    points : float32, shape (3, H, W)
        Of a smooth surface, going to the right and down.
    shares : float32, shape (H, W)
        Where it is below ``least``, and at the border, a cell has sides of 1 mm and faces the camera.
    flat_m : tuple of float
        Width and height at a depth of 1 m of a cell that faces the camera.
    slope : bool
        Without it all cells count as facing the camera.
    sides : float32, shape (2, H, W)
    facing : float32, shape (H, W)
    """
    height, width = shares.shape
    sides[:], facing[:] = np.float32(1e-3), _ONE
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            if shares[v, u] < least:
                continue
            x_u, _, _, _, _ = derivatives(points[0], v, u)
            _, y_v, _, _, _ = derivatives(points[1], v, u)
            z_u, z_v, _, _, _ = derivatives(points[2], v, u)
            # where a window ends, the mean of its points moves less than a cell, but along the surface
            right, down = _slope_of(z_u, x_u), _slope_of(z_v, y_v)
            z = points[2, v, u]
            ray_x, ray_y = points[0, v, u] / z, points[1, v, u] / z
            # from x = ray_x z and y = ray_y z, where ray_x grows along the row only and ray_y down the column only
            x_u = flat_m[0] * z / max(1 - right * ray_x, _LEAST_TURN)
            y_v = flat_m[1] * z / max(1 - down * ray_y, _LEAST_TURN)
            z_u, z_v = right * x_u, down * y_v
            y_u, x_v = ray_y * z_u, ray_x * z_v
            sides[0, v, u] = np.sqrt(x_u * x_u + y_u * y_u + z_u * z_u)
            sides[1, v, u] = np.sqrt(x_v * x_v + y_v * y_v + z_v * z_v)
            if slope:
                nx, ny, nz = y_u * z_v - z_u * y_v, z_u * x_v - x_u * z_v, x_u * y_v - y_u * x_v
                along = abs(nx * ray_x + ny * ray_y + nz) / np.sqrt(nx * nx + ny * ny + nz * nz)
                facing[v, u] = min(max(np.float32(along), _LEAST_FACING), _ONE)


@kernel
def link_cells(inside: Any, known: Any, sides: Any, weight: Any, trust_m: Any, places: Any, links: Any) -> Any:
    """Write the equations of the cells inside, those of even row plus column first; return how many those are.

    A cell's sum of ``link`` times the difference to its neighbour, less ``weight`` times its area over the square of
    ``trust_m`` times that to what is measured, is its push times its area. What is not known is no neighbour.

    Parameters
    ----------
    inside, known : bool, shape (H, W)
        No cell at the border is inside.
    sides : float32, shape (2, H, W)
        Metres.
    weight : float32, shape (H, W)
    places : int32, shape (N,)
        Flat places of the cells inside.
    links : float32, shape (7, N)
        To the left, right, upper and lower neighbour; to what is measured; the area; and one over the sum of the
        first five.
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
def settle(
    gaps: Any, width: Any, places: Any, links: Any, loads: Any, even: Any, relax: Any, least_m: Any, most: Any
) -> Any:
    """Solve for gaps that are nowhere negative by projected over-relaxation; return how many sweeps it took.

    Cryer 1971, "The solution of a quadratic programming problem using systematic overrelaxation", SIAM J. Control 9.

    Parameters
    ----------
    gaps : float32, flat
        Of all cells: where it starts, where it ends; those that are not inside stay.
    width : int
        Of the image of cells.
    places, links : as written by `link_cells`
    loads : float32, shape (N,)
        What is measured times its link, less push times area.
    even : int
        So many of the cells have no neighbour among each other, and so has the rest.
    least_m : float
        It ends when no gap changes by more.
    most : int
        Sweeps.
    """
    for sweep in range(most):
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
        if change < least_m:
            return sweep + 1
    return most


@kernel
def misfit_of_groups(
    gaps: Any, along_ray: Any, measured: Any, weight: Any, groups: Any, firm: Any, misfits: Any, touching: Any
) -> None:
    """Add each group's weighed squares of what is measured less the gap, and count its firm cells without a gap.

    All but the last two have an entry for each cell; ``misfits`` and ``touching`` have one for each group. What is
    measured is along the ray, and ``along_ray`` times a gap is so, too.
    """
    for i in range(len(gaps)):
        off = measured[i] - gaps[i] * along_ray[i]
        misfits[groups[i]] += weight[i] * off * off
        if firm[i] and gaps[i] == _ZERO:
            touching[groups[i]] += 1
