"""Types of NumPy arrays by element type, and a standard deviation that outliers hardly change."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

AnyArray = npt.NDArray[Any]
BoolArray = npt.NDArray[np.bool_]
Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
#: Indices into another array, as `numpy.flatnonzero` returns them.
IndexArray = npt.NDArray[np.intp]
Int32Array = npt.NDArray[np.int32]
Int64Array = npt.NDArray[np.int64]
Uint8Array = npt.NDArray[np.uint8]
Uint16Array = npt.NDArray[np.uint16]
Uint64Array = npt.NDArray[np.uint64]


def spread(values: AnyArray, middle: float = 0.0) -> float:
    """Return 1.4826 times the median distance from a middle, nan left out: the deviation of normal values."""
    return 1.4826 * float(np.nanmedian(np.abs(values - middle)))
