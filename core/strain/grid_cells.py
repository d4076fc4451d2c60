"""The strain map: the squares between four neighbouring dots, and how far each is stretched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.arrays import Float64Array, Int64Array
from .field import AxisStrain
from .strain import StrainMeasurement


@dataclass(frozen=True, eq=False)
class StrainCells:
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


def strain_cells(measured: StrainMeasurement) -> StrainCells:
    """Return the squares whose four sides have been measured."""
    along, across = _sides(measured.length), _sides(measured.width)
    below = dict(across.keys())
    corners = [
        (a, b, below[b], below[a]) for a, b in along if a in below and b in below and (below[a], below[b]) in along
    ]
    length = [(along[a, b] + along[d, c]) / 2 for a, b, c, d in corners]
    width = [(across[a, d] + across[b, c]) / 2 for a, b, c, d in corners]
    return StrainCells(np.array(corners, np.int64).reshape(-1, 4), np.array(length, float), np.array(width, float))


def _sides(axis: AxisStrain) -> dict[tuple[int, int], float]:
    return {(int(a), int(b)): float(strain) for (a, b), strain in zip(axis.pairs, axis.strain, strict=True)}
