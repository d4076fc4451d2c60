"""Fits of both alignment models to point pairs: outliers by OpenCV and evidence, inliers by least squares.

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
from scipy.optimize import least_squares
from scipy.special import gammaln

from ..errors import CalibrationError
from ..model.arrays import BoolArray, Float64Array, IndexArray
from ..model.frames import Rig
from .geometry import Alignment, color_pose, mapped, moved, proximity_pixels, ray_seen
from .points import PointArrays, check_points, listed

#: Standard deviations: of a careful click with magnifier, pixels; of either depth under a click, metres.
CLICK_SIGMA_PX = 0.7
_TACTILE_DEPTH_SIGMA_M, _PROXIMITY_DEPTH_SIGMA_M = 0.0005, 0.001
#: Standard deviation of the prior on the offset of the tactile depth, metres; it keeps an undetermined offset finite.
_OFFSET_SIGMA_M = 0.03
#: Variance of a distance that was not measured; its weight is negligible.
_UNMEASURED = 1e12
#: Steps of the numeric derivatives by places: pixels and metres.
_PLACE_STEPS = (0.5, 0.5, 1e-4)
_THETA_STEP = 1e-6

#: Thresholds for OpenCV's proposals, in units of the stated noise of a residual.
_THRESHOLDS = (3.0, 6.0, 12.0)
_ITERATIONS, _CONFIDENCE = 2000, 0.9999
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
#: Points off one plane have large residuals without being wrong. Above this share of their extent a homography is
#: useless.
_MAX_RMS_SHARE = 0.05


class Model(ABC):
    """A model of the alignment with parameters theta (P,), and the pairs that it is fitted to.

    ``sample`` pairs determine theta; ``largest_px`` is the largest residual of an inlier; ``measured`` (N, M) are the
    clicked proximity pixels, and the distance at contact where any was measured (metres).
    """

    name: ClassVar[str]
    sample: ClassVar[int]
    largest_px: float
    measured: Float64Array

    def __init__(self, points: PointArrays, rig: Rig, names: Sequence[str], sigma_px: float) -> None:
        self.points, self.rig, self.names, self.sigma_px = points, rig, names, sigma_px
        self.measured = points.proximity
        self.noise = np.full((len(points), 2), sigma_px**2)
        low, high = points.proximity.min(axis=0), points.proximity.max(axis=0)
        sides = 1.1 * np.maximum(high - low, 1e-12)
        self.extent_px = float(np.hypot(*sides))
        #: Area over which wrong pairs are distributed, pixels squared.
        self.area = float(max(sides[0] * sides[1], 0.1 * self.extent_px**2))

    @abstractmethod
    def alignment(self, theta: Float64Array) -> Alignment:
        """Return the alignment of theta."""

    @abstractmethod
    def seen(self, theta: Float64Array, places: Float64Array) -> Float64Array:
        """Predict what is measured at a place of each pair (N, 3: tactile pixel and depth), shape (N, M)."""

    @abstractmethod
    def proposals(self, noise_px: float) -> list[Float64Array]:
        """Return thetas by OpenCV, the fit to all pairs first."""

    def prior(self, theta: Float64Array) -> Float64Array:
        """Return whitened residuals of what is known beforehand."""
        return np.zeros(0)

    def predict(self, theta: Float64Array, places: npt.ArrayLike) -> Float64Array:
        """Map places (N, 3) to proximity depth pixels (N, 2)."""
        return self.alignment(theta).pixels(self.rig, places)

    def residuals_px(self, theta: Float64Array) -> Float64Array:
        """Return clicked minus predicted pixel of each pair, shape (N, 2)."""
        return self.points.proximity - self.seen(theta, self.points.places)[:, :2]

    def covariances(self, theta: Float64Array) -> Float64Array:
        """Return the covariance of each pair's residual, shape (N, M, M)."""
        known = np.array([self.sigma_px, self.sigma_px, _TACTILE_DEPTH_SIGMA_M])
        by_place = np.stack(
            [
                (self.seen(theta, self.points.places + step) - self.seen(theta, self.points.places - step))
                / (2 * step.sum())
                for step in np.diag(_PLACE_STEPS)
            ],
            axis=2,
        )
        spread = by_place * known
        noise = np.zeros((*self.noise.shape, self.noise.shape[1]))
        noise[:, range(self.noise.shape[1]), range(self.noise.shape[1])] = self.noise
        return np.asarray(noise + spread @ spread.transpose(0, 2, 1))

    def noise_px(self, theta: Float64Array) -> float:
        """Return the stated noise of a residual, one direction, pixels."""
        return float(np.sqrt(np.median(np.trace(self.covariances(theta)[:, :2, :2], axis1=1, axis2=2)) / 2))


class HomographyModel(Model):
    """The homography of one plane.

    Theta holds the matrix without its lower right entry, 1, between coordinates with centroid 0 and mean distance
    sqrt(2).
    """

    name = "homography"
    sample = 4

    def __init__(self, points: PointArrays, rig: Rig, names: Sequence[str], sigma_px: float) -> None:
        # neither depth counts
        points = PointArrays(
            points.tactile, np.zeros(len(points)), points.proximity, np.zeros(len(points), bool), np.zeros(len(points))
        )
        super().__init__(points, rig, names, sigma_px)
        self.largest_px = np.inf
        self.to_normal, self.from_normal = _normalising(points.tactile), np.linalg.inv(_normalising(points.proximity))

    def alignment(self, theta: Float64Array) -> Alignment:
        H = self.from_normal @ np.append(theta, 1.0).reshape(3, 3) @ self.to_normal
        return Alignment(homography=H / H[2, 2] if abs(H[2, 2]) > 1e-12 * np.abs(H[2]).max() else H)

    def seen(self, theta: Float64Array, places: Float64Array) -> Float64Array:
        return mapped(self.alignment(theta).homography, places[:, :2])

    def proposals(self, noise_px: float) -> list[Float64Array]:
        tactile, proximity = self.points.tactile, self.points.proximity
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
    """The tactile camera's pose in the proximity depth frame.

    Theta holds the rotation vector (rad), the translation (m) and, where fitted, the offset of the tactile depth (m).
    """

    name = "rigid alignment"
    sample = 3

    def __init__(self, points: PointArrays, rig: Rig, names: Sequence[str], sigma_px: float, offset: bool) -> None:
        super().__init__(points, rig, names, sigma_px)
        self.largest_px, self.offset = _MAX_RIGID_PX, offset
        self.space = Alignment(np.eye(4)).points_m(rig, points.places)
        contact = np.isfinite(points.proximity_depth_m)
        if contact.any():
            self.measured = np.column_stack([points.proximity, np.where(contact, points.proximity_depth_m, 0.0)])
            variance = np.where(contact, _PROXIMITY_DEPTH_SIGMA_M**2, _UNMEASURED)
            self.noise = np.column_stack([self.noise, variance])

    def alignment(self, theta: Float64Array) -> Alignment:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(theta[:3])[0], theta[3:6]
        return Alignment(pose, offset_m=float(theta[6]) if self.offset else 0.0)

    def seen(self, theta: Float64Array, places: Float64Array) -> Float64Array:
        points = self.alignment(theta).points_m(self.rig, places)
        pixels = proximity_pixels(self.rig, points, self.points.in_color)
        return pixels if self.noise.shape[1] == 2 else np.column_stack([pixels, points[:, 2]])

    def prior(self, theta: Float64Array) -> Float64Array:
        return theta[6:] / _OFFSET_SIGMA_M

    def proposals(self, noise_px: float) -> list[Float64Array]:
        rays, focal = self._rays_of_depth_camera(), self.rig.proximity.intrinsics.fx
        found = []
        try:
            all_pairs, turn, shift = cv2.solvePnP(self.space, rays, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
            found += [(turn, shift)] if all_pairs else []
            tries = product((cv2.SOLVEPNP_SQPNP, cv2.SOLVEPNP_AP3P), _THRESHOLDS)
            for kind, factor in tries if len(rays) > self.sample + 1 else ():
                some, turn, shift, _ = cv2.solvePnPRansac(
                    self.space, rays, np.eye(3), None, iterationsCount=_ITERATIONS, confidence=_CONFIDENCE,
                    reprojectionError=factor * noise_px / focal, flags=kind,
                )  # fmt: skip
                found += [(turn, shift)] if some else []
        except cv2.error:  # it asserts that the points are apart
            pass
        return [np.concatenate([turn.ravel(), shift.ravel(), [0.0] * self.offset]) for turn, shift in found]

    def _rays_of_depth_camera(self) -> Float64Array:
        """Map clicks to rays of the depth camera; those in colour at the tactile distance, which is exact enough."""
        depth = self.points.tactile_depth_m[:, None]
        rays = ray_seen(self.rig.proximity.intrinsics, self.points.proximity)
        if self.rig.proximity_color is None or not self.points.in_color.any():
            return rays
        in_color = np.column_stack(
            [ray_seen(self.rig.proximity_color.intrinsics, self.points.proximity) * depth, depth]
        )
        at = moved(np.linalg.inv(color_pose(self.rig)), in_color)
        return np.ascontiguousarray(np.where(self.points.in_color[:, None], at[:, :2] / at[:, 2:], rays))


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model with its statistics.

    ``used`` (N,) are the inliers, ``whitening`` (N, M, M) makes each pair's residual one of unit noise, ``cost`` is the
    squared length of the inliers' whitened residuals, ``degrees`` the number of measurements minus that of parameters.
    """

    model: Model
    theta: Float64Array
    used: BoolArray
    whitening: Float64Array
    cost: float
    degrees: int

    @property
    def noise_factor(self) -> float:
        """Observed noise relative to the stated one; 1 without degrees of freedom.

        Few pairs chosen to agree say little, so the stated noise counts beside them.
        """
        if self.degrees <= 0:
            return 1.0
        stated = 0.0 if self.used.all() else _STATED_DEGREES
        return float(np.sqrt((stated + self.cost) / (stated + self.degrees)))

    @cached_property
    def alignment(self) -> Alignment:
        """The fitted alignment."""
        return self.model.alignment(self.theta)

    @cached_property
    def residuals_px(self) -> Float64Array:
        """Clicked minus predicted pixel in the proximity image that was clicked, shape (N, 2)."""
        return self.model.residuals_px(self.theta)

    @property
    def rms_px(self) -> float:
        """Root mean square residual of the inliers, proximity pixels."""
        return float(np.sqrt((self.residuals_px[self.used] ** 2).sum(axis=1).mean()))

    @cached_property
    def design(self) -> Float64Array:
        """Derivative of the whitened predictions of all pairs by theta, shape (N, M, P)."""
        by_theta = derivative(lambda theta: self.model.seen(theta, self.model.points.places), self.theta)
        return np.asarray(self.whitening @ by_theta)

    @cached_property
    def _information(self) -> Float64Array:
        rows = self.design[self.used].reshape(-1, len(self.theta))
        by_prior = derivative(self.model.prior, self.theta)
        return np.asarray(rows.T @ rows + by_prior.T @ by_prior)

    @property
    def condition(self) -> float:
        """Condition number of the design, its columns scaled to unit length (van der Sluis 1969)."""
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self._information), 1e-300))
        values = np.linalg.eigvalsh(self._information * scale[:, None] * scale)
        return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")

    @cached_property
    def stated_covariance(self) -> Float64Array:
        """Covariance of theta under the stated noise, shape (P, P)."""
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self._information), 1e-300))
        inverse = np.linalg.pinv(self._information * scale[:, None] * scale, rcond=1e-15, hermitian=True)
        return np.asarray(inverse * scale[:, None] * scale)

    @property
    def covariance(self) -> Float64Array:
        """Covariance of theta under the observed noise, shape (P, P)."""
        return self.noise_factor**2 * self.stated_covariance

    @property
    def pose_sigma(self) -> tuple[float, float]:
        """Standard deviations of a pose's rotation (rad) and translation (m), all directions together."""
        variances = np.diag(self.covariance)
        return float(np.sqrt(variances[:3].sum())), float(np.sqrt(variances[3:6].sum()))

    def whitened_residuals(self) -> Float64Array:
        """Return the residuals of all pairs with unit noise, shape (N, M)."""
        off = self.model.measured - self.model.seen(self.theta, self.model.points.places)
        return np.asarray((self.whitening @ off[:, :, None])[:, :, 0])

    def left_out_residuals_px(self) -> Float64Array:
        """Return each pair's residual (N, 2) under the fit of the other pairs; nan if they determine no model.

        Cook and Weisberg, *Residuals and Influence in Regression*, section 2.2.
        """
        found = self.residuals_px.copy()
        whitened = self.whitened_residuals()
        for i in np.flatnonzero(self.used):
            leverage = self.design[i] @ self.stated_covariance @ self.design[i].T
            rest = np.eye(len(leverage)) - leverage
            known = np.linalg.cond(rest) < 1e9
            grown = (
                np.linalg.solve(self.whitening[i], np.linalg.solve(rest, whitened[i])) if known else np.full(2, np.nan)
            )
            found[i] = grown[:2]
        return found

    def predict(self, places: npt.ArrayLike) -> Float64Array:
        """Map places (tactile u, v, and depth where it counts) to proximity depth pixels (N, 2)."""
        return self.alignment.pixels(self.model.rig, places)

    def sensitivity(self, places: npt.ArrayLike) -> Float64Array:
        """Return the derivative (N, 2, P) of predicted proximity depth pixels by whitened parameters.

        Whitened parameters have unit covariance, so ``J J^T`` is the covariance of the prediction.
        """
        by_theta = derivative(lambda theta: self.model.predict(theta, places), self.theta)
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


def fit_homography(points: PointArrays, rig: Rig, *, use: BoolArray | None = None, names: Sequence[str] = ()) -> Fit:
    """Fit the homography from tactile to proximity depth pixels; outliers are rejected.

    ``use`` are the inliers, if already known; ``names`` those of the pairs in messages.
    """
    check_points(points, HomographyModel.sample, "homography", tactile=points.tactile, proximity=points.proximity)
    model = HomographyModel(points, rig, names or _numbers(points), CLICK_SIGMA_PX)
    fit = _fit_robustly(model, use)
    if fit.rms_px > _MAX_RMS_SHARE * model.extent_px:
        raise _no_agreement(model)
    places = points.places[fit.used]
    by_pixel = [fit.predict(places + step) - fit.predict(places - step) for step in 0.5 * np.eye(3)[:2]]
    if not (np.linalg.det(np.stack(by_pixel, axis=2)) > 0).all():
        raise CalibrationError(
            "the points run around in opposite senses in both images: one image is mirrored, or partners are swapped; "
            "flip the image or click the pairs again"
        )
    return fit


def fit_rigid(
    points: PointArrays,
    rig: Rig,
    *,
    sigma_px: float = CLICK_SIGMA_PX,
    offset: bool = False,
    names: Sequence[str] = (),
) -> Fit:
    """Fit the tactile camera's pose in the proximity frame to points with depth; outliers are rejected.

    ``sigma_px`` is the noise of a click, ``offset`` whether an offset of the tactile depth is fitted, too.
    """
    check_points(points, 4 + offset, RigidModel.name, tactile=Alignment(np.eye(4)).points_m(rig, points.places))
    return _fit_robustly(RigidModel(points, rig, names or _numbers(points), sigma_px, offset), None)


def _numbers(points: PointArrays) -> list[str]:
    return [str(number) for number in range(1, len(points) + 1)]


def _fit_robustly(model: Model, use: BoolArray | None) -> Fit:
    """Fit a model to the inliers with the largest evidence, or to given ones."""
    count = len(model.points)
    starts = model.proposals(np.sqrt(2) * model.sigma_px)
    if use is None and count == model.sample:
        use = np.ones(count, bool)
    best: tuple[float, Float64Array, BoolArray] | None = None
    for start in starts:
        theta = start
        if use is not None:
            best = (0.0, theta, use)
            break
        for _ in range(_ROUNDS):
            evidence, used = _likeliest(model, theta)
            if not np.isfinite(evidence) or (best is not None and np.array_equal(used, best[2])):
                break
            solved = _solve(model, theta, used)
            if solved is None:
                break
            theta = solved.theta
            evidence, again = _likeliest(model, theta)
            evidence += _volume(solved)
            if np.isfinite(evidence) and (best is None or evidence > best[0]):
                best = (evidence, theta, again)
    if best is None:
        if not starts:
            raise CalibrationError(
                f"the points determine no {model.name}: they lie on one line or on each other; spread them out"
            )
        raise _no_agreement(model)
    evidence, theta, used = best
    fit = _solve(model, theta, used)
    if fit is None or fit.condition > _MAX_CONDITION:
        raise CalibrationError(
            f"the points determine no {model.name}: they lie almost on one line or on each other; spread them out"
        )
    surplus = int(used.sum()) - model.sample
    against_chance = evidence + surplus * np.log(model.area / (np.pi * _WRONG_PX**2))
    if use is None and (against_chance < _SIGNIFICANT * min(surplus, _SURPLUS) or used.mean() < MIN_INLIER_SHARE):
        raise _no_agreement(model, fit)
    return fit


def _volume(fit: Fit) -> float:
    """Return the log evidence of a fit for what is not known before it: a unit information prior.

    It makes pairs that no other pair confirms count little (Kass and Wasserman 1995).
    """
    with np.errstate(all="ignore"):
        of_pairs = np.einsum("nmp,nmq->npq", fit.design, fit.design)
        share = fit.model.sample / len(of_pairs)
        information = np.stack([share * of_pairs.sum(axis=0), of_pairs[fit.used].sum(axis=0)])
        signs, (before, after) = np.linalg.slogdet(information)
        return float(before - after) / 2 if (signs > 0).all() else -np.inf


def _likeliest(model: Model, theta: Float64Array) -> tuple[float, BoolArray]:
    """Return the largest log evidence of the k nearest pairs being right, and which they are."""
    noise_px, size = model.noise_px(theta), model.sample
    with np.errstate(all="ignore"):
        off = np.nan_to_num(np.abs(model.measured - model.seen(theta, model.points.places)), nan=np.inf)
        squares = (off[:, :2] ** 2).sum(axis=1) / noise_px**2 + (off[:, 2:] ** 2 / model.noise[:, 2:]).sum(axis=1)
    order = np.argsort(squares, kind="stable")
    nearest = np.hypot(*off[order, :2].T)
    k = np.arange(size + 1, len(nearest) + 1)
    cost = np.cumsum(squares[order])[size:]
    evidence = _log_evidence(len(nearest), k, size, cost, noise_px)
    allowed = np.maximum.accumulate(nearest)[size:] <= model.largest_px
    evidence[~(allowed & np.isfinite(evidence))] = -np.inf
    best = int(evidence.argmax())
    used = np.zeros(len(nearest), bool)
    used[order[: k[best]]] = True
    return float(evidence[best]), used


def _log_evidence(count: int, k: IndexArray, size: int, cost: Float64Array, noise_px: float) -> Float64Array:
    """Return the log evidence of k of ``count`` pairs being right against all being wrong.

    Every number of wrong pairs is equally likely; ``size`` pairs determine the model.
    """
    half, total = _STATED_DEGREES / 2, _STATED_DEGREES / 2 + (k - size)
    student = gammaln(total) - gammaln(half) - (total - half) * np.log(half)
    student -= total * np.log1p(cost / _STATED_DEGREES)
    choices = gammaln(count + 1) - gammaln(k + 1) - gammaln(count - k + 1)
    return np.asarray((k - size) * np.log(_WRONG_PX**2 / (2 * noise_px**2)) + student - choices)


def _solve(model: Model, start: Float64Array, used: BoolArray) -> Fit | None:
    """Fit the used pairs by least squares from an initial theta; None if they determine nothing."""
    places = model.points.places
    with np.errstate(all="ignore"):
        try:
            whitening = np.linalg.inv(np.linalg.cholesky(model.covariances(start)))

            def residuals(theta: Float64Array) -> Float64Array:
                off = (model.measured - model.seen(theta, places))[used]
                return np.append((whitening[used] @ off[:, :, None]).ravel(), model.prior(theta))

            found = least_squares(residuals, start, jac="3-point", method="lm", x_scale="jac", max_nfev=2000)
        except (ValueError, np.linalg.LinAlgError):  # not finite, or fewer measurements than parameters
            return None
    measured = int((model.noise[used] < _UNMEASURED).sum())
    return Fit(model, found.x, used, whitening, float(2 * found.cost), measured - len(start))


def _no_agreement(model: Model, fit: Fit | None = None) -> CalibrationError:
    """Return the error for pairs that agree on no model."""
    count = len(model.points)
    found = f"the {count} pairs agree on no {model.name}: none explains them better than chance"
    if fit is not None and not fit.used.all():
        wrong = listed([name for name, used in zip(model.names, fit.used, strict=True) if not used], 8)
        far = np.hypot(*fit.residuals_px[~fit.used].T).max()
        found = (
            f"only {int(fit.used.sum())} of the {count} pairs agree on one {model.name}, and {wrong} "
            f"contradict{'s' if count - fit.used.sum() == 1 else ''} them by up to {min(far, 1e6):.0f} px"
        )
    return CalibrationError(
        f"{found}; check that both images show the same moment and that left and right points are the same places, "
        "delete the wrong pairs or click them again"
    )
