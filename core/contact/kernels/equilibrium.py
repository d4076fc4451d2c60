"""The loops that solve for the gap of a membrane in equilibrium, cell by cell, compiled."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from .compiling import kernel

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_MIN_SHARE: Final = np.float32(1e-6)
#: Floor of a gap that may be negative, metres.
_NO_FLOOR: Final = np.float32(-1.0)


@kernel
def guess_gaps(measured: Any, total: Any, near_share: Any, known: Any, guess: Any, gaps: Any) -> None:
    """Write the guess of each cell's gap, and the gap to start from; images are (H, W), metres.

    The guess of known cells is ``total`` over ``near_share``, which are averaged over the same window; they start from
    0 or above. That of others is the measured gap.
    """
    for v in range(known.shape[0]):
        for u in range(known.shape[1]):
            if known[v, u]:
                guess[v, u] = total[v, u] / max(near_share[v, u], _MIN_SHARE)
                gaps[v, u] = max(guess[v, u], _ZERO)
            else:
                guess[v, u] = gaps[v, u] = measured[v, u]


@kernel
def mark_inside(guess: Any, known: Any, linked: Any, weights: Any, largest_m: Any, inside: Any) -> Any:
    """Write which cells are solved for, and return their number; images are (H, W), and no cell at the border is.

    Known cells are solved for where the guess of the gap (metres) is smaller than the limit. A linked cell beside them
    that does not see the membrane (its weight is 0) is solved for. One that sees it is solved for if the magnitude of
    its gap is smaller than the limit and all 8 neighbours are linked; otherwise it keeps its gap.
    """
    inside[:] = False
    count = 0
    for v in range(1, known.shape[0] - 1):
        for u in range(1, known.shape[1] - 1):
            if known[v, u]:
                inside[v, u] = guess[v, u] < largest_m
            elif linked[v, u]:
                inside[v, u] = weights[v, u] == _ZERO or (
                    abs(guess[v, u]) < largest_m and linked[v - 1 : v + 2, u - 1 : u + 2].all()
                )
            count += inside[v, u]
    return count


@kernel
def link_cells(
    inside: Any, cells: Any, measured: Any, push: Any, trust_m: Any, places: Any, links: Any, floors: Any, loads: Any
) -> Any:
    """Write the equations of the N cells inside, those of even row plus column first; return the number of these.

    For a cell with the gap g: the sum of link * (neighbour - g), minus weight * area / trust_m^2 * (g - measured), is
    push * area. Only linked cells are neighbours. No two cells of even row plus column are, and no two of the others.

    Parameters
    ----------
    inside : bool, shape (H, W)
        Which cells are solved for; none at the border.
    cells : Cells
    measured, push : float32, shape (H, W)
        Measured gaps, metres; p / T - k, 1/m.
    trust_m : float32
        Length over which the measured gap attracts the gap, metres.
    places : int32, shape (N,)
        Flat places of the cells in their image.
    links : float32, shape (6, N)
        To the left, right, upper and lower neighbour; to the measured gap; and the reciprocal of their sum.
    floors, loads : float32, shape (N,)
        Smallest gap: 0 where there is an object; measured gap times its link, minus push times area.
    """
    known, linked, sides, weight = cells.known, cells.linked, cells.sides_m, cells.weight
    height, width = inside.shape
    count, even = 0, 0
    for parity in range(2):
        for v in range(1, height - 1):
            for u in range(1 + (v + 1 + parity) % 2, width - 1, 2):
                if not inside[v, u]:
                    continue
                here = sides[1, v, u] / sides[0, v, u]
                area = sides[0, v, u] * sides[1, v, u]
                links[0, count] = (here + sides[1, v, u - 1] / sides[0, v, u - 1]) / 2 if linked[v, u - 1] else _ZERO
                links[1, count] = (here + sides[1, v, u + 1] / sides[0, v, u + 1]) / 2 if linked[v, u + 1] else _ZERO
                here = _ONE / here
                links[2, count] = (here + sides[0, v - 1, u] / sides[1, v - 1, u]) / 2 if linked[v - 1, u] else _ZERO
                links[3, count] = (here + sides[0, v + 1, u] / sides[1, v + 1, u]) / 2 if linked[v + 1, u] else _ZERO
                links[4, count] = weight[v, u] * area / (trust_m * trust_m)
                total = _ZERO
                for link in range(5):
                    total += links[link, count]
                links[5, count] = _ONE / max(total, np.float32(1e-9))
                places[count] = v * width + u
                loads[count] = links[4, count] * measured[v, u] - area * push[v, u]
                floors[count] = _ZERO if known[v, u] else _NO_FLOOR
                count += 1
        if parity == 0:
            even = count
    return even


@kernel
def settle(gaps: Any, width: Any, equations: Any, loads: Any, factor: Any, tolerance_m: Any, max_sweeps: Any) -> Any:
    """Solve for gaps that are nowhere below their floors by projected over-relaxation; return the number of sweeps.

    Cryer 1971, "The solution of a quadratic programming problem using systematic overrelaxation", SIAM J. Control 9.

    Parameters
    ----------
    gaps : float32, flat
        Of all cells: the start and the result. Cells that are not solved for keep theirs.
    width : int
        Of the image of cells.
    equations, loads
        Places, links, floors and the number of even cells, and the loads, of `link_cells`.
    factor, tolerance_m : float32
        Over-relaxation, 1 to 2; iteration ends when no gap changes by more.
    max_sweeps : int
    """
    places, links, floors, even = equations
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
                gap = max(before + factor * (pull * links[5, i] - before), floors[i])
                change = max(change, abs(gap - before))
                gaps[place] = gap
        if change < tolerance_m:
            return sweep + 1
    return max_sweeps
