"""The solver of the membrane's quadratic program: PIQP, a proximal interior-point method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import piqp

from ..model.arrays import Float64Array
from .mechanics_problem import QuadraticProgram

_TOLERANCE = 1e-10
_MOST_STEPS = 60


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the solver arrived.

    Attributes
    ----------
    x : float64, shape (n,)
    balance : float64, shape (m,)
        Multipliers of ``A x = 0``.
    bound : float64, shape (k,)
        Multipliers of ``x[positive] >= 0``, none negative.
    steps : int
    failure : str
        Why this is no solution, as a sentence; empty where it is one.
    """

    x: Float64Array
    balance: Float64Array
    bound: Float64Array
    steps: int
    failure: str


class MembraneSolver:
    """Solves programs that differ in P and q alone: the pattern is ordered and analysed once."""

    def __init__(self, first: QuadraticProgram) -> None:
        self._solver = piqp.SparseSolver()
        settings = self._solver.settings
        settings.eps_abs = settings.eps_rel = _TOLERANCE
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = _TOLERANCE
        settings.max_iter = _MOST_STEPS
        lower = np.full(len(first.q), -np.inf)
        lower[first.positive] = 0.0
        self._solver.setup(first.P, first.q, first.A, np.zeros(first.A.shape[0]), x_l=lower)

    def solve(self, program: QuadraticProgram) -> Solution:
        """Return the minimum, or where the solver gave up."""
        self._solver.update(P=program.P, c=program.q)
        status = self._solver.solve()
        result = self._solver.result
        failure = ""
        if status != piqp.PIQP_SOLVED:
            failure = f"the solver gave up after {result.info.iter} steps ({status.name})"
        return Solution(
            np.array(result.x), np.array(result.y), np.array(result.z_bl[program.positive]), result.info.iter, failure
        )
