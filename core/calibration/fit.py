"""A model fitted to pairs: what the fits of the homography and of the rigid alignment have in common."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..model.arrays import BoolArray, Float64Array
from .maximum_likelihood import Problem, Solution, condition_number, examine, inverse_information

#: Weight of the stated noise beside the observed one, in degrees of freedom.
STATED_DEGREES = 12.0
#: Pairs on which a rival of this weight differs are doubtful. No correct set of 6 to 12 pairs in 300 has one.
_DOUBTFUL = 0.01


@dataclass(frozen=True, eq=False)
class Rival:
    """Another subset that the data do not rule out: its fit, its inliers, and its probability against the best one."""

    theta: Float64Array
    used: BoolArray
    weight: float


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model with its statistics.

    Attributes
    ----------
    problem : Problem
    solution : Solution
    used : bool, shape (N,)
        Inliers.
    rivals : tuple of Rival
    """

    problem: Problem
    solution: Solution
    used: BoolArray
    rivals: tuple[Rival, ...] = ()

    @property
    def parameters(self) -> int:
        """Number of fitted parameters."""
        return len(self.solution.theta)

    @property
    def degrees(self) -> int:
        """Degrees of freedom: measurements minus parameters."""
        return self.solution.degrees

    @property
    def noise_factor(self) -> float:
        """Observed noise relative to the stated click noise; 1 without degrees of freedom.

        Few pairs chosen to agree say little, so the stated noise counts beside them.
        """
        if self.used.all():
            return self.solution.noise_factor
        return float(np.sqrt((STATED_DEGREES + self.solution.cost) / (STATED_DEGREES + self.solution.degrees)))

    @property
    def condition(self) -> float:
        """Condition number of the scaled design."""
        return condition_number(self.solution.information)

    @property
    def covariance(self) -> Float64Array:
        """Covariance of theta, shape (P, P)."""
        return np.asarray(self.noise_factor**2 * inverse_information(self.solution.information))

    @cached_property
    def residuals_px(self) -> Float64Array:
        """Clicked minus predicted pixel in the proximity image that was clicked, shape (N, 2)."""
        return self.problem.residual_vectors_px(self.solution.theta)

    @property
    def rms_px(self) -> float:
        """Root mean square residual of the inliers, proximity pixels."""
        return float(np.sqrt((self.residuals_px[self.used] ** 2).sum(axis=1).mean()))

    @property
    def doubtful(self) -> tuple[int, ...]:
        """Pairs that may be right or wrong; the data do not decide."""
        likely = [rival.used != self.used for rival in self.rivals if rival.weight > _DOUBTFUL]
        return tuple(np.flatnonzero(np.any(likely, axis=0)).tolist()) if likely else ()

    def left_out_residuals_px(self) -> Float64Array:
        """Return each pair's residual (N, 2) under the fit of the other pairs; nan if they determine no model."""
        grown = examine(self.problem, self.solution, self.used).left_out[:, :2]
        pixels = grown * np.sqrt(self.problem.square_pixels)[:, None]
        return np.where(self.used[:, None], pixels, self.residuals_px)

    def predict(self, places: npt.ArrayLike) -> Float64Array:
        """Map places (tactile u, v, and depth where it counts) to proximity depth pixels (N, 2)."""
        return self.problem.predict(self.solution.theta, np.asarray(places, np.float64))

    def sensitivity(self, places: npt.ArrayLike) -> Float64Array:
        """Return the derivative (N, 2, P) of predicted proximity depth pixels by whitened parameters.

        Whitened parameters have unit covariance, so ``J J^T`` is the covariance of the prediction.
        """
        by_theta = self.problem.sensitivity(self.solution.theta, np.asarray(places, np.float64))
        return np.asarray(by_theta @ np.linalg.cholesky(self.covariance))

    def rivals_px(self, places: npt.ArrayLike) -> Float64Array:
        """Return how far each rival is from the fit at N places, for its probability, shape (N, 2, K).

        Probabilities below 1 count as their root, because their tails rest on the form of the noise.
        """
        best, at = self.predict(places), np.asarray(places, np.float64)
        moved = [rival.weight**0.25 * (self.problem.predict(rival.theta, at) - best) for rival in self.rivals]
        return np.stack(moved, axis=2) if moved else np.zeros((*best.shape, 0))
