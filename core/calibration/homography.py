"""The plane homography that takes tactile pixels to proximity pixels, from pairs of clicks.

Initial value: normalised direct linear transform (Hartley and Zisserman, *Multiple View Geometry*, algorithm 4.2).
Refinement: both clicks of a pair are noisy, so the gold standard of their algorithm 4.3 is used, which propagates the
tactile click's noise through the homography. OpenCV minimises the one-sided distance; that is the same for an affine
map and equal noise per pixel, but worse under strong perspective.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..errors import CalibrationError
from ..model.arrays import BoolArray, Float64Array, IndexArray
from .correspondences import check_pairs, spread
from .fit import Fit
from .maximum_likelihood import Linearised, Measurements, Problem
from .robust import fit_robustly

#: Standard deviation of a careful click with magnifier, pixels.
CLICK_SIGMA_PX = 0.7

#: Points off one plane cause large residuals without being wrong. Above this share of the points' extent the homography
#: is useless.
_MAX_RMS_SHARE = 0.05

_SAMPLE = 4
_ONE_CAMERA = np.zeros(0, np.intp)


@dataclass(frozen=True, eq=False)
class HomographyFit(Fit):
    """A fitted homography with its statistics."""

    problem: HomographyProblem

    @property
    def H_p_t(self) -> Float64Array:
        """Tactile to proximity pixels, shape (3, 3), scaled to a lower right entry of 1 unless that is 0."""
        return self.problem.pixels_matrix(self.solution.theta)


class HomographyProblem(Problem):
    """Homography estimation in coordinates with centroid 0 and mean distance sqrt(2).

    Theta holds the matrix without its lower right entry. That is 1, because the points' centroid is mapped to a place.
    """

    name = "homography"
    sample_size = _SAMPLE

    def __init__(self, tactile: Float64Array, proximity: Float64Array, names: Sequence[str] | None) -> None:
        self.names = names or [str(number) for number in range(1, len(tactile) + 1)]
        self.tactile_center, self.tactile_scale = normalisation(tactile)
        self.proximity_center, self.proximity_scale = normalisation(proximity)
        count, unit = len(tactile), np.eye(2)
        self.measurements = Measurements(
            self.to_normal_tactile(tactile),
            np.broadcast_to(unit * (CLICK_SIGMA_PX * self.tactile_scale) ** 2, (count, 2, 2)),
            (proximity - self.proximity_center) * self.proximity_scale,
            np.broadcast_to(unit * (CLICK_SIGMA_PX * self.proximity_scale) ** 2, (count, 2, 2)),
            np.zeros(count, np.intp),
        )
        self.square_pixels = np.full(count, self.proximity_scale**-2.0)
        self.noise_px = float(np.hypot(CLICK_SIGMA_PX * self.tactile_scale / self.proximity_scale, CLICK_SIGMA_PX))
        extent, self.area = spread(proximity)
        self.largest_px, self.largest_rms_px = np.inf, _MAX_RMS_SHARE * extent

    def to_normal_tactile(self, tactile: Float64Array) -> Float64Array:
        """Normalise tactile pixels (N, 2)."""
        return np.asarray((tactile - self.tactile_center) * self.tactile_scale)

    def linearise(self, theta: Float64Array, places: Float64Array, camera: IndexArray) -> Linearised:
        """Predict in normalised coordinates."""
        H = np.append(theta, 1.0).reshape(3, 3)
        homogeneous = np.column_stack([places, np.ones(len(places))])
        x, y, w = (homogeneous @ H.T).T
        predicted = np.column_stack([x / w, y / w])
        scaled = homogeneous / w[:, None]
        by_theta = np.zeros((len(places), 2, 8))
        by_theta[:, 0, :3] = by_theta[:, 1, 3:6] = scaled
        by_theta[:, :, 6:] = -predicted[:, :, None] * scaled[:, None, :2]
        by_place = (H[None, :2, :2] - predicted[:, :, None] * H[None, 2, None, :2]) / w[:, None, None]
        return predicted, by_theta, by_place

    def start(self, used: BoolArray) -> Float64Array | None:
        """Return the direct linear transform of the used pairs."""
        data = self.measurements
        H = direct_linear_transform(data.known[used], data.seen[used]).ravel()
        return np.asarray(H[:8] / H[8]) if H[8] else None

    def hypotheses(self, samples: IndexArray) -> list[Float64Array]:
        """Solve the 8 x 8 equations of all samples at once, with the lower right entry fixed at 1."""
        x, y = self.measurements.known[samples], self.measurements.seen[samples]
        rows = np.zeros((len(samples), 2 * _SAMPLE, 8))
        rows[:, 0::2, 0:2], rows[:, 0::2, 2] = x, 1.0
        rows[:, 1::2, 3:5], rows[:, 1::2, 5] = x, 1.0
        rows[:, 0::2, 6:], rows[:, 1::2, 6:] = -x * y[:, :, :1], -x * y[:, :, 1:]
        regular = np.linalg.cond(rows) < 1e6
        return list(np.linalg.solve(rows[regular], y[regular].reshape(-1, 8, 1))[:, :, 0])

    def residuals_px(self, theta: Float64Array) -> Float64Array:
        """Return residual lengths in proximity pixels, infinite beyond the horizon, shape (N,)."""
        places = self.measurements.known
        w = places @ theta[6:8] + 1.0
        with np.errstate(divide="ignore", invalid="ignore"):
            x = (places @ theta[0:2] + theta[2]) / w - self.measurements.seen[:, 0]
            y = (places @ theta[3:5] + theta[5]) / w - self.measurements.seen[:, 1]
        distance = np.hypot(x, y) / self.proximity_scale
        beyond_horizon = w * np.sign(w.sum()) <= 0
        return np.asarray(np.where(beyond_horizon | ~np.isfinite(distance), np.inf, distance))

    def residual_vectors_px(self, theta: Float64Array) -> Float64Array:
        """Return clicked minus predicted proximity pixel of every pair, shape (N, 2)."""
        predicted, _, _ = self.linearise(theta, self.measurements.known, _ONE_CAMERA)
        return np.asarray((self.measurements.seen - predicted) / self.proximity_scale)

    def predict(self, theta: Float64Array, places: Float64Array) -> Float64Array:
        """Map tactile pixels (N, 2 or more columns) to proximity pixels (N, 2)."""
        predicted, _, _ = self.linearise(theta, self.to_normal_tactile(places[:, :2]), _ONE_CAMERA)
        return np.asarray(predicted / self.proximity_scale + self.proximity_center)

    def sensitivity(self, theta: Float64Array, places: Float64Array) -> Float64Array:
        """Return the derivative of `predict` by theta, shape (N, 2, 8)."""
        _, by_theta, _ = self.linearise(theta, self.to_normal_tactile(places[:, :2]), _ONE_CAMERA)
        return np.asarray(by_theta / self.proximity_scale)

    def pixels_matrix(self, theta: Float64Array) -> Float64Array:
        """Undo the normalisation of the fitted matrix."""
        to_normal = _similarity(self.tactile_center, self.tactile_scale)
        from_normal = np.linalg.inv(_similarity(self.proximity_center, self.proximity_scale))
        H = from_normal @ np.append(theta, 1.0).reshape(3, 3) @ to_normal
        return np.asarray(H / H[2, 2] if abs(H[2, 2]) > 1e-12 * np.abs(H[2]).max() else H / np.linalg.norm(H))


def fit_homography(
    tactile: npt.ArrayLike,
    proximity: npt.ArrayLike,
    *,
    use: npt.ArrayLike | None = None,
    names: Sequence[str] | None = None,
) -> HomographyFit:
    """Fit the homography from tactile to proximity pixels; outliers are rejected.

    Parameters
    ----------
    tactile, proximity : array_like, shape (N, 2)
        Clicked pixels.
    use : bool, shape (N,), optional
        Inliers, if already known.
    names : sequence of str, optional
        Names of the pairs for refusals; default: their numbers from 1.

    Raises
    ------
    CalibrationError
        There are fewer than four pairs, the points are collinear, coincident or mirrored, or the pairs do not agree on
        one homography.
    """
    tactile, proximity = check_pairs(tactile, proximity, _SAMPLE, "homography")
    problem = HomographyProblem(tactile, proximity, names)
    fit = fit_robustly(problem, None if use is None else np.asarray(use, bool))
    _refuse_mirrored(problem, fit.solution.theta, fit.used)
    return HomographyFit(problem, fit.solution, fit.used, fit.rivals)


def direct_linear_transform(source: npt.ArrayLike, target: npt.ArrayLike) -> Float64Array:
    """Return the 3 x 3 matrix that minimises the algebraic error, Frobenius norm 1; no normalisation.

    Hartley and Zisserman, equation 4.3 and section 4.1.1.
    """
    equations = design_matrix(source, target)
    equations = np.vstack([equations, np.zeros((max(9 - len(equations), 0), 9))])
    return np.asarray(np.linalg.svd(equations, full_matrices=False)[2][-1].reshape(3, 3))


def design_matrix(source: npt.ArrayLike, target: npt.ArrayLike) -> Float64Array:
    """Return the equations A h = 0 of pairs (N, 2), shape (2 N, 9)."""
    x, y = np.asarray(source, np.float64), np.asarray(target, np.float64)
    homogeneous = np.column_stack([x, np.ones(len(x))])
    rows = np.zeros((len(x), 2, 9))
    rows[:, 0, :3] = rows[:, 1, 3:6] = homogeneous
    rows[:, :, 6:] = -y[:, :, None] * homogeneous[:, None, :]
    return rows.reshape(-1, 9)


def normalisation(points: Float64Array) -> tuple[Float64Array, float]:
    """Return the centroid and the factor that makes the mean distance from it sqrt(2)."""
    center = points.mean(axis=0)
    distance = float(np.hypot(*(points - center).T).mean())
    return center, float(np.sqrt(2) / distance)


def _similarity(center: Float64Array, scale: float) -> Float64Array:
    return np.array([[scale, 0.0, -scale * center[0]], [0.0, scale, -scale * center[1]], [0.0, 0.0, 1.0]])


def _refuse_mirrored(problem: HomographyProblem, theta: Float64Array, used: BoolArray) -> None:
    """Raise if the map reverses orientation: a surface seen twice from the same side keeps its orientation."""
    _, _, by_place = problem.linearise(theta, problem.measurements.known[used], _ONE_CAMERA)
    turning = np.linalg.det(by_place) > 0
    if not turning.any():
        raise CalibrationError(
            "the points run around in opposite senses in both images: one image is mirrored, or left and right "
            "partners are swapped; flip the image or click the pairs again"
        )
    if not turning.all():
        raise CalibrationError(
            "the homography folds the image over between the points: some partners are swapped; "
            "check the order of the pairs"
        )
