"""What pairs of points must fulfil before anything is fitted to them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..errors import CalibrationError
from ..frames import Float64Array

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
    if len(tactile) < least:
        raise CalibrationError(
            f"a {name} needs at least {least} pairs of points, there are {len(tactile)}; add {least - len(tactile)} "
            f"more, or better {least + 2 - len(tactile)}"
        )
    for side, points in (("tactile", tactile), ("proximity", proximity)):
        if not np.isfinite(points).all():
            row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
            raise CalibrationError(f"pair {row + 1}: the {side} point is {tuple(points[row])}; give finite numbers")
    different = len(np.unique(np.column_stack([tactile, proximity]), axis=0))
    if different < least:
        raise CalibrationError(
            f"only {different} of the {len(tactile)} pairs differ from each other, a {name} needs {least}; "
            "delete the repeated ones and add points elsewhere"
        )
    for side, points in (("tactile", tactile), ("proximity", proximity)):
        if on_a_line(points):
            raise CalibrationError(
                f"the {side} points lie on one line, which determines no {name}; add points to both sides of the line"
            )
    return tactile, proximity


def on_a_line(points: Float64Array) -> bool:
    """Whether points (N, 2) scatter along one direction only."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(values[1] <= _LINE_SHARE * values[0])


def spread(points: Float64Array) -> tuple[float, float]:
    """Return the diagonal and the area of the points' bounding box, widened by a tenth."""
    low, high = np.percentile(points, [0, 100], axis=0)
    sides = 1.1 * np.maximum(high - low, 1e-12)
    diagonal = float(np.hypot(*sides))
    return diagonal, float(max(sides[0] * sides[1], 0.1 * diagonal**2))
