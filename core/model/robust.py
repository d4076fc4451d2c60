"""A standard deviation that outliers hardly change."""

from __future__ import annotations

import numpy as np

from .arrays import AnyArray


def spread(values: AnyArray, middle: float = 0.0) -> float:
    """Return 1.4826 times the median distance of the values from a middle: their standard deviation if they are normal.

    Values that are nan do not count.
    """
    return 1.4826 * float(np.nanmedian(np.abs(values - middle)))
