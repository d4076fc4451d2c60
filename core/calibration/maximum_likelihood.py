"""Maximum-likelihood fit with noise on both sides, for both alignment models.

Each pair of clicks measures ``known`` (in the tactile image) and ``seen`` (in the proximity image).
The true place ``x`` of the clicked point is unknown:

    known_i = x_i + N(0, K_i)        seen_i = f(theta, x_i) + N(0, S_i)

Maximising over theta and every x_i is the gold standard of Hartley and Zisserman, *Multiple View
Geometry*, algorithm 4.3. The x_i are eliminated point by point (their section A6.3): with A and B the
derivatives of f by theta and by x, the residual ``r = seen - f - B (known - x)`` has the covariance
``W = S + B K B^T``, and theta is fitted by Gauss-Newton steps on ``sum r^T W^-1 r``, damped after
Levenberg and Marquardt.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from ..model.arrays import BoolArray, Float64Array, IndexArray

Theta = TypeVar("Theta")

#: Prediction (N, M) and its derivatives by theta (N, M, P) and by the places (N, M, L).
Linearised = tuple[Float64Array, Float64Array, Float64Array]
#: ``(theta, places, camera)`` to the prediction and its derivatives.
Linearise = Callable[[Theta, Float64Array, IndexArray], Linearised]

#: Variance of a component that was not measured; its weight is negligible.
UNMEASURED = 1e12

_STEPS = 60
_TOLERANCE = 1e-14
_INNER_STEPS = 3


@dataclass(frozen=True, eq=False)
class Measurements:
    """Measurements on both sides, with covariances.

    Attributes
    ----------
    known : float64, shape (N, L)
    known_covariance : float64, shape (N, L, L)
        May be zero for exact values.
    seen : float64, shape (N, M)
    seen_covariance : float64, shape (N, M, M)
        Positive definite. A variance of `UNMEASURED` marks a component that was not measured.
    camera : int, shape (N,)
        Index of the camera that measured ``seen``, for models with several cameras.
    """

    known: Float64Array
    known_covariance: Float64Array
    seen: Float64Array
    seen_covariance: Float64Array
    camera: IndexArray

    def __len__(self) -> int:
        return len(self.known)

    @property
    def count(self) -> int:
        """Number of measured values in ``seen``."""
        return int((np.diagonal(self.seen_covariance, axis1=1, axis2=2) < UNMEASURED).sum())

    def keep(self, which: BoolArray) -> Measurements:
        """Return the measurements selected by a boolean mask."""
        return Measurements(
            self.known[which],
            self.known_covariance[which],
            self.seen[which],
            self.seen_covariance[which],
            self.camera[which],
        )


@dataclass(frozen=True, eq=False)
class Prior(Generic[Theta]):
    """Prior knowledge of theta: whitened residuals (Q,) and their derivative (Q, P)."""

    residuals: Callable[[Theta], tuple[Float64Array, Float64Array]]


@dataclass(frozen=True, eq=False)
class Solution(Generic[Theta]):
    """The most likely theta and its uncertainty.

    Attributes
    ----------
    theta
    places : float64, shape (N, L)
        Most likely true places.
    information : float64, shape (P, P)
        Inverse of the covariance of theta under the stated noise.
    cost : float
        ``sum r^T W^-1 r``, chi-square distributed with ``degrees`` degrees of freedom.
    distances : float64, shape (N,)
        Squared Mahalanobis distance of each point; their sum plus that of the prior is ``cost``.
    degrees : int
        Degrees of freedom: measurements minus effective parameters (a prior reduces their number).
    """

    theta: Theta
    places: Float64Array
    information: Float64Array
    cost: float
    distances: Float64Array
    degrees: int

    @property
    def noise_factor(self) -> float:
        """Observed over stated noise: sqrt(cost / degrees); 1 without degrees of freedom."""
        return float(np.sqrt(self.cost / self.degrees)) if self.degrees > 0 else 1.0


@dataclass(frozen=True, eq=False)
class _State:
    cost: float
    distances: Float64Array
    places: Float64Array
    gradient: Float64Array
    information: Float64Array
    residual: Float64Array
    weight: Float64Array
    by_theta: Float64Array
    data_information: Float64Array


def maximise(
    start: Theta,
    measurements: Measurements,
    linearise: Linearise[Theta],
    retract: Callable[[Theta, Float64Array], Theta],
    prior: Prior[Theta] | None = None,
) -> Solution[Theta]:
    """Find the most likely theta.

    Parameters
    ----------
    start
        Initial theta.
    measurements : Measurements
    linearise : callable
        See `Linearise`.
    retract : callable
        ``(theta, step)`` to theta moved by a step (P,).
    prior : Prior, optional
        Additional residuals on theta.
    """
    theta = start
    state = _evaluate(theta, measurements.known, measurements, linearise, prior)
    damping = 1e-6
    for _ in range(_STEPS):
        damped = state.information + damping * np.diag(np.diag(state.information))
        step = _solve(damped, state.gradient)
        candidate = retract(theta, step)
        trial = _evaluate(candidate, state.places, measurements, linearise, prior)
        if not trial.cost <= state.cost:
            damping *= 10
            if damping > 1e12:
                break
            continue
        gain = state.cost - trial.cost
        theta, state, damping = candidate, trial, max(damping / 10, 1e-15)
        if gain <= _TOLERANCE * state.cost or np.abs(step).max() < 1e-16:
            break
    free = np.trace(inverse_information(state.information) @ state.data_information)
    return Solution(
        theta=theta,
        places=state.places,
        information=state.information,
        cost=state.cost,
        distances=state.distances,
        degrees=measurements.count - round(float(free)),
    )


@dataclass(frozen=True, eq=False)
class Examined:
    """All pairs under a fit to some of them.

    Attributes
    ----------
    distances : float64, shape (N,)
        Squared Mahalanobis distance of each pair from the fit of all *other* pairs; infinite for a pair without which
        they determine no model.
    left_out : float64, shape (N, M)
        Residual of each pair under the fit of the other pairs; nan where its distance is infinite.
    spread : float64, shape (N,)
        Square root of the determinant of each residual's covariance, first two components: an area over 2 pi.
    information : float64, shape (P, P)
        Information that all pairs together would give.
    """

    distances: Float64Array
    left_out: Float64Array
    spread: Float64Array
    information: Float64Array


def examine(
    solution: Solution[Theta], measurements: Measurements, linearise: Linearise[Theta], used: BoolArray
) -> Examined:
    """Judge all pairs, N of them, by a solution fitted to ``measurements.keep(used)``.

    The covariance of the residual is ``W - A C A^T`` for a pair that the fit used (Cook and Weisberg, *Residuals and
    Influence in Regression*, section 2.2), and ``W + A C A^T`` for one that it did not. Both distances follow a
    chi-square distribution with M degrees of freedom, times the squared noise factor.
    """
    state = _evaluate(solution.theta, measurements.known, measurements, linearise, None)
    covariance = inverse_information(solution.information)
    pull = state.by_theta @ covariance @ state.by_theta.transpose(0, 2, 1)
    noise = np.linalg.inv(state.weight)
    values, vectors = np.linalg.eigh(noise + np.where(used, -1.0, 1.0)[:, None, None] * pull)
    along = (vectors.transpose(0, 2, 1) @ state.residual[:, :, None])[:, :, 0]
    floor = 1e-9 * np.trace(noise, axis1=1, axis2=2)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = np.where(values > floor, along**2 / values, np.where(used[:, None], np.inf, 0.0)).sum(axis=1)
        grown = noise @ vectors @ (along / values)[:, :, None]
    left_out = np.where((used & (values <= floor).any(axis=1))[:, None], np.nan, grown[:, :, 0])
    return Examined(distances, left_out, np.sqrt(np.linalg.det(noise[:, :2, :2])), state.information)


def _evaluate(
    theta: Theta,
    places: Float64Array,
    measurements: Measurements,
    linearise: Linearise[Theta],
    prior: Prior[Theta] | None,
) -> _State:
    known, known_covariance = measurements.known, measurements.known_covariance
    for _ in range(_INNER_STEPS):
        predicted, by_theta, by_place = linearise(theta, places, measurements.camera)
        residual = measurements.seen - predicted - (by_place @ (known - places)[:, :, None])[:, :, 0]
        spread = by_place @ known_covariance
        weight = np.linalg.inv(measurements.seen_covariance + spread @ by_place.transpose(0, 2, 1))
        weighted = (weight @ residual[:, :, None])[:, :, 0]
        moved = known + (spread.transpose(0, 2, 1) @ weighted[:, :, None])[:, :, 0]
        settled = np.abs(moved - places).max() <= 1e-12 * (np.abs(moved).max() + 1e-300)
        places = moved
        if settled:
            break
    shares = (residual * weighted).sum(axis=1)
    rows = by_theta.reshape(-1, by_theta.shape[2])
    information = rows.T @ (weight @ by_theta).reshape(rows.shape)
    gradient = rows.T @ weighted.ravel()
    data_information = information
    cost = float(shares.sum())
    if prior is not None:
        extra, derivative = prior.residuals(theta)
        cost += float(extra @ extra)
        gradient = gradient - derivative.T @ extra
        information = information + derivative.T @ derivative
    return _State(
        cost,
        shares,
        places,
        gradient,
        information,
        residual,
        np.asarray(weight, np.float64),
        by_theta,
        data_information,
    )


def _solve(matrix: Float64Array, right: Float64Array) -> Float64Array:
    """Solve symmetric equations after scaling to a unit diagonal, because the units are mixed."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * scale[:, None] * scale
    return np.asarray(scale * np.linalg.lstsq(scaled, right * scale, rcond=None)[0])


def inverse_information(information: Float64Array) -> Float64Array:
    """Return the covariance that belongs to an information matrix."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information * scale[:, None] * scale, rcond=1e-15, hermitian=True)
    return np.asarray(inverse * scale[:, None] * scale)


def condition_number(information: Float64Array) -> float:
    """Return the condition number of the whitened design, its columns scaled to unit length.

    Scaling makes it independent of the parameters' units (van der Sluis, 1969).
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    values = np.linalg.eigvalsh(information * scale[:, None] * scale)
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")
