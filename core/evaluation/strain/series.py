"""Measurements of one press in order of time: which of them cannot be true."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...model.arrays import BoolArray, Float64Array

#: Number of neighbours on either side that a measurement is compared with.
_NEIGHBOURS = 2
#: Difference from its neighbours that a measurement may have: percentage points, standard deviations, and what the
#: change of displacement explains, percentage points per millimetre (a simulated press shows less than 2).
_ALLOWED_PERCENT, _ALLOWED_SIGMAS, _PERCENT_PER_MM = 5.0, 3.0, 4.0


def spikes(
    displacement_mm: npt.ArrayLike, strain_percent: npt.ArrayLike, sigma_percent: npt.ArrayLike | None = None
) -> BoolArray:
    """Tell which strains do not fit those shortly before and after, as after two dots were taken for neighbours.

    A strain is compared with the range of its neighbours in time, without the smallest and the largest of four.

    Parameters
    ----------
    displacement_mm : array_like, shape (N,)
    strain_percent : array_like, shape (N,)
        In order of time.
    sigma_percent : array_like, shape (N,), optional
        Standard deviations of the strains; default 0.

    Returns
    -------
    bool, shape (N,)
        All False for fewer than three measurements.
    """
    moved = np.asarray(displacement_mm, np.float64)
    strain = np.asarray(strain_percent, np.float64)
    sigma = np.zeros_like(strain) if sigma_percent is None else np.asarray(sigma_percent, np.float64)
    explained = _PERCENT_PER_MM * _beyond(moved)
    return np.asarray(_beyond(strain) > _ALLOWED_PERCENT + _ALLOWED_SIGMAS * sigma + explained)


def _beyond(values: Float64Array) -> Float64Array:
    """Return how far each value lies outside the range of its neighbours; of four, the inner two count."""
    padded = np.pad(values, _NEIGHBOURS, constant_values=np.nan)
    shifts = [shift for shift in range(2 * _NEIGHBOURS + 1) if shift != _NEIGHBOURS]
    near = np.sort([padded[shift : shift + len(values)] for shift in shifts], axis=0)  # those missing come last
    count = np.isfinite(near).sum(axis=0)
    inner = count == len(shifts)
    at = np.arange(len(values))
    low, high = near[inner.astype(np.intp), at], near[np.maximum(count - 1 - inner, 0), at]
    beyond = np.maximum(np.maximum(low - values, values - high), 0.0)
    return np.where(count < 2, 0.0, beyond)
