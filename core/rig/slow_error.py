"""The proximity camera's slow error: the part of its error that varies over a large part of the image.

Time of flight cameras have errors that no average over neighbours or frames removes. They tilt the plane of a contact
patch, and one patch is too small to tell them from the tactile camera's noise. A flat background, such as a wall or a
ceiling behind the membrane, shows them: the inverse depth of a plane is linear in the image, and its residual is
noise and the slow error. The products of residuals at several distances tell one from the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Final

import numpy as np

from ..model.arrays import BoolArray, Float32Array, Float64Array, IndexArray
from ..model.robust import spread

#: Amplitudes that are expected of cameras before anything is measured, metres, and how likely each is; the length, of
#: which two pixels at a distance of d share exp(-d^2 / (4 length^2)), as a share of the image's width.
SLOW_M: Final = np.array([0.0, 0.0001, 0.0002, 0.0004, 0.0008])
SLOW_CHANCE: Final = np.array([0.3, 0.175, 0.175, 0.175, 0.175])
SLOW_LENGTH: Final = 1 / 12

#: Cells along the image's width, and along the side and the step of a window.
_CELLS, _WINDOW, _STEP = 53, 20, 2
#: Share of a cell's pixels and of a window's cells that must be known.
_MIN_FILLED: Final = 0.75
#: A cell with a variance larger than the median by this factor contains a step of depth.
_STEP_FACTOR: Final = 6.0
#: Residuals beyond this number of robust standard deviations are outliers; a window with a larger one is not flat.
_TRIM, _MAX_ROUGH_M = 5.0, 0.004
#: Bounds of the distances at which products of residuals are averaged, cells.
_LAGS: Final = np.array([-0.5, 0.5, 1.5, 2.5, 4.5, 7.5, 10.5])
#: Standard error of a variance: as a share of it, since the image contains few lengths, and at the least, m^2.
_SAMPLING, _MIN_ERROR_M2 = 0.4, 4e-10


def slow_error_m(depth_m: Float32Array, noise_length_px: float) -> float | None:
    """Return the standard deviation of the slow error, metres; None without a flat background.

    It is the root mean square of `SLOW_M`, weighted by how likely each amplitude is after the measurement.

    Parameters
    ----------
    depth_m : float32, shape (H, W)
        Mean proximity depth of a scene at rest, nan where unknown.
    noise_length_px : float
        Correlation length of the camera's noise, as in `CameraNoise`.
    """
    size = max(depth_m.shape[1] // _CELLS, 1)
    noise_length = float(np.hypot(noise_length_px, size / np.sqrt(12))) / size
    windows = list(_flat_windows(_cell_means(depth_m, size)))
    if not windows:
        return None
    lags, model = _model(noise_length)
    rows = np.array([_products(residual, lags) for _, residual in windows])
    errors = np.maximum(rows.std(axis=0), 0.02 * rows.mean(axis=0)[0]) + 1e-12
    found = rows @ (np.linalg.pinv(model / errors[:, None]) / errors)[-1]
    area = len({cell for cells, _ in windows for cell in cells.tolist()})
    independent = max(area / _WINDOW**2, 1.0)
    error2 = found.var() / independent + _MIN_ERROR_M2**2 + (_SAMPLING * SLOW_M**2) ** 2
    log_chance = -((found.mean() - SLOW_M**2) ** 2) / (2 * error2) - np.log(error2) / 2
    chance = SLOW_CHANCE * np.exp(log_chance - log_chance.max())
    return float(np.sqrt(chance @ SLOW_M**2 / chance.sum()))


def _cell_means(depth_m: Float32Array, size: int) -> Float64Array:
    """Return the mean depth of each square cell, nan where it is mostly unknown or contains a step."""
    rows, columns = (length // size for length in depth_m.shape)
    cells = depth_m[: rows * size, : columns * size].reshape(rows, size, columns, size).astype(np.float64)
    known = np.isfinite(cells)
    count = np.maximum(known.sum(axis=(1, 3)), 1)
    mean = np.where(known, cells, 0.0).sum(axis=(1, 3)) / count
    variance = np.where(known, (cells - mean[:, None, :, None]) ** 2, 0.0).sum(axis=(1, 3)) / count
    good = count >= _MIN_FILLED * size**2
    if good.any():
        good &= variance <= _STEP_FACTOR * np.median(variance[good])
    return np.where(good, mean, np.nan)


def _flat_windows(cells_m: Float64Array) -> Iterator[tuple[IndexArray, Float64Array]]:
    """Yield numbers of the known cells and residuals of each flat window, metres, nan where unknown."""
    plane = _plane()
    numbers = np.arange(cells_m.size).reshape(cells_m.shape)
    for top in range(0, cells_m.shape[0] - _WINDOW + 1, _STEP):
        for left in range(0, cells_m.shape[1] - _WINDOW + 1, _STEP):
            place = np.s_[top : top + _WINDOW, left : left + _WINDOW]
            depth = cells_m[place].reshape(-1)
            known: BoolArray = np.isfinite(depth)
            if known.mean() < _MIN_FILLED:
                continue
            median_m = float(np.median(depth[known]))
            surface = median_m - median_m**2 / depth  # linear over a plane, and about the depth
            for _ in range(2):
                residual = surface - plane @ np.linalg.lstsq(plane[known], surface[known], rcond=None)[0]
                rough_m = spread(residual[known])
                known = known & (np.abs(residual) <= _TRIM * rough_m + 1e-9)
            if known.mean() >= _MIN_FILLED and rough_m <= _MAX_ROUGH_M:
                yield numbers[place].reshape(-1)[known], np.where(known, residual, np.nan)


def _plane() -> Float64Array:
    """Return the three linear functions over a window, shape (cells, 3)."""
    y, x = np.mgrid[-1 : 1 : 1j * _WINDOW, -1 : 1 : 1j * _WINDOW]
    return np.stack([np.ones(_WINDOW**2), x.reshape(-1), y.reshape(-1)], axis=1)


def _products(residual: Float64Array, lags: IndexArray) -> Float64Array:
    """Return the mean product of two cells of a window at each distance, shape (lags,)."""
    known = np.isfinite(residual)
    values = np.where(known, residual, 0.0)
    pairs = np.bincount(lags, np.outer(known, known).reshape(-1), len(_LAGS))
    return np.asarray((np.bincount(lags, np.outer(values, values).reshape(-1), len(_LAGS)) / np.maximum(pairs, 1))[:-1])


@lru_cache(maxsize=8)
def _model(noise_length: float) -> tuple[IndexArray, Float64Array]:
    """Return the number of the distance of each pair of cells, and what `_products` expects, shape (lags, 3).

    The columns are white noise, noise of the given length (cells) and the slow error, each of variance 1. A plane is
    subtracted: with the covariance C and the projector Q Q' onto planes the residual has (I - Q Q') C (I - Q Q').
    """
    row, column = np.divmod(np.arange(_WINDOW**2), _WINDOW)
    distance2 = (row[:, None] - row) ** 2.0 + (column[:, None] - column) ** 2.0
    lags = np.digitize(np.sqrt(distance2), _LAGS).reshape(-1) - 1
    onto = np.linalg.qr(_plane())[0]
    count = np.bincount(lags, minlength=len(_LAGS))
    columns = []
    for length in (0.0, noise_length, SLOW_LENGTH * _CELLS):
        covariance = np.exp(-distance2 / (4 * length**2)) if length else np.eye(_WINDOW**2)
        covariance = covariance - onto @ (onto.T @ covariance)
        covariance = covariance - (covariance @ onto) @ onto.T
        columns.append(np.bincount(lags, covariance.reshape(-1), len(_LAGS)) / count)
    return lags, np.stack(columns, axis=1)[:-1]
