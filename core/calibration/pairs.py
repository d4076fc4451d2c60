"""What pairs of points must fulfil before anything is fitted to them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..errors import CalibrationError
from ..model.arrays import Float64Array

#: Scatter across the best line, as a share of the scatter along it, below which points lie on a line.
_LINE_SHARE = 2e-3


def check_pairs(
    tactile: npt.ArrayLike, proximity: npt.ArrayLike, least: int, name: str
) -> tuple[Float64Array, Float64Array]:
    """Return both sides as float64, or say why no model can come of them.

    Raises
    ------
    CalibrationError
        Other shapes, values that are not finite, too few different pairs, or all points on a line.
    """
    tactile, proximity = (np.array(side, dtype=np.float64, ndmin=2) for side in (tactile, proximity))
    if tactile.shape != proximity.shape or tactile.shape[1] != 2:
        raise CalibrationError(
            f"pairs are two lists of (u, v) of the same length, these have shapes {tactile.shape} and {proximity.shape}"
        )
    _check_count(len(tactile), least, name)
    for side, points in (("tactile", tactile), ("proximity", proximity)):
        if not np.isfinite(points).all():
            row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
            raise CalibrationError(f"pair {row + 1}: the {side} point is {tuple(points[row])}; give finite numbers")
    _check_different(np.column_stack([tactile, proximity]), least, name)
    for side, points in (("tactile", tactile), ("proximity", proximity)):
        if on_a_line(points):
            raise CalibrationError(
                f"the {side} points lie on one line, which determines no {name}; add points to both sides of the line"
            )
    return tactile, proximity


def check_space(places: Float64Array, proximity: Float64Array, least: int, name: str) -> None:
    """Refuse places (tactile u, v, depth; N, 3) and proximity pixels (N, 2) of which no pose can come.

    Raises
    ------
    CalibrationError
        Too few different pairs, values that are not finite, or a depth that is not positive.
    """
    _check_count(len(places), least, name, "pairs with a tactile depth")
    for side, values in (("tactile place and depth", places), ("proximity point", proximity)):
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
            raise CalibrationError(f"pair {row + 1}: the {side} is {values[row].tolist()}; give finite numbers")
    if (places[:, 2] <= 0).any():
        row = int(np.flatnonzero(places[:, 2] <= 0)[0])
        raise CalibrationError(f"pair {row + 1}: the tactile depth is {places[row, 2]:g} m; it must be above 0")
    _check_different(np.column_stack([places, proximity]), least, name)


def _check_count(count: int, least: int, name: str, what: str = "pairs of points") -> None:
    if count < least:
        raise CalibrationError(
            f"a {name} needs at least {least} {what}, there are {count}; add {least - count} more, "
            f"or better {least + 2 - count}"
        )


def _check_different(rows: Float64Array, least: int, name: str) -> None:
    different = len(np.unique(rows, axis=0))
    if different < least:
        raise CalibrationError(
            f"only {different} of the {len(rows)} pairs differ from each other, a {name} needs {least}; "
            "delete the repeated ones and add points elsewhere"
        )


def on_a_line(points: Float64Array) -> bool:
    """Whether points (N, 2 or 3) scatter along one direction only."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(values[1] <= _LINE_SHARE * values[0])


def spread(points: Float64Array) -> tuple[float, float]:
    """Return the diagonal and the area of the points' bounding box, widened by a tenth."""
    low, high = np.percentile(points, [0, 100], axis=0)
    sides = 1.1 * np.maximum(high - low, 1e-12)
    diagonal = float(np.hypot(*sides))
    return diagonal, float(max(sides[0] * sides[1], 0.1 * diagonal**2))
