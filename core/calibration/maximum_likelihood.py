"""Maximum-likelihood fit with noise on both sides, for both alignment models.

Each pair of clicks measures ``known`` (in the tactile image) and ``seen`` (in the proximity image).
The true place ``x`` of the clicked point is unknown:

    known_i = x_i + N(0, K_i)        seen_i = f(theta, x_i) + N(0, S_i)

Maximising over theta and every x_i is the gold standard of Hartley and Zisserman, *Multiple View
Geometry*, algorithm 4.3. The x_i are eliminated point by point (their section A6.3): with A and B the
derivatives of f by theta and by x, the residual ``r = seen - f - B (known - x)`` has the covariance
``W = S + B K B^T``, and theta minimises ``sum r^T W^-1 r`` (SciPy's Levenberg-Marquardt).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from ..errors import CalibrationError
from ..model.arrays import BoolArray, Float64Array, IndexArray

#: Prediction (N, M) and its derivatives by theta (N, M, P) and by the places (N, M, L).
Linearised = tuple[Float64Array, Float64Array, Float64Array]

#: Variance of a component that was not measured; its weight is negligible.
UNMEASURED = 1e12

_TOLERANCE, _MAX_EVALUATIONS = 1e-14, 60
_INNER_STEPS = 10


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
        return Measurements(**{name: values[which] for name, values in vars(self).items()})


class Problem(ABC):
    """A model for the robust fit; its parameters are a vector theta (P,).

    Attributes
    ----------
    names : sequence of str
        Names of the pairs, for messages.
    noise_px : float
        Noise of a residual if the stated one is right, pixels.
    square_pixels : float64, shape (N,)
        Square pixels per square unit of ``seen``.
    area : float
        Area over which wrong points are distributed, pixels squared.
    largest_px, largest_rms_px : float
        Largest residual of an inlier, and largest RMS residual of an alignment, pixels.
    """

    name: str
    sample_size: int
    measurements: Measurements
    names: Sequence[str]
    noise_px: float
    square_pixels: Float64Array
    area: float
    largest_px: float
    largest_rms_px: float

    @abstractmethod
    def linearise(self, theta: Float64Array, places: Float64Array, camera: IndexArray) -> Linearised:
        """Predict ``seen`` of places, with derivatives."""

    def prior(self, theta: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return no prior knowledge of theta."""
        return np.zeros(0), np.zeros((0, len(theta)))

    @abstractmethod
    def start(self, used: BoolArray) -> Float64Array | None:
        """Return an initial theta from some pairs, or None if they determine none."""

    @abstractmethod
    def hypotheses(self, samples: IndexArray) -> list[Float64Array]:
        """Return the models of index samples (M, sample_size)."""

    @abstractmethod
    def residuals_px(self, theta: Float64Array) -> Float64Array:
        """Return each pair's distance in proximity pixels, shape (N,), quickly."""

    @abstractmethod
    def residual_vectors_px(self, theta: Float64Array) -> Float64Array:
        """Return clicked minus predicted pixel of each pair, shape (N, 2), exactly."""

    @abstractmethod
    def predict(self, theta: Float64Array, places: Float64Array) -> Float64Array:
        """Map places (tactile u, v, and depth where it counts) to proximity pixels (N, 2)."""

    @abstractmethod
    def sensitivity(self, theta: Float64Array, places: Float64Array) -> Float64Array:
        """Return the derivative of `predict` by theta, shape (N, 2, P)."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The most likely theta and its uncertainty.

    Attributes
    ----------
    theta : float64, shape (P,)
    information : float64, shape (P, P)
        Inverse of the covariance of theta under the stated noise.
    cost : float
        ``sum r^T W^-1 r``, chi-square distributed with ``degrees`` degrees of freedom.
    degrees : int
        Degrees of freedom: measurements minus effective parameters (a prior reduces their number).
    """

    theta: Float64Array
    information: Float64Array
    cost: float
    degrees: int

    @property
    def noise_factor(self) -> float:
        """Observed over stated noise: sqrt(cost / degrees); 1 without degrees of freedom."""
        return float(np.sqrt(self.cost / self.degrees)) if self.degrees > 0 else 1.0


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals (N, M) at one theta, the inverse of their covariance (N, M, M), and the design A (N, M, P)."""

    residual: Float64Array
    weight: Float64Array
    by_theta: Float64Array

    def whitened(self) -> tuple[Float64Array, Float64Array]:
        """Return design (N, M, P) and residuals (N, M) with unit noise."""
        root = np.linalg.cholesky(self.weight).transpose(0, 2, 1)
        return np.asarray(root @ self.by_theta), np.asarray((root @ self.residual[:, :, None])[:, :, 0])


def residuals_at(problem: Problem, theta: Float64Array, data: Measurements) -> Residuals:
    """Return the residuals of measurements, each at its most likely place."""
    places = data.known
    for _ in range(_INNER_STEPS):
        predicted, by_theta, by_place = problem.linearise(theta, places, data.camera)
        residual = data.seen - predicted - (by_place @ (data.known - places)[:, :, None])[:, :, 0]
        spread = by_place @ data.known_covariance
        weight = np.linalg.inv(data.seen_covariance + spread @ by_place.transpose(0, 2, 1))
        moved = data.known + (spread.transpose(0, 2, 1) @ weight @ residual[:, :, None])[:, :, 0]
        settled = np.abs(moved - places).max() <= 1e-12 * (np.abs(moved).max() + 1e-300)
        places = moved
        if settled:
            break
    return Residuals(residual, np.asarray(weight, np.float64), by_theta)


def maximise(problem: Problem, used: BoolArray, start: Float64Array) -> Solution:
    """Find the most likely theta (P,) of the used pairs, from an initial one.

    Raises
    ------
    CalibrationError
        The pairs determine none.
    """
    data = problem.measurements.keep(used)
    newest: dict[bytes, tuple[Float64Array, Float64Array]] = {}

    def system(theta: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return whitened residuals of pairs and prior, and their derivative."""
        if theta.tobytes() not in newest:
            design, residual = residuals_at(problem, theta, data).whitened()
            extra, by_extra = problem.prior(theta)
            newest.clear()
            newest[theta.tobytes()] = (
                np.append(residual, extra),
                np.vstack([-design.reshape(-1, len(theta)), by_extra]),
            )
        return newest[theta.tobytes()]

    def residuals(theta: Float64Array) -> Float64Array:
        return system(theta)[0]

    def derivative(theta: Float64Array) -> Float64Array:
        return system(theta)[1]

    try:
        with np.errstate(all="ignore"):
            found = least_squares(
                residuals, start, derivative, method="lm", x_scale="jac", ftol=_TOLERANCE, xtol=_TOLERANCE,
                gtol=_TOLERANCE, max_nfev=_MAX_EVALUATIONS,
            )  # fmt: skip
            final, rows = system(found.x)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise CalibrationError(
            f"the pairs determine no {problem.name} ({error}); spread them over the image"
        ) from error
    information, by_prior = rows.T @ rows, problem.prior(found.x)[1]
    free = np.trace(inverse_information(information) @ (information - by_prior.T @ by_prior))
    return Solution(found.x, information, float(final @ final), data.count - round(float(free)))


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
        Information that all pairs together and the prior would give.
    """

    distances: Float64Array
    left_out: Float64Array
    spread: Float64Array
    information: Float64Array


def examine(problem: Problem, solution: Solution, used: BoolArray) -> Examined:
    """Judge all pairs, N of them, by a solution fitted to the used ones.

    The covariance of the residual is ``W - A C A^T`` for a pair that the fit used (Cook and Weisberg, *Residuals and
    Influence in Regression*, section 2.2), and ``W + A C A^T`` for one that it did not. Both distances follow a
    chi-square distribution with M degrees of freedom, times the squared noise factor.
    """
    at = residuals_at(problem, solution.theta, problem.measurements)
    pull = at.by_theta @ inverse_information(solution.information) @ at.by_theta.transpose(0, 2, 1)
    noise = np.linalg.inv(at.weight)
    values, vectors = np.linalg.eigh(noise + np.where(used, -1.0, 1.0)[:, None, None] * pull)
    along = (vectors.transpose(0, 2, 1) @ at.residual[:, :, None])[:, :, 0]
    floor = 1e-9 * np.trace(noise, axis1=1, axis2=2)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = np.where(values > floor, along**2 / values, np.where(used[:, None], np.inf, 0.0)).sum(axis=1)
        grown = noise @ vectors @ (along / values)[:, :, None]
    left_out = np.where((used & (values <= floor).any(axis=1))[:, None], np.nan, grown[:, :, 0])
    by_prior = problem.prior(solution.theta)[1]
    information = np.einsum("nmp,nml,nlq->pq", at.by_theta, at.weight, at.by_theta, optimize=True)
    return Examined(distances, left_out, np.sqrt(np.linalg.det(noise[:, :2, :2])), information + by_prior.T @ by_prior)


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
