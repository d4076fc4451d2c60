"""Quality of a fit: predicted uncertainty, coverage of the image, and the effect on a contact patch.

All numbers follow from the fit's own covariance: with P whitened parameters, a place's predicted pixel
moves by ``J e`` for a standard normal ``e`` (P,), so its covariance is ``J J^T``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri, fdtri

from ..model.arrays import Float64Array
from ..model.frames import Rig
from .fits import Fit

#: Noise of one pixel of either depth camera on this sensor, metres.
PROXIMITY_NOISE_M = 0.001
TACTILE_NOISE_M = 0.0005
#: Typical slope of the membrane across the line of sight; tangent of the angle at which it leaves an object.
MEMBRANE_SLOPE = 0.5
TAKE_OFF_TANGENT = 1.0
#: Two-sided 95 % quantile of the normal distribution: share of the pixels in contact that pass the tolerance test.
_PASSING_SIGMAS = 1.96

_GRID = (13, 10)
_MEMBRANE_SHARE = np.array([0.8, 0.65])


def membrane_places(tactile: Float64Array, depth_m: Float64Array, rig: Rig) -> Float64Array:
    """Return a grid over the membrane with depths interpolated from the clicked points, shape (M, 3).

    The membrane is assumed to fill the central `_MEMBRANE_SHARE` of the tactile image and to contain all points.
    Depths are interpolated by inverse squared distance; 0.3 m if no point has depth.
    """
    height, width = rig.tactile.intrinsics.shape
    size = np.array([width - 1.0, height - 1.0])
    low = np.minimum(size * (1 - _MEMBRANE_SHARE) / 2, tactile.min(axis=0))
    high = np.maximum(size * (1 + _MEMBRANE_SHARE) / 2, tactile.max(axis=0))
    u, v = np.meshgrid(np.linspace(low[0], high[0], _GRID[0]), np.linspace(low[1], high[1], _GRID[1]))
    places = np.stack([u.ravel(), v.ravel()], axis=1)
    known = np.isfinite(depth_m)
    if not known.any():
        return np.column_stack([places, np.full(len(places), 0.3)])
    gaps = ((places[:, None] - tactile[None, known]) ** 2).sum(axis=2)
    weights = 1.0 / (gaps + 20.0**2)
    return np.column_stack([places, weights @ depth_m[known] / weights.sum(axis=1)])


def seen_places(fit: Fit, places: Float64Array, rig: Rig) -> Float64Array:
    """Return those of places (M, 3) that the fit predicts inside the proximity image; all if there are none."""
    height, width = rig.proximity.intrinsics.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        proximity = fit.predict(places)
        inside = ((proximity >= 0) & (proximity <= (width - 1, height - 1))).all(axis=1)
    return places[inside] if inside.any() else places


def millimetres_per_pixel(depth_m: npt.ArrayLike, rig: Rig) -> Float64Array:
    """Return the width of a proximity pixel at a depth, millimetres."""
    lens = rig.proximity.intrinsics
    return np.asarray(np.asarray(depth_m) * 2000.0 / (lens.fx + lens.fy))


def bound(derivative: Float64Array, degrees: int) -> float:
    """Return the 95 % bound of the root mean square error over places, pixels.

    The squared error ``e^T M e``, ``M = mean J^T J``, is a sum of chi-squares weighted by M's eigenvalues, about one
    chi-square of as many degrees as gives the same mean and variance (Box 1954). If the noise was estimated from
    ``degrees`` surplus measurements, it is divided by their chi-square. No degrees mean the stated noise.

    ``derivative`` is `Agreement.sensitivity` at the places, shape (M, 2, P).
    """
    rows = derivative.reshape(-1, derivative.shape[2])
    weights = rows.T @ rows / len(derivative)
    mean = float(np.trace(weights))
    if mean <= 0.0:
        return 0.0
    of_error = mean**2 / float((weights**2).sum())
    ratio = fdtri(of_error, degrees, 0.95) if degrees > 0 else chdtri(of_error, 0.05) / of_error
    return float(np.sqrt(mean * ratio))


@dataclass(frozen=True)
class PatchEffect:
    """Effect of the alignment error on a contact patch.

    Expected error of the patch's boundary, and the smallest tolerance t with which 95 % of the pixels in contact pass.
    """

    boundary_mm: float
    supported_tolerance: float


def patch_effect(lateral_mm: npt.ArrayLike, along_mm: npt.ArrayLike, distance_m: npt.ArrayLike) -> PatchEffect:
    """Propagate alignment errors to the contact test ``|dp - dt| <= t dp``.

    A lateral error l reads the tactile depth beside the right place; on a membrane of slope m this changes dt by
    ``m l``. An error a along the line of sight changes dp by a. Both sensors add noise,
    `PROXIMITY_NOISE_M` (n_p) and `TACTILE_NOISE_M` (n_t). At true contact:

        s_i^2 = a_i^2 + (m l_i)^2 / 2 + n_p^2 + n_t^2,        t = 1.96 sqrt(mean (s_i / d_i)^2)

    (l is the error in two directions, the slope is along one). If the membrane leaves the object at an angle with
    tangent g, the boundary moves by ``sqrt(l^2 + (a / g)^2)``.
    All three are given at places of the membrane, shape (M,).
    """
    lateral, along = np.asarray(lateral_mm, np.float64), np.asarray(along_mm, np.float64)
    sensors = (PROXIMITY_NOISE_M**2 + TACTILE_NOISE_M**2) * 1e6
    variance = along**2 + (MEMBRANE_SLOPE * lateral) ** 2 / 2 + sensors
    relative = variance / (np.asarray(distance_m, np.float64) * 1e3) ** 2
    return PatchEffect(
        boundary_mm=float(np.sqrt(np.mean(lateral**2 + (along / TAKE_OFF_TANGENT) ** 2))),
        supported_tolerance=float(_PASSING_SIGMAS * np.sqrt(relative.mean())),
    )


@dataclass(frozen=True)
class Coverage:
    """Number of points in each part of a 3 x 4 grid over the proximity image, and their range of tactile depth."""

    cells: tuple[tuple[int, ...], ...]
    depth_range_m: tuple[float, float] | None

    @property
    def depth_span_mm(self) -> float:
        """Range of the tactile depths, millimetres; 0 without depths."""
        return 0.0 if self.depth_range_m is None else 1e3 * (self.depth_range_m[1] - self.depth_range_m[0])


def coverage(proximity: Float64Array, depth_m: Float64Array, rig: Rig) -> Coverage:
    """Return the coverage of points (N, 2) in the proximity image."""
    height, width = rig.proximity.intrinsics.shape
    counts, _, _ = np.histogram2d(
        proximity[:, 1], proximity[:, 0], bins=(3, 4), range=((-0.5, height - 0.5), (-0.5, width - 0.5))
    )
    known = depth_m[np.isfinite(depth_m)]
    return Coverage(
        cells=tuple(tuple(int(count) for count in row) for row in counts),
        depth_range_m=(float(known.min()), float(known.max())) if len(known) else None,
    )
