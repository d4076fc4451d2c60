"""Quality of a fit: predicted uncertainty, coverage of the image, and the effect on a contact patch.

All numbers follow from the fit's own covariance: with P whitened parameters, a place's predicted pixel
moves by ``J e`` for a standard normal ``e`` (P,), so its covariance is ``J J^T``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
import numpy.typing as npt

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
_DRAWS = 40_000


class Fitted(Protocol):
    """A fit, or its `Agreement`, which contains smooth errors, too."""

    def sensitivity(self, places: npt.ArrayLike) -> Float64Array:
        """Return the derivative (N, 2, P) of the alignment by parameters of unit covariance."""


@dataclass(frozen=True, eq=False)
class UncertaintyMap:
    """Expected root mean square alignment error at places (M, 3) of the membrane.

    In proximity pixels, and in millimetres across the line of sight at that depth, both shape (M,).
    """

    places: Float64Array
    sigma_px: Float64Array
    sigma_mm: Float64Array


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


def uncertainty_map(fit: Fit, errors: Fitted, places: Float64Array, rig: Rig) -> UncertaintyMap:
    """Return the expected errors at places (M, 3) of the membrane that the fit predicts inside the proximity image."""
    height, width = rig.proximity.intrinsics.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        proximity = fit.predict(places)
        inside = ((proximity >= 0) & (proximity <= (width - 1, height - 1))).all(axis=1)
    inside = inside if inside.any() else np.ones(len(places), bool)
    places = places[inside]
    sigma_px = np.sqrt((errors.sensitivity(places) ** 2).sum(axis=(1, 2)))
    return UncertaintyMap(places, sigma_px, sigma_px * millimetres_per_pixel(places[:, 2], rig))


def millimetres_per_pixel(depth_m: npt.ArrayLike, rig: Rig) -> Float64Array:
    """Return the width of a proximity pixel at a depth, millimetres."""
    lens = rig.proximity.intrinsics
    return np.asarray(np.asarray(depth_m) * 2000.0 / (lens.fx + lens.fy))


def bound(derivative: Float64Array, degrees: int) -> float:
    """Return the 95 % bound of the root mean square error over places, pixels.

    The squared error ``e^T M e``, ``M = mean J^T J``, is a sum of chi-squares weighted by M's eigenvalues. If the noise
    was estimated from ``degrees`` surplus measurements, it is divided by their chi-square; with equal weights this is
    an F ratio. The quantile is computed from seeded random draws.

    ``derivative`` is `Fitted.sensitivity` at the places, shape (M, 2, P); no degrees mean the stated noise.
    """
    rows = derivative.reshape(-1, derivative.shape[2])
    weights = np.maximum(np.linalg.eigvalsh(rows.T @ rows)[::-1], 0.0) / len(derivative)
    squares = _squares()[:, : len(weights)]
    count = squares.shape[1]
    errors = squares @ weights[:count] + weights[count:].sum()
    return float(np.sqrt(np.quantile(errors / _noise(degrees), 0.95)))


@dataclass(frozen=True)
class PatchEffect:
    """Effect of the alignment error on a contact patch.

    Expected error of the patch's boundary, expected difference of both distances at true contact, and the smallest
    tolerance t with which 95 % of the pixels in contact pass.
    """

    boundary_mm: float
    depth_mm: float
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
        depth_mm=float(np.sqrt(variance.mean())),
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


@lru_cache(maxsize=1)
def _squares() -> Float64Array:
    """Squared normals, shape (draws, 16)."""
    return np.asarray(np.random.default_rng(20).standard_normal((_DRAWS, 16)) ** 2)


@lru_cache(maxsize=64)
def _noise(degrees: int) -> Float64Array:
    """Ratios of estimated to true noise variance, shape (draws,)."""
    if degrees <= 0:
        return np.ones(_DRAWS)
    return np.asarray(np.random.default_rng(21).chisquare(degrees, _DRAWS) / degrees)
