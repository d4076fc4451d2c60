"""Open3D's threshold on the mean distances: exactly, or with a margin for inexact means."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..compiling import kernel

#: The share by which an inexact mean may differ from the exact one. Its distances differ by at most
#: 3 float32 units in the last place (differences exact to half a unit, squares and sums, root).
UNCERTAINTY = 4 * 2.0**-24
#: Means below this may come from squares that float32 cannot hold, metres.
_LEAST_M = 1e-12


@kernel
def below_threshold(means: Any, ratio: Any) -> Any:
    """Tell which exact means are positive and below Open3D's threshold, summing in its order."""
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
    inliers = np.empty(count, np.bool_)
    for i in range(count):
        inliers[i] = means[i] > 0 and means[i] < threshold
    return inliers


def surely_below_threshold(means: npt.NDArray[np.float64], ratio: float) -> npt.NDArray[np.bool_] | None:
    """Tell which means are below the threshold that the exact ones have; None where that is uncertain.

    With every mean known to a share e, the mean of all moves by at most e of itself, and the standard
    deviation, being a norm, by at most the norm of the means' changes.
    """
    count = len(means)
    if count < 2:
        return None
    mean = float(means.sum()) / count
    squares = float(np.dot(means, means))
    centred = means - mean
    threshold = mean + ratio * float(np.sqrt(np.dot(centred, centred) / (count - 1)))
    doubt = UNCERTAINTY * (mean + ratio * float(np.sqrt(squares / (count - 1)))) * (1 + 1e-6)
    inliers = np.empty(count, np.bool_)
    certain = _compare(means, threshold, doubt, inliers)
    return inliers if certain else None


@kernel
def _compare(means: Any, threshold: Any, doubt: Any, inliers: Any) -> Any:
    certain = True
    for i in range(len(means)):
        inliers[i] = means[i] < threshold
        certain &= means[i] > _LEAST_M and abs(means[i] - threshold) > doubt + UNCERTAINTY * means[i]
    return certain
