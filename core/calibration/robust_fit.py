"""Robust fits of both alignment models to point pairs: wrong clicks are found by evidence, inliers by least squares.

OpenCV proposes models (RANSAC with SQPnP for a pose, MAGSAC for a homography) at several thresholds. Under each model
the k nearest pairs are inliers with the k of the largest evidence: the noise is near the stated one with an inverse
chi-square prior, so residuals follow a Student t (MacKay 2003, *Information Theory, Inference, and Learning
Algorithms*, chapter 28), and a wrong pair lies anywhere within an area. The inliers are fitted by SciPy's
Levenberg-Marquardt. Both clicks of a pair and the tactile depth are noisy, so residuals are whitened by
``W = S + B K B^T`` with the covariances S and K of both sides and the derivative B of the prediction by the place
(Hartley and Zisserman, *Multiple View Geometry*, section A6.3). The covariance of the parameters is ``(J^T J)^-1``
times the observed noise.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import ClassVar

import cv2
import numpy as np
import numpy.typing as npt

from ..errors import CalibrationError
from ..model.arrays import BoolArray, Float64Array
from ..model.frames import Rig, pose_matrix
from .geometry import Alignment, clicks_in_depth, ray_seen
from .points import PointArrays, check_points, listed

#: Standard deviations: of a careful click with magnifier, pixels; of the tactile depth under it, metres.
CLICK_SIGMA_PX, _DEPTH_SIGMA_M = 0.7, 0.0005
#: Standard deviation of the prior on the offset of the tactile depth, metres; it keeps an undetermined offset finite.
_OFFSET_SIGMA_M = 0.03
#: Steps of the numeric derivatives by places: pixels and metres.
_PLACE_STEPS = (0.5, 0.5, 1e-4)
_THETA_STEP = 1e-6

#: Thresholds for OpenCV's proposals, in units of the stated noise of a residual.
_THRESHOLDS = (3.0, 6.0, 12.0)
_ITERATIONS, _CONFIDENCE = 2000, 0.9999
#: OpenCV's proposals use at most about this many pairs, evenly chosen.
_PROPOSING = 1000
#: How often the inliers of a proposal are fitted and chosen again.
_ROUNDS = 3
#: Weight of the stated noise beside the observed one, in degrees of freedom.
_STATED_DEGREES = 12.0
#: A wrong click lies within this distance of the right one, as a rule, pixels.
_WRONG_PX = 150.0
#: Least log evidence against chance for each pair more than the model needs, up to `_SURPLUS` of them.
_SIGNIFICANT, _SURPLUS = np.log(100.0), 3
#: Smallest share of inliers; with fewer, the outliers might be the right ones.
MIN_INLIER_SHARE = 0.55
#: Above this condition number of the scaled design, the result is dominated by noise.
_MAX_CONDITION = 3e4
#: A pair with a larger residual is an outlier of a rigid model, which is exact, pixels.
_MAX_RIGID_PX = 12.0


class Model(ABC):
    """A model with parameters theta (P,); ``sample`` pairs determine it, an inlier is off by at most ``largest_px``."""

    name: ClassVar[str]
    sample: ClassVar[int]
    largest_px: ClassVar[float]

    def __init__(self, points: PointArrays, rig: Rig, names: Sequence[str], sigma_px: float) -> None:
        self.points, self.rig, self.sigma_px = points, rig, sigma_px
        self.names = names or [str(number) for number in range(1, len(points) + 1)]
        self.proposing = np.arange(0, len(points), -(-len(points) // _PROPOSING))
        low, high = points.proximity.min(axis=0), points.proximity.max(axis=0)
        sides = 1.1 * np.maximum(high - low, 1e-12)
        #: Area over which wrong pairs are distributed, pixels squared.
        self.area = float(max(sides[0] * sides[1], 0.1 * (sides @ sides)))

    @abstractmethod
    def alignment(self, theta: Float64Array) -> Alignment:
        """Return the alignment of theta."""

    @abstractmethod
    def proposals(self, noise_px: float) -> list[Float64Array]:
        """Return thetas by OpenCV, the fit to all that it uses first."""

    def prior(self, theta: Float64Array) -> Float64Array:
        """Return whitened residuals of what is known beforehand."""
        return theta[:0]

    def seen(self, theta: Float64Array, places: Float64Array) -> Float64Array:
        """Predict the clicked proximity pixels (N, 2) from a place of each pair (N, 3: tactile pixel and depth)."""
        return self.alignment(theta).pixels(self.rig, places, self.points.in_color)

    def residuals_px(self, theta: Float64Array) -> Float64Array:
        """Return clicked minus predicted pixel of each pair, shape (N, 2)."""
        return self.points.proximity - self.seen(theta, self.points.places)

    def covariances(self, theta: Float64Array) -> Float64Array:
        """Return the covariance of each pair's residual, shape (N, 2, 2)."""
        known = np.array([self.sigma_px, self.sigma_px, _DEPTH_SIGMA_M])
        by_place = np.stack(
            [
                (self.seen(theta, self.points.places + step) - self.seen(theta, self.points.places - step))
                / (2 * step.sum())
                for step in np.diag(_PLACE_STEPS)
            ],
            axis=2,
        )
        spread = by_place * known
        return np.asarray(self.sigma_px**2 * np.eye(2) + spread @ spread.transpose(0, 2, 1))

    def noise_px(self, theta: Float64Array) -> float:
        """Return the stated noise of a residual, one direction, pixels."""
        return float(np.sqrt(np.median(np.trace(self.covariances(theta), axis1=1, axis2=2)) / 2))


class HomographyModel(Model):
    """The homography of one plane, between coordinates with centroid 0 and mean distance sqrt(2)."""

    name = "homography"
    sample = 4
    largest_px = np.inf

    def __init__(self, points: PointArrays, rig: Rig, names: Sequence[str], sigma_px: float) -> None:
        super().__init__(points, rig, names, sigma_px)
        self.to_normal, self.from_normal = _normalising(points.tactile), np.linalg.inv(_normalising(points.proximity))

    def alignment(self, theta: Float64Array) -> Alignment:
        H = self.from_normal @ np.append(theta, 1.0).reshape(3, 3) @ self.to_normal
        return Alignment(homography=H / H[2, 2] if abs(H[2, 2]) > 1e-12 * np.abs(H[2]).max() else H)

    def proposals(self, noise_px: float) -> list[Float64Array]:
        tactile, proximity = self.points.tactile[self.proposing], self.points.proximity[self.proposing]
        found = [cv2.findHomography(tactile, proximity, 0)[0]]
        for kind, factor in product((cv2.USAC_MAGSAC, cv2.RANSAC), _THRESHOLDS if len(tactile) > self.sample else ()):
            limits = (factor * noise_px, None, _ITERATIONS, _CONFIDENCE)
            found.append(cv2.findHomography(tactile, proximity, kind, *limits)[0])
        normal = [np.linalg.inv(self.from_normal) @ H @ np.linalg.inv(self.to_normal) for H in found if H is not None]
        return [(H / H[2, 2]).ravel()[:8] for H in normal if abs(H[2, 2]) > 1e-9 * np.abs(H).max()]


def _normalising(pixels: Float64Array) -> Float64Array:
    """Return the similarity (3, 3) to coordinates with centroid 0 and mean distance sqrt(2)."""
    centre = pixels.mean(axis=0)
    scale = np.sqrt(2) / np.hypot(*(pixels - centre).T).mean()
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])


class RigidModel(Model):
    """The tactile camera's pose in the proximity frame: rotation vector (rad), translation (m), depth offset (m)."""

    name = "rigid alignment"
    sample = 3
    largest_px = _MAX_RIGID_PX

    def __init__(self, points: PointArrays, rig: Rig, names: Sequence[str], sigma_px: float, offset: bool) -> None:
        super().__init__(points, rig, names, sigma_px)
        self.offset = offset
        self.space = Alignment(np.eye(4)).points_m(rig, points.places)

    def alignment(self, theta: Float64Array) -> Alignment:
        pose = pose_matrix(cv2.Rodrigues(theta[:3])[0], theta[3:6])
        return Alignment(pose, offset_m=float(theta[6]) if self.offset else 0.0)

    def prior(self, theta: Float64Array) -> Float64Array:
        return theta[6:] / _OFFSET_SIGMA_M

    def proposals(self, noise_px: float) -> list[Float64Array]:
        # clicks in colour are taken to be at the tactile distance, which is exact enough for a proposal
        clicked = clicks_in_depth(self.rig, self.points.proximity, self.points.in_color, self.space)
        space, rays = self.space[self.proposing], ray_seen(self.rig.proximity.intrinsics, clicked)[self.proposing]
        focal = self.rig.proximity.intrinsics.fx
        found = []
        try:
            all_pairs, turn, shift = cv2.solvePnP(space, rays, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
            found += [(turn, shift)] if all_pairs else []
            tries = product((cv2.SOLVEPNP_SQPNP, cv2.SOLVEPNP_AP3P), _THRESHOLDS)
            for kind, factor in tries if len(rays) > self.sample + 1 else ():
                some, turn, shift, _ = cv2.solvePnPRansac(
                    space, rays, np.eye(3), None, iterationsCount=_ITERATIONS, confidence=_CONFIDENCE,
                    reprojectionError=factor * noise_px / focal, flags=kind,
                )  # fmt: skip
                found += [(turn, shift)] if some else []
        except cv2.error:  # it asserts that the points are apart
            pass
        return [np.concatenate([turn.ravel(), shift.ravel(), [0.0] * self.offset]) for turn, shift in found]


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model: inliers ``inliers`` (N,), ``whitening`` (N, 2, 2) to unit noise, ``cost`` of whitened inliers."""

    model: Model
    theta: Float64Array
    inliers: BoolArray
    whitening: Float64Array
    cost: float
    degrees: int

    @property
    def noise_factor(self) -> float:
        """Observed noise relative to the stated one, which counts beside it since few pairs say little."""
        if self.degrees <= 0:
            return 1.0
        stated = 0.0 if self.inliers.all() else _STATED_DEGREES
        return float(np.sqrt((stated + self.cost) / (stated + self.degrees)))

    @cached_property
    def alignment(self) -> Alignment:
        return self.model.alignment(self.theta)

    @cached_property
    def residuals_px(self) -> Float64Array:
        """Clicked minus predicted pixel in the proximity image that was clicked, shape (N, 2)."""
        return self.model.residuals_px(self.theta)

    @property
    def rms_px(self) -> float:
        """Root mean square residual of the inliers, proximity pixels."""
        return float(np.sqrt((self.residuals_px[self.inliers] ** 2).sum(axis=1).mean()))

    @cached_property
    def design(self) -> Float64Array:
        """Derivative of the whitened predictions of all pairs by theta, shape (N, 2, P)."""
        by_theta = derivative(lambda theta: self.model.seen(theta, self.model.points.places), self.theta)
        return np.asarray(self.whitening @ by_theta)

    @cached_property
    def _scaled(self) -> tuple[Float64Array, Float64Array]:
        """The design of the inliers and the prior with columns of unit length (van der Sluis 1969), and the factors."""
        rows = [self.design[self.inliers].reshape(-1, len(self.theta)), derivative(self.model.prior, self.theta)]
        scale = 1.0 / np.maximum(np.linalg.norm(np.concatenate(rows), axis=0), 1e-150)
        return np.concatenate(rows) * scale, scale

    @property
    def condition(self) -> float:
        """Condition number of the scaled design."""
        return float(np.linalg.cond(self._scaled[0]))

    @cached_property
    def stated_covariance(self) -> Float64Array:
        """Covariance of theta under the stated noise, shape (P, P)."""
        rows, scale = self._scaled
        inverse = scale[:, None] * np.linalg.pinv(rows)
        return np.asarray(inverse @ inverse.T)

    @property
    def covariance(self) -> Float64Array:
        """Covariance of theta under the observed noise, shape (P, P)."""
        return self.noise_factor**2 * self.stated_covariance

    def whitened_residuals(self) -> Float64Array:
        """Return the residuals of all pairs with unit noise, shape (N, 2)."""
        return np.asarray((self.whitening @ self.residuals_px[:, :, None])[:, :, 0])

    def predict(self, places: npt.ArrayLike) -> Float64Array:
        """Map places (tactile u, v, and depth where it counts) to proximity depth pixels (N, 2)."""
        return self.alignment.pixels(self.model.rig, places)

    def sensitivity(self, places: npt.ArrayLike) -> Float64Array:
        """Return the derivative J (N, 2, P) of predictions by parameters of unit covariance: theirs is J J^T."""
        by_theta = derivative(lambda theta: self.model.alignment(theta).pixels(self.model.rig, places), self.theta)
        return np.asarray(by_theta @ np.linalg.cholesky(self.covariance))

    def distance_sensitivity(self, places: npt.ArrayLike) -> Float64Array:
        """Return the derivative (N, P) of a rigid fit's distance along z, metres, by whitened parameters."""
        by_theta = derivative(lambda theta: self.model.alignment(theta).points_m(self.model.rig, places), self.theta)
        return np.asarray((by_theta @ np.linalg.cholesky(self.covariance))[:, 2])


def derivative(function: Callable[[Float64Array], Float64Array], theta: Float64Array) -> Float64Array:
    """Return the derivative of a function by theta, with theta's axis last."""
    steps = _THETA_STEP * np.eye(len(theta))
    moves = [function(theta + step) - function(theta - step) for step in steps]
    return np.stack(moves, axis=-1) / (2 * _THETA_STEP)


def fit_homography(points: PointArrays, rig: Rig, *, known: BoolArray | None = None, names: Sequence[str] = ()) -> Fit:
    """Fit the homography from tactile to proximity depth pixels; ``known`` are the inliers, if they are known."""
    check_points(points, HomographyModel.sample, "homography", tactile=points.tactile, proximity=points.proximity)
    fit = _fit_robustly(HomographyModel(points, rig, names, CLICK_SIGMA_PX), known)
    if np.linalg.det(np.asarray(fit.alignment.homography)) < 0:
        raise CalibrationError("one image is mirrored, or partners are swapped; flip it or click the pairs again")
    return fit


def fit_rigid(
    points: PointArrays,
    rig: Rig,
    *,
    sigma_px: float = CLICK_SIGMA_PX,
    offset: bool = False,
    names: Sequence[str] = (),
) -> Fit:
    """Fit the tactile camera's pose, and with ``offset`` that of its depth, to points with depth, without outliers."""
    check_points(points, 4 + offset, RigidModel.name, tactile=Alignment(np.eye(4)).points_m(rig, points.places))
    return _fit_robustly(RigidModel(points, rig, names, sigma_px, offset), None)


def _fit_robustly(model: Model, known: BoolArray | None) -> Fit:
    """Fit a model to the inliers with the largest evidence, or to known ones."""
    count = len(model.points)
    starts = model.proposals(np.sqrt(2) * model.sigma_px)
    if not starts:
        raise CalibrationError(f"the points determine no {model.name}: they lie on one line; spread them out")
    if known is None and count == model.sample:
        known = np.ones(count, bool)
    best: tuple[float, Float64Array, BoolArray] | None = None if known is None else (0.0, starts[0], known)
    for start in starts if known is None else ():
        theta = start
        for _ in range(_ROUNDS):
            evidence, inliers = _likeliest_inliers(model, theta)
            if not np.isfinite(evidence) or (best is not None and np.array_equal(inliers, best[2])):
                break
            solved = _solve(model, theta, inliers)
            if solved is None:
                break
            theta = solved.theta
            evidence, again = _likeliest_inliers(model, theta)
            evidence += _volume(solved)
            if np.isfinite(evidence) and (best is None or evidence > best[0]):
                best = (evidence, theta, again)
    if best is None:
        raise _no_agreement(model)
    evidence, theta, inliers = best
    fit = _solve(model, theta, inliers)
    if fit is None or fit.condition > _MAX_CONDITION:
        raise CalibrationError(f"the points determine no {model.name}: they lie almost on one line; spread them out")
    surplus = int(inliers.sum()) - model.sample
    against_chance = evidence + surplus * np.log(model.area / (np.pi * _WRONG_PX**2))
    if known is None and (against_chance < _SIGNIFICANT * min(surplus, _SURPLUS) or inliers.mean() < MIN_INLIER_SHARE):
        raise _no_agreement(model, fit)
    return fit


def _volume(fit: Fit) -> float:
    """Return the log evidence of a fit under a unit information prior (Kass and Wasserman 1995)."""
    with np.errstate(all="ignore"):
        of_pairs = np.einsum("nmp,nmq->npq", fit.design, fit.design)
        share = fit.model.sample / len(of_pairs)
        information = np.stack([share * of_pairs.sum(axis=0), of_pairs[fit.inliers].sum(axis=0)])
        signs, (before, after) = np.linalg.slogdet(information)
        return float(before - after) / 2 if (signs > 0).all() else -np.inf


def _likeliest_inliers(model: Model, theta: Float64Array) -> tuple[float, BoolArray]:
    """Return the largest log evidence of the k nearest pairs being right, not all wrong, and which they are."""
    from scipy.special import gammaln  # slow to import

    noise_px, size, count = model.noise_px(theta), model.sample, len(model.points)
    with np.errstate(all="ignore"):
        away = np.nan_to_num(np.hypot(*model.residuals_px(theta).T), nan=np.inf)
        order = np.argsort(away, kind="stable")
        nearest = away[order]
        cost = np.cumsum((nearest / noise_px) ** 2)[size:]
    k = np.arange(size + 1, count + 1)
    half, total = _STATED_DEGREES / 2, _STATED_DEGREES / 2 + (k - size)
    student = gammaln(total) - gammaln(half) - (total - half) * np.log(half)
    student -= total * np.log1p(cost / _STATED_DEGREES)
    choices = gammaln(count + 1) - gammaln(k + 1) - gammaln(count - k + 1)
    evidence = (k - size) * np.log(_WRONG_PX**2 / (2 * noise_px**2)) + student - choices
    evidence[~((nearest[size:] <= model.largest_px) & np.isfinite(evidence))] = -np.inf
    best = int(evidence.argmax())
    inliers = np.zeros(count, bool)
    inliers[order[: k[best]]] = True
    return float(evidence[best]), inliers


def _solve(model: Model, start: Float64Array, inliers: BoolArray) -> Fit | None:
    """Fit the inliers by least squares from an initial theta; None if they determine nothing."""
    from scipy.optimize import least_squares  # slow to import

    with np.errstate(all="ignore"):
        try:
            whitening = np.linalg.inv(np.linalg.cholesky(model.covariances(start)))

            def residuals(theta: Float64Array) -> Float64Array:
                off = model.residuals_px(theta)[inliers]
                return np.append((whitening[inliers] @ off[:, :, None]).ravel(), model.prior(theta))

            found = least_squares(residuals, start, jac="3-point", method="lm", x_scale="jac", max_nfev=2000)
        except (ValueError, np.linalg.LinAlgError):  # not finite, or fewer measurements than parameters
            return None
    return Fit(model, found.x, inliers, whitening, float(2 * found.cost), 2 * int(inliers.sum()) - len(start))


def _no_agreement(model: Model, fit: Fit | None = None) -> CalibrationError:
    count = len(model.points)
    found = f"the {count} pairs agree on no {model.name}: none explains them better than chance"
    if fit is not None and not fit.inliers.all():
        wrong = listed([name for name, is_inlier in zip(model.names, fit.inliers, strict=True) if not is_inlier])
        far = np.hypot(*fit.residuals_px[~fit.inliers].T).max()
        found = (
            f"only {int(fit.inliers.sum())} of the {count} pairs agree on one {model.name}, and {wrong} "
            f"contradict{'s' if count - fit.inliers.sum() == 1 else ''} them by up to {min(far, 1e6):.0f} px"
        )
    return CalibrationError(
        f"{found}; check that both images show the same moment, and delete the wrong pairs or click them again"
    )
