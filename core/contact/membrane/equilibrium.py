"""Contact as an obstacle problem: where a membrane in equilibrium of tension and pressure touches the object.

A free membrane of tension T under the pressure p has twice the mean curvature p / T (Young-Laplace). For an object of
curvature k, the gap g between membrane and object satisfies laplacian(g) = p / T - k on the surface. In contact g is
0, and g is never negative: an obstacle problem (Kinderlehrer and Stampacchia, "An Introduction to Variational
Inequalities and Their Applications", 1980, chapter 1). Both cameras measure the gap, with noise and a bias b. The gap
minimises, over a surface,

    |grad g|^2 / 2 + (p / T - k) g + (g - (measured - b))^2 / (2 L^2),    g >= 0,

where L is the length over which equilibrium is trusted more than the measured gap. Noise that is shorter than L is
averaged, and the edge of contact is where the membrane leaves the object, not where a threshold is passed.

The membrane does not end where the object ends. Beside the object, up to a few cells beyond its border, the gap is that
to the tangent plane of the nearest border cell, and it may be negative. If the membrane passes in front of that plane,
it pulls the gap open at the border; if it passes behind, it is bent around the border and touches up to it.

Assumed: the same tension in all directions, no friction, small slopes between membrane and object.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from ...model.arrays import BoolArray, Float32Array
from ..kernels import equilibrium as kernels
from .cells import FAR_M, Cells, over_window

#: The gap is solved for where the measured one is smaller, metres.
_MAX_GAP_M: Final = np.float32(0.005)
_FACTOR, _TOLERANCE_M, _MAX_SWEEPS = np.float32(1.7), np.float32(1e-5), 300


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The solution: gaps along the normal in the cells, with their frame."""

    gap_m: Float32Array  # (H, W): 0 in contact; large where nothing is known
    guess_m: Float32Array  # (H, W): The local mean of the measured gap
    residual_m: Float32Array  # (H, W): The measured gap less the solution
    touching: BoolArray  # (H, W)


def settle(cells: Cells, bias_m: float, trust_m: float, start: Equilibrium | None = None) -> Equilibrium:
    """Solve the obstacle problem for a bias and the length L, starting from the solution for another bias if given."""
    measured = (cells.difference_m - np.float32(bias_m)) * cells.facing
    total = over_window(cells.share * measured, cells.size_px)
    guess, gap, inside = np.empty_like(total), np.empty_like(total), np.empty(total.shape, np.bool_)
    kernels.guess_gaps(measured, total, cells.near_share, cells.known, guess, gap)
    size = kernels.mark_inside(guess, cells.known, cells.linked, cells.weight, _MAX_GAP_M, inside)
    places, links = np.empty(size, np.int32), np.empty((6, size), np.float32)
    floors, loads = np.empty((2, size), np.float32)
    images = kernels.CellImages(measured, cells.known, cells.linked, cells.push_per_m, cells.sides_m, cells.weight)
    even = kernels.link_cells(inside, images, np.float32(trust_m), places, links, floors, loads)
    if start is not None:
        np.copyto(gap, start.gap_m, where=inside & cells.known)
    equations = kernels.Equations(places, links, floors, even)
    kernels.settle(gap.reshape(-1), gap.shape[1], equations, loads, _FACTOR, _TOLERANCE_M, _MAX_SWEEPS)
    gap[~cells.known] = FAR_M
    return Equilibrium(gap, guess, measured - gap, inside & cells.known & (gap <= 0))
