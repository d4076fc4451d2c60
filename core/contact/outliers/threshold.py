"""Open3D's threshold on the mean distances: exactly, or with a margin for inexact means."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.arrays import BoolArray, Float64Array
from ..kernels.compiling import kernel
from ..kernels.simd import LANES, doubles, load, total

#: The share by which an inexact mean may differ from the exact one. Its distances differ by at most
#: 3 float32 units in the last place (differences exact to half a unit, squares and sums, root).
UNCERTAINTY = 4 * 2.0**-24
#: The same for means of float64 distances, and for the order of Open3D's sums.
PRECISE_UNCERTAINTY = 1e-9
#: Means below this may come from squares that float32 cannot hold, metres.
_LEAST_M = 1e-12


def below_threshold(means: Float64Array, ratio: float) -> BoolArray:
    """Tell which exact means are positive and below Open3D's threshold, summing in its order."""
    inliers = np.empty(len(means), np.bool_)
    _compare_exactly(means, ratio, inliers)
    return inliers


@kernel
def _compare_exactly(means: Any, ratio: Any, inliers: Any) -> None:
    count = len(means)
    total = 0.0
    for value in means:
        total += value
    mean = total / count
    squares = 0.0
    for value in means:
        if value > 0:
            squares += (value - mean) * (value - mean)
    threshold = mean + ratio * np.sqrt(squares / (count - 1)) if count > 1 else np.nan
    for i in range(count):
        inliers[i] = means[i] > 0 and means[i] < threshold


def surely_below_threshold(means: Float64Array, ratio: float, uncertainty: float) -> BoolArray | None:
    """Tell which means are below the threshold that the exact ones have; None where that is uncertain.

    With every mean known to a share e, ``uncertainty``, the mean of all moves by at most e of itself, and the standard
    deviation, being a norm, by at most the norm of the means' changes.
    """
    count = len(means)
    if count < 2:
        return None
    inliers = np.empty(count, np.bool_)
    return inliers if _compare(means, ratio, uncertainty, inliers) else None


@kernel
def _compare(means: Any, ratio: Any, uncertainty: Any, inliers: Any) -> Any:
    count = len(means)
    whole = count - count % LANES
    sums = doubles(0.0)
    squares = doubles(0.0)
    for i in range(0, whole, LANES):
        mean = load(means, i)
        sums = sums + mean
        squares = squares + mean * mean
    sum_of_means, sum_of_squares = total(sums), total(squares)
    for i in range(whole, count):
        sum_of_means += means[i]
        sum_of_squares += means[i] * means[i]

    centre = sum_of_means / count
    centred = doubles(0.0)
    for i in range(0, whole, LANES):
        away = load(means, i) - doubles(centre)
        centred = centred + away * away
    sum_of_centred = total(centred)
    for i in range(whole, count):
        sum_of_centred += (means[i] - centre) * (means[i] - centre)

    threshold = centre + ratio * np.sqrt(sum_of_centred / (count - 1))
    doubt = uncertainty * (centre + ratio * np.sqrt(sum_of_squares / (count - 1))) * (1 + 1e-6)
    certain = True
    for i in range(count):
        inliers[i] = means[i] < threshold
        certain &= means[i] > _LEAST_M and abs(means[i] - threshold) > doubt + uncertainty * means[i]
    return certain
