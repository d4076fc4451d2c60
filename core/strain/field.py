"""Strain between neighbouring dots, with its noise averaged over as many neighbours as agree."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median
from typing import Final

import numpy as np

from ..model.arrays import BoolArray, Float64Array, IndexArray, Int64Array

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
