"""The tactile camera's pose in the proximity frame, from clicks with tactile depth.

Each tactile click is a point in space: its ray times its depth. It corresponds to a ray of the proximity depth camera,
or of the proximity colour camera through the factory extrinsics; both kinds may be mixed. Initial value:
perspective-n-point (SQPnP; Terzakis and Lourakis 2020), with outliers removed by P3P samples. Refinement: maximum
likelihood with noise in both clicks and in the depth (`maximum_likelihood`).

With ``depth_fit`` the tactile depth is corrected to ``scale * raw + offset``, or by one of the two. Clicks alone leave
the scale open: scene and baseline can grow together without moving a pixel. It is determined by distances that the
proximity camera measures at contact (``proximity_depth_m``), otherwise by the rig's stated baseline. Clicks that span
depth determine the offset, because it bends parallax over depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
import numpy.typing as npt

from ..model.arrays import AnyArray, BoolArray, Float64Array, IndexArray
from ..model.frames import Rig
from ..model.intrinsics import Intrinsics
from .correspondences import check_space, on_a_line, spread
from .fit import Fit, Rival
from .homography import CLICK_SIGMA_PX
from .maximum_likelihood import UNMEASURED, Linearised, Measurements, Problem
from .robust import fit_robustly

#: Which correction of the tactile depth is fitted.
DepthFit = Literal["none", "offset", "scale", "both"]
DEPTH_FITS: tuple[DepthFit, ...] = get_args(DepthFit)
#: Index of the fitted corrections among scale and offset.
_FREE: dict[DepthFit, tuple[int, ...]] = {"none": (), "offset": (1,), "scale": (0,), "both": (0, 1)}

_NEWTON_STEPS = 8
#: A ray that leads back to a place farther from its pixel than this is beyond the fold of the lens model.
_FOLDED_PX = 1.0
_DIFFERENCE_PX = 0.5
#: Standard deviations of the tactile and the proximity depth under a click, metres.
TACTILE_DEPTH_SIGMA_M = 0.0005
PROXIMITY_DEPTH_SIGMA_M = 0.001
#: Standard deviation of the rig's stated baseline, metres; only used if a depth scale is fitted.
BASELINE_SIGMA_M = 0.0002
#: Standard deviations of the prior on scale and offset, from data sheets.
_SCALE_SIGMA, _OFFSET_SIGMA_M = 0.05, 0.03

#: Priors and the proximity camera's depth have noise of their own. They are weighed against the observed noise of the
#: clicks, so the fit is repeated with that of the fit before.
_NOISE_ROUNDS, _MIN_NOISE = 3, 1e-6

#: A pair with a larger residual is an outlier, because the rigid model is exact, pixels.
_MAX_PX = 12.0

_SAMPLE = 3
MIN_POINTS = 4


def solve_pose(space: Float64Array, rays: Float64Array) -> tuple[AnyArray, AnyArray] | None:
    """Return Rodrigues vector and translation by SQPnP; None where there is none, as of points on top of each other."""
    try:
        found, turn, shift = cv2.solvePnP(space, rays, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:  # it asserts that the points are apart
        return None
    return (turn, shift) if found else None


def ray_seen(intrinsics: Intrinsics, pixels: npt.ArrayLike) -> Float64Array:
    """Return ``(x / z, y / z)`` of the rays that `Intrinsics.project` takes to these pixels.

    The pipeline *projects* into the tactile and the colour camera, so a click is the inverse of that projection,
    also for lens models that librealsense cannot deproject.

    Parameters
    ----------
    pixels : array_like, shape (N, 2)

    Returns
    -------
    float64, shape (N, 2)
    """
    pixels = np.asarray(pixels, np.float64)
    rays = intrinsics.normalise(pixels)
    if not intrinsics.has_distortion:
        return rays
    focal = np.array([intrinsics.fx, intrinsics.fy])
    with np.errstate(all="ignore"):  # there is no ray beyond the fold
        for _ in range(_NEWTON_STEPS):
            rays = rays + (pixels - _project_rays(intrinsics, rays)) / focal
    return rays


def has_ray(intrinsics: Intrinsics, pixels: Float64Array) -> BoolArray:
    """Tell to which pixels (N, 2) a ray leads: to none beyond the fold of the lens model."""
    with np.errstate(all="ignore"):
        off = np.abs(_project_rays(intrinsics, ray_seen(intrinsics, pixels)) - pixels)
    return np.asarray((off < _FOLDED_PX).all(axis=1))


def ray_covariance(intrinsics: Intrinsics, pixels: Float64Array, sigma_px: float) -> Float64Array:
    """Return the covariance (N, 2, 2) of rays whose pixels have isotropic noise."""
    columns = []
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = _DIFFERENCE_PX
        difference = ray_seen(intrinsics, pixels + step) - ray_seen(intrinsics, pixels - step)
        columns.append(difference / (2 * _DIFFERENCE_PX))
    by_pixel = np.stack(columns, axis=2)
    return np.asarray(sigma_px**2 * by_pixel @ by_pixel.transpose(0, 2, 1))


def color_pose(rig: Rig) -> Float64Array:
    """Return ``T_color_depth`` of the proximity camera; the identity if colour is aligned to depth."""
    return np.eye(4) if rig.proximity_color is None else np.asarray(rig.proximity_color.T_color_depth)


def color_lens(rig: Rig) -> Intrinsics:
    """Return the lens of the proximity colour image."""
    return rig.proximity.intrinsics if rig.proximity_color is None else rig.proximity_color.intrinsics


def to_color(rig: Rig, points_m: Float64Array) -> Float64Array:
    """Return points (N, 3) of the proximity depth frame in the frame of the colour camera, metres."""
    T_color_depth = color_pose(rig)
    return np.asarray(points_m @ T_color_depth[:3, :3].T + T_color_depth[:3, 3])


def clicks_in_depth(rig: Rig, clicked: Float64Array, in_color: BoolArray, points_m: Float64Array) -> Float64Array:
    """Return the proximity depth pixels (N, 2) of clicks.

    A click in the colour image is a point on the colour camera's ray. Its distance is that of the given point, because
    the proximity depth image looks through the membrane.

    Parameters
    ----------
    clicked : float64, shape (N, 2)
        Pixels of the proximity depth or colour image.
    in_color : bool, shape (N,)
    points_m : float64, shape (N, 3)
        Points of the membrane, about where the clicks are, in the proximity depth frame.
    """
    depth = to_color(rig, points_m)[:, 2:]
    T_depth_color = np.linalg.inv(color_pose(rig))
    points = np.column_stack([ray_seen(color_lens(rig), clicked) * depth, depth]) @ T_depth_color[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = rig.proximity.intrinsics.project(points + T_depth_color[:3, 3])
    return np.where(in_color[:, None], pixels, clicked)


def _project_rays(intrinsics: Intrinsics, rays: Float64Array) -> Float64Array:
    return intrinsics.project(np.column_stack([rays, np.ones(len(rays))]))


@dataclass(frozen=True, eq=False)
class RigidPoints:
    """Clicks with a tactile depth.

    Attributes
    ----------
    tactile : float64, shape (N, 2)
        Pixels of the tactile image.
    tactile_depth_m : float64, shape (N,)
    proximity : float64, shape (N, 2)
        Pixels of the proximity depth or colour image.
    in_color : bool, shape (N,)
        Whether the colour image was clicked.
    proximity_depth_m : float64, shape (N,)
        Distance measured by the proximity camera at contact; nan if unknown.
    """

    tactile: Float64Array
    tactile_depth_m: Float64Array
    proximity: Float64Array
    in_color: BoolArray
    proximity_depth_m: Float64Array

    @property
    def places(self) -> Float64Array:
        """Tactile pixel and depth in one array, shape (N, 3)."""
        return np.column_stack([self.tactile, self.tactile_depth_m])

    @staticmethod
    def joined(parts: Sequence[RigidPoints]) -> RigidPoints:
        """Return all points of some parts, at least one."""
        return RigidPoints(**{name: np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0])})


@dataclass(frozen=True, eq=False)
class Pose:
    """Rotation, translation (metres) and depth correction: what is fitted."""

    rotation: Float64Array
    translation: Float64Array
    scale: float = 1.0
    offset_m: float = 0.0

    @staticmethod
    def of(matrix: npt.ArrayLike, scale: float = 1.0, offset_m: float = 0.0) -> Pose:
        """Return the pose of a matrix (4, 4)."""
        array = np.asarray(matrix, np.float64)
        return Pose(array[:3, :3], array[:3, 3], scale, offset_m)

    @property
    def matrix(self) -> Float64Array:
        """``T_p_t``, shape (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation
        return matrix

    def moved(self, rays: Float64Array, depth_m: Float64Array) -> Float64Array:
        """Return points (N, 3) in the proximity depth frame of tactile rays (N, 2) with raw depths (N,)."""
        depth = self.scale * depth_m + self.offset_m
        return np.asarray(np.column_stack([rays * depth[:, None], depth]) @ self.rotation.T + self.translation)

    def points_m(self, lens: Intrinsics, places: Float64Array) -> Float64Array:
        """Return points (N, 3) in the proximity depth frame of tactile pixels with raw depths (N, 3)."""
        return self.moved(ray_seen(lens, places[:, :2]), places[:, 2])


@dataclass(frozen=True, eq=False)
class RigidFit(Fit):
    """A fitted pose with its statistics.

    Theta holds the rotation vector (rad), the translation (m) and, where fitted, scale and offset (m).
    """

    problem: RigidProblem

    @property
    def pose(self) -> Pose:
        """The fitted pose."""
        return self.problem.pose(self.solution.theta)

    @property
    def T_proximity_tactile(self) -> Float64Array:
        """Pose of the tactile camera in the proximity depth frame, shape (4, 4), metres."""
        return self.pose.matrix

    @property
    def pose_sigma(self) -> tuple[float, float]:
        """Standard deviations of the rotation (rad) and of the translation (m), all directions together."""
        rotation, by_turn = cv2.Rodrigues(self.solution.theta[:3])
        turned = by_turn.reshape(3, 3, 3) @ rotation.T
        tangent = turned[:, (2, 0, 1), (1, 2, 0)]  # rotation about the axes by each entry of the rotation vector
        return (
            float(np.sqrt(np.trace(tangent.T @ self.covariance[:3, :3] @ tangent))),
            float(np.sqrt(np.trace(self.covariance[3:6, 3:6]))),
        )

    @property
    def depth_sigma(self) -> tuple[float | None, float | None]:
        """Standard deviations of scale (no unit) and offset (m); None where not fitted."""
        free, sigma = self.problem.free, np.sqrt(np.diag(self.covariance))[6:].tolist()
        scale, offset = (sigma[free.index(i)] if i in free else None for i in (0, 1))
        return scale, offset

    def points_m(self, places: npt.ArrayLike) -> Float64Array:
        """Map tactile pixels and raw depths (N, 3) to points in the proximity depth frame, metres."""
        return self.pose.points_m(self.problem.rig.tactile.intrinsics, np.asarray(places, np.float64))

    def depth_sensitivity(self, places: npt.ArrayLike) -> Float64Array:
        """Return the derivative (N, P) of the distance along z, metres, by whitened parameters."""
        rays = self.problem.rays(np.asarray(places, np.float64))
        _, by_theta, _ = self.problem.transform(self.solution.theta, rays)
        return np.asarray((by_theta @ np.linalg.cholesky(self.covariance))[:, 2])


class RigidProblem(Problem):
    """Pose estimation in normalised coordinates; lens distortion is removed from the clicks first."""

    name = "rigid alignment"
    sample_size = _SAMPLE

    def __init__(
        self,
        points: RigidPoints,
        rig: Rig,
        click_sigma_px: float,
        depth_fit: DepthFit,
        names: Sequence[str] | None,
        observed: float,
    ) -> None:
        self.observed = observed
        self.names = names or [str(number) for number in range(1, len(points.tactile) + 1)]
        self.points, self.rig, self.free = points, rig, _FREE[depth_fit]
        count = len(points.tactile)
        poses = np.stack([np.eye(4), color_pose(rig)])
        self.camera_rotation, self.camera_translation = poses[:, :3, :3], poses[:, :3, 3]
        self.measures_depth = bool(np.isfinite(points.proximity_depth_m).any())
        self.size = 3 if self.measures_depth else 2

        known_covariance = np.zeros((count, 3, 3))
        known_covariance[:, :2, :2] = ray_covariance(rig.tactile.intrinsics, points.tactile, click_sigma_px)
        known_covariance[:, 2, 2] = TACTILE_DEPTH_SIGMA_M**2
        seen = np.zeros((count, self.size))
        seen_covariance = np.zeros((count, self.size, self.size))
        for lens, which in ((rig.proximity.intrinsics, ~points.in_color), (color_lens(rig), points.in_color)):
            clicks = points.proximity[which]
            seen[which, :2] = ray_seen(lens, clicks)
            seen_covariance[which, :2, :2] = ray_covariance(lens, clicks, click_sigma_px)
        if self.measures_depth:
            measured = np.isfinite(points.proximity_depth_m)
            seen[:, 2] = np.where(measured, points.proximity_depth_m, 0.0)
            seen_covariance[:, 2, 2] = np.where(measured, (PROXIMITY_DEPTH_SIGMA_M / observed) ** 2, UNMEASURED)
        rays = ray_seen(rig.tactile.intrinsics, points.tactile)
        known = np.column_stack([rays, points.tactile_depth_m])
        self.measurements = Measurements(
            known, known_covariance, seen, seen_covariance, points.in_color.astype(np.intp)
        )
        self.focal = np.where(
            points.in_color[:, None],
            (color_lens(rig).fx, color_lens(rig).fy),
            (rig.proximity.intrinsics.fx, rig.proximity.intrinsics.fy),
        )
        self.square_pixels = self.focal.prod(axis=1)
        ratio = self.focal.mean() / np.mean([rig.tactile.intrinsics.fx, rig.tactile.intrinsics.fy])
        self.noise_px = float(np.hypot(click_sigma_px * ratio, click_sigma_px))
        self.space = np.column_stack([rays * points.tactile_depth_m[:, None], points.tactile_depth_m])
        self.start_rays = self._rays_of_depth_camera()
        _, self.area = spread(points.proximity)
        self.largest_px = self.largest_rms_px = _MAX_PX

    def pose(self, theta: Float64Array) -> Pose:
        """Return the pose of theta: rotation vector, translation and the fitted corrections."""
        scale, offset_m = self._corrections(theta)
        return Pose(np.asarray(cv2.Rodrigues(theta[:3])[0], np.float64), theta[3:6], scale, offset_m)

    def _corrections(self, theta: Float64Array) -> tuple[float, float]:
        corrections = [1.0, 0.0]
        for which, value in zip(self.free, theta[6:].tolist(), strict=True):
            corrections[which] = value
        return corrections[0], corrections[1]

    def rays(self, places: Float64Array) -> Float64Array:
        """Return ray (x, y) and raw depth of tactile pixels with raw depths, both (N, 3)."""
        return np.column_stack([ray_seen(self.rig.tactile.intrinsics, places[:, :2]), places[:, 2]])

    def transform(self, theta: Float64Array, rays: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Map `rays` (N, 3) to proximity points, with derivatives by theta (N, 3, P) and by rays (N, 3, 3)."""
        rotation, by_turn = cv2.Rodrigues(theta[:3])
        scale, offset_m = self._corrections(theta)
        depth = scale * rays[:, 2] + offset_m
        ahead = np.column_stack([rays[:, :2], np.ones(len(rays))])
        turned = ahead @ rotation.T
        by_theta = np.zeros((len(rays), 3, len(theta)))
        by_theta[:, :, :3] = np.einsum("iab,nb->nai", by_turn.reshape(3, 3, 3), ahead * depth[:, None])
        by_theta[:, :, 3:6] = np.eye(3)
        for column, which in enumerate(self.free, 6):
            by_theta[:, :, column] = turned if which else turned * rays[:, 2:]
        by_rays = np.empty((len(rays), 3, 3))
        by_rays[:, :, :2] = rotation[:, :2] * depth[:, None, None]
        by_rays[:, :, 2] = turned * scale
        return turned * depth[:, None] + theta[3:6], by_theta, by_rays

    def predict(self, theta: Float64Array, places: Float64Array) -> Float64Array:
        """Map tactile pixels with raw depths (N, 3) to proximity depth pixels (N, 2)."""
        points = self.pose(theta).points_m(self.rig.tactile.intrinsics, places)
        return self.rig.proximity.intrinsics.project(points)

    def sensitivity(self, theta: Float64Array, places: Float64Array) -> Float64Array:
        """Return the derivative of `predict` by theta without lens distortion, shape (N, 2, P)."""
        points, by_theta, _ = self.transform(theta, self.rays(places))
        lens, ray = self.rig.proximity.intrinsics, points[:, :2] / points[:, 2:]
        along = by_theta[:, :2] - ray[:, :, None] * by_theta[:, 2:3]
        return np.asarray(along / points[:, 2, None, None] * np.array([lens.fx, lens.fy])[:, None])

    def linearise(self, theta: Float64Array, places: Float64Array, camera: IndexArray) -> Linearised:
        """Predict rays of the clicked camera and, if measured, the distance."""
        points, by_theta, by_place = self.transform(theta, places)
        rotation = self.camera_rotation[camera]
        seen = (rotation @ points[:, :, None])[:, :, 0] + self.camera_translation[camera]
        ray = seen[:, :2] / seen[:, 2:]
        by_point = (rotation[:, :2] - ray[:, :, None] * rotation[:, 2:]) / seen[:, 2, None, None]
        if self.measures_depth:
            ray = np.column_stack([ray, points[:, 2]])
            along = np.broadcast_to(np.array([[[0.0, 0.0, 1.0]]]), (len(points), 1, 3))
            by_point = np.concatenate([by_point, along], axis=1)
        return ray, by_point @ by_theta, by_point @ by_place

    def start(self, used: BoolArray) -> Float64Array | None:
        """Solve SQPnP on the used pairs."""
        space = self.space[used]
        if len(space) < MIN_POINTS or on_a_line(space):
            return None
        pose = solve_pose(space, self.start_rays[used])
        return None if pose is None else self._uncorrected(*pose)

    def hypotheses(self, samples: IndexArray) -> list[Float64Array]:
        """Solve P3P for each sample: up to four poses each."""
        found = []
        for sample in samples:
            if on_a_line(self.space[sample]):
                continue
            count, turns, shifts = cv2.solveP3P(
                self.space[sample], self.start_rays[sample], np.eye(3), None, flags=cv2.SOLVEPNP_AP3P
            )
            found += [self._uncorrected(*pose) for pose in zip(turns[:count], shifts[:count], strict=True)]
        return found

    def _uncorrected(self, turn: AnyArray, shift: AnyArray) -> Float64Array:
        return np.concatenate([turn.ravel(), shift.ravel(), np.array([1.0, 0.0])[list(self.free)]])

    def _seen(self, theta: Float64Array) -> Float64Array:
        """Return the pairs' points (N, 3) in the frame of the camera whose image was clicked."""
        rays, camera = self.measurements.known, self.measurements.camera
        points = self.pose(theta).moved(rays[:, :2], rays[:, 2])
        return np.asarray(
            (self.camera_rotation[camera] @ points[:, :, None])[:, :, 0] + self.camera_translation[camera]
        )

    def residuals_px(self, theta: Float64Array) -> Float64Array:
        """Return residual lengths in the clicked image, without lens distortion, pixels."""
        seen = self._seen(theta)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.hypot(*((seen[:, :2] / seen[:, 2:] - self.measurements.seen[:, :2]) * self.focal).T)
        return np.asarray(np.where((seen[:, 2] > 0) & np.isfinite(distance), distance, np.inf))

    def residual_vectors_px(self, theta: Float64Array) -> Float64Array:
        """Return clicked minus predicted pixel of every pair in the image that was clicked, shape (N, 2)."""
        seen, in_color = self._seen(theta), self.points.in_color[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            of_depth, of_color = self.rig.proximity.intrinsics.project(seen), color_lens(self.rig).project(seen)
        return np.asarray(self.points.proximity - np.where(in_color, of_color, of_depth))

    def _rays_of_depth_camera(self) -> Float64Array:
        """Map clicks in the colour image to rays of the depth camera, assuming the tactile distance.

        The cameras stand side by side, so the error is about a pixel, which is enough for an initial value.
        """
        seen, depth = self.measurements.seen[:, :2], self.measurements.known[:, 2:]
        T_depth_color = np.linalg.inv(color_pose(self.rig))
        moved = np.column_stack([seen * depth, depth]) @ T_depth_color[:3, :3].T + T_depth_color[:3, 3]
        return np.ascontiguousarray(np.where(self.measurements.camera[:, None] == 1, moved[:, :2] / moved[:, 2:], seen))

    def prior(self, theta: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return how far scale and offset are from none, and, if the scale is fitted, the baseline from the stated.

        In units of the stated noise of the clicks over the observed one.
        """
        apart, sigma = self._corrections(theta) - np.array([1.0, 0.0]), (_SCALE_SIGMA, _OFFSET_SIGMA_M)
        residuals = [apart[which] / sigma[which] for which in self.free]
        derivative = np.zeros((len(self.free) + 1, len(theta)))
        for row, which in enumerate(self.free):
            derivative[row, 6 + row] = 1.0 / sigma[which]
        stated = self.rig.T_proximity_tactile
        if stated is None or 0 not in self.free:
            return self.observed * np.array(residuals), self.observed * derivative[:-1]
        baseline = float(np.linalg.norm(theta[3:6]))
        stated_baseline = float(np.linalg.norm(np.asarray(stated)[:3, 3]))
        residuals.append((baseline - stated_baseline) / BASELINE_SIGMA_M)
        derivative[-1, 3:6] = theta[3:6] / (baseline * BASELINE_SIGMA_M)
        return self.observed * np.array(residuals), self.observed * derivative


def fit_rigid(
    points: RigidPoints,
    rig: Rig,
    *,
    click_sigma_px: float = CLICK_SIGMA_PX,
    depth_fit: DepthFit = "none",
    like: RigidFit | None = None,
    names: Sequence[str] | None = None,
) -> RigidFit:
    """Fit the tactile camera's pose in the proximity frame; outliers are rejected.

    Parameters
    ----------
    points : RigidPoints
    rig : Rig
        Lenses and the colour camera's extrinsic.
    click_sigma_px : float
        Noise of the clicks. Beside that of the tactile depth it weighs the measurements; the size of both is replaced
        by the observed noise if there are surplus pairs.
    depth_fit : {"none", "offset", "scale", "both"}
        Corrections of the tactile depth that are also fitted.
    like : RigidFit, optional
        Take the inliers and the noise of this fit to the same points, to compare with it.
    names : sequence of str, optional
        Names of the pairs for refusals; default: their numbers from 1.

    Raises
    ------
    CalibrationError
        There are fewer than four pairs with depth, the points are collinear, or the pairs do not agree on one pose.
    """
    free = _FREE[depth_fit]
    least = MIN_POINTS + (1 if free else 0)
    name = f"rigid alignment{' with depth correction' if free else ''}"
    check_space(points.places, points.proximity, least, name)
    observed = 1.0
    known: BoolArray | None = None
    rivals: tuple[Rival, ...] = ()
    if like is not None:
        known, observed = like.used, like.noise_factor
    for _ in range(_NOISE_ROUNDS if free and like is None else 1):
        problem = RigidProblem(points, rig, click_sigma_px, depth_fit, names, observed)
        fit = fit_robustly(problem, known)
        rivals = fit.rivals or rivals  # only the first round looks for them
        known, observed = fit.used, max(fit.noise_factor, _MIN_NOISE)
    return RigidFit(problem, fit.solution, fit.used, rivals)
