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
from dataclasses import dataclass, replace
from typing import Literal, get_args

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from ..model.arrays import BoolArray, Float64Array, IndexArray
from ..model.frames import Rig
from ..model.intrinsics import Intrinsics
from .correspondences import check_space, on_a_line, spread
from .homography import CLICK_SIGMA_PX
from .maximum_likelihood import UNMEASURED, Linearised, Measurements, Prior, inverse_information
from .robust import Problem, Rival, RobustFit, doubtful, fit_robustly, left_out_residuals_px, numbered, rivals_px

#: Which correction of the tactile depth is fitted.
DepthFit = Literal["none", "offset", "scale", "both"]
DEPTH_FITS: tuple[DepthFit, ...] = get_args(DepthFit)
#: Index of the fitted corrections among scale and offset.
_FREE: dict[DepthFit, tuple[int, ...]] = {"none": (), "offset": (1,), "scale": (0,), "both": (0, 1)}

_NEWTON_STEPS = 8
_DIFFERENCE_PX = 0.5
#: Standard deviations of the tactile and the proximity depth under a click, metres.
TACTILE_DEPTH_SIGMA_M = 0.0005
PROXIMITY_DEPTH_SIGMA_M = 0.001
#: Standard deviation of the rig's stated baseline, metres; only used if a depth scale is fitted.
BASELINE_SIGMA_M = 0.0002
#: Standard deviations of the prior on scale and offset, from data sheets.
_SCALE_SIGMA, _OFFSET_SIGMA_M = 0.05, 0.03

#: A prior must be weighed against the observed noise, so the fit is repeated with the noise of the fit before.
_NOISE_ROUNDS, _MIN_NOISE = 3, 1e-6

#: A pair with a larger residual is an outlier, because the rigid model is exact, pixels.
_MAX_PX = 12.0

_SAMPLE = 3
MIN_POINTS = 4


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
    for _ in range(_NEWTON_STEPS):
        rays = rays + (pixels - _project_rays(intrinsics, rays)) / focal
    return rays


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


def color_to_depth_pixels(rig: Rig, pixels: npt.ArrayLike, depth_m: npt.ArrayLike) -> Float64Array:
    """Map pixels of the proximity colour image to proximity depth pixels.

    The point on the colour camera's ray at the given distance is transformed by the factory extrinsics. The proximity
    depth image is not used, because it looks through the membrane.

    Parameters
    ----------
    pixels : array_like, shape (N, 2)
    depth_m : array_like, shape (N,)
        Distance of the membrane from the colour camera along its z axis, metres.
    """
    rays, depth = ray_seen(color_lens(rig), pixels), np.asarray(depth_m, np.float64)[:, None]
    T_depth_color = np.linalg.inv(color_pose(rig))
    points = np.column_stack([rays * depth, depth]) @ T_depth_color[:3, :3].T + T_depth_color[:3, 3]
    return rig.proximity.intrinsics.project(points)


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


@dataclass(frozen=True, eq=False)
class Pose:
    """Rotation, translation (metres) and depth correction: what is fitted."""

    rotation: Float64Array
    translation: Float64Array
    scale: float = 1.0
    offset_m: float = 0.0

    @property
    def matrix(self) -> Float64Array:
        """``T_p_t``, shape (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation
        return matrix


@dataclass(frozen=True, eq=False)
class RigidFit:
    """A fitted pose with its statistics.

    Attributes
    ----------
    pose : Pose
    used : bool, shape (N,)
        Inliers.
    residuals_px : float64, shape (N, 2)
        Clicked minus predicted pixel, in the proximity image that was clicked.
    degrees, noise_factor, condition, doubtful
        As in `HomographyFit`.
    """

    pose: Pose
    used: BoolArray
    residuals_px: Float64Array
    degrees: int
    noise_factor: float
    condition: float
    doubtful: tuple[int, ...]
    rig: Rig
    problem: RigidProblem
    fit: RobustFit[Pose]

    @property
    def parameters(self) -> int:
        """Number of fitted parameters: 6, and one each for scale and offset."""
        return len(self.fit.solution.information)

    @property
    def T_proximity_tactile(self) -> Float64Array:
        """Pose of the tactile camera in the proximity depth frame, shape (4, 4), metres."""
        return self.pose.matrix

    @property
    def rms_px(self) -> float:
        """Root mean square residual of the inliers in the proximity images, pixels."""
        return float(np.sqrt((self.residuals_px[self.used] ** 2).sum(axis=1).mean()))

    @property
    def covariance(self) -> Float64Array:
        """Covariance of rotation vector (rad), translation (m) and, where fitted, scale and offset (m)."""
        solution = self.fit.solution
        return np.asarray(self.fit.noise_factor**2 * inverse_information(solution.information))

    @property
    def depth_sigma(self) -> tuple[float | None, float | None]:
        """Standard deviations of scale (no unit) and offset (m); None where not fitted."""
        free, sigma = self.problem.free, np.sqrt(np.diag(self.covariance))[6:].tolist()
        scale, offset = (sigma[free.index(i)] if i in free else None for i in (0, 1))
        return scale, offset

    def left_out_residuals_px(self) -> Float64Array:
        """Return each pair's residual (N, 2) under the fit of the other pairs; nan if they determine no model."""
        return left_out_residuals_px(self.problem, self.fit)

    def points_m(self, places: npt.ArrayLike) -> Float64Array:
        """Map tactile pixels and raw depths (N, 3) to points in the proximity depth frame, metres."""
        return self._moved(self.pose, places)

    def _moved(self, pose: Pose, places: npt.ArrayLike) -> Float64Array:
        places = np.asarray(places, np.float64)
        depth = pose.scale * places[:, 2] + pose.offset_m
        rays = ray_seen(self.rig.tactile.intrinsics, places[:, :2])
        return np.asarray(np.column_stack([rays * depth[:, None], depth]) @ pose.rotation.T + pose.translation)

    def predict(self, places: npt.ArrayLike) -> Float64Array:
        """Map tactile pixels and raw depths (N, 3) to proximity depth pixels (N, 2)."""
        return self.rig.proximity.intrinsics.project(self.points_m(places))

    def sensitivity(self, places: npt.ArrayLike) -> Float64Array:
        """Return the derivative (N, 2, P) of predicted proximity depth pixels by whitened parameters.

        Whitened parameters have unit covariance, so ``J J^T`` is the covariance of the prediction.
        """
        points, by_point = self.points_m(places), self._by_whitened(places)
        focal = np.array([self.rig.proximity.intrinsics.fx, self.rig.proximity.intrinsics.fy])
        ray = points[:, :2] / points[:, 2:]
        along = by_point[:, :2] - ray[:, :, None] * by_point[:, 2:3]
        return np.asarray(along / points[:, 2, None, None] * focal[:, None])

    def rivals_px(self, places: npt.ArrayLike) -> Float64Array:
        """As `HomographyFit.rivals_px`."""
        project = self.rig.proximity.intrinsics.project
        return rivals_px(self.fit, lambda pose: project(self._moved(pose, places)))

    def depth_sensitivity(self, places: npt.ArrayLike) -> Float64Array:
        """Return the derivative (N, P) of the distance along z, metres, by whitened parameters."""
        return np.asarray(self._by_whitened(places)[:, 2])

    def _by_whitened(self, places: npt.ArrayLike) -> Float64Array:
        places = np.asarray(places, np.float64)
        rays = np.column_stack([ray_seen(self.rig.tactile.intrinsics, places[:, :2]), places[:, 2]])
        _, by_theta, _ = self.problem.transform(self.pose, rays)
        return np.asarray(by_theta @ np.linalg.cholesky(self.covariance))


class RigidProblem(Problem[Pose]):
    """Pose estimation in normalised coordinates; lens distortion is removed from the clicks first."""

    name = "rigid alignment"
    sample_size = _SAMPLE

    def __init__(
        self,
        points: RigidPoints,
        rig: Rig,
        sigmas: Float64Array,
        depth_fit: DepthFit,
        names: Sequence[str] | None,
    ) -> None:
        sigma_tactile_px, sigma_proximity_px, sigma_depth_m = sigmas
        self.names = numbered(len(points.tactile)) if names is None else names
        self.points, self.rig, self.free = points, rig, _FREE[depth_fit]
        count = len(points.tactile)
        poses = np.stack([np.eye(4), color_pose(rig)])
        self.camera_rotation, self.camera_translation = poses[:, :3, :3], poses[:, :3, 3]
        self.measures_depth = bool(np.isfinite(points.proximity_depth_m).any())
        self.size = 3 if self.measures_depth else 2

        known_covariance = np.zeros((count, 3, 3))
        known_covariance[:, :2, :2] = ray_covariance(rig.tactile.intrinsics, points.tactile, sigma_tactile_px)
        known_covariance[:, 2, 2] = sigma_depth_m**2
        seen = np.zeros((count, self.size))
        seen_covariance = np.zeros((count, self.size, self.size))
        for lens, which in ((rig.proximity.intrinsics, ~points.in_color), (color_lens(rig), points.in_color)):
            clicks = points.proximity[which]
            seen[which, :2] = ray_seen(lens, clicks)
            seen_covariance[which, :2, :2] = ray_covariance(lens, clicks, sigma_proximity_px)
        if self.measures_depth:
            measured = np.isfinite(points.proximity_depth_m)
            seen[:, 2] = np.where(measured, points.proximity_depth_m, 0.0)
            seen_covariance[:, 2, 2] = np.where(measured, PROXIMITY_DEPTH_SIGMA_M**2, UNMEASURED)
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
        self.noise_px = float(np.hypot(sigma_tactile_px * ratio, sigma_proximity_px))
        self.space = np.column_stack([rays * points.tactile_depth_m[:, None], points.tactile_depth_m])
        self.start_rays = self._rays_of_depth_camera()
        _, self.area = spread(points.proximity)
        self.largest_px = self.largest_rms_px = _MAX_PX
        self.prior = Prior(self._prior_residuals) if self.free else None

    def transform(self, theta: Pose, places: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Map places (ray and raw depth) to proximity points, with derivatives (N, 3, P) and (N, 3, 3)."""
        depth = theta.scale * places[:, 2] + theta.offset_m
        rays = np.column_stack([places[:, :2], np.ones(len(places))]) @ theta.rotation.T
        turned = rays * depth[:, None]
        by_theta = np.zeros((len(places), 3, 6 + len(self.free)))
        by_theta[:, :, :3] = -_cross_matrices(turned)
        by_theta[:, :, 3:6] = np.eye(3)
        for column, which in enumerate(self.free, 6):
            by_theta[:, :, column] = rays if which else rays * places[:, 2:]
        by_place = np.empty((len(places), 3, 3))
        by_place[:, :, :2] = theta.rotation[:, :2] * depth[:, None, None]
        by_place[:, :, 2] = rays * theta.scale
        return turned + theta.translation, by_theta, by_place

    def linearise(self, theta: Pose, places: Float64Array, camera: IndexArray) -> Linearised:
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

    def retract(self, theta: Pose, step: Float64Array) -> Pose:
        """Rotate about and translate along the proximity axes."""
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        moved = replace(theta, rotation=turn @ theta.rotation, translation=theta.translation + step[3:6])
        corrected = np.array([theta.scale, theta.offset_m])
        corrected[list(self.free)] += step[6:]
        return replace(moved, scale=float(corrected[0]), offset_m=float(corrected[1]))

    def start(self, used: BoolArray) -> Pose | None:
        """Solve SQPnP on the used pairs."""
        space = self.space[used]
        if len(space) < MIN_POINTS or on_a_line(space):
            return None
        found, turn, shift = cv2.solvePnP(
            space, self.start_rays[used], np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
        )  # fmt: skip
        return Pose(Rotation.from_rotvec(turn.ravel()).as_matrix(), shift.ravel().astype(np.float64)) if found else None

    def hypotheses(self, samples: IndexArray) -> list[Pose]:
        """Solve P3P for each sample: up to four poses each."""
        poses = []
        for sample in samples:
            if on_a_line(self.space[sample]):
                continue
            count, turns, shifts = cv2.solveP3P(
                self.space[sample], self.start_rays[sample], np.eye(3), None, flags=cv2.SOLVEPNP_AP3P
            )
            for turn, shift in zip(turns[:count], shifts[:count], strict=True):
                poses.append(Pose(Rotation.from_rotvec(turn.ravel()).as_matrix(), shift.ravel().astype(np.float64)))
        return poses

    def residuals_px(self, theta: Pose) -> Float64Array:
        """Return residual lengths in the clicked image, without lens distortion, pixels."""
        points = self.space @ theta.rotation.T * theta.scale
        if theta.offset_m:
            points += (self.space / self.space[:, 2:]) @ theta.rotation.T * theta.offset_m
        camera = self.measurements.camera
        seen = (self.camera_rotation[camera] @ (points + theta.translation)[:, :, None])[:, :, 0]
        seen += self.camera_translation[camera]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.hypot(*((seen[:, :2] / seen[:, 2:] - self.measurements.seen[:, :2]) * self.focal).T)
        return np.asarray(np.where((seen[:, 2] > 0) & np.isfinite(distance), distance, np.inf))

    def residual_vectors_px(self, theta: Pose) -> Float64Array:
        """Return clicked minus predicted pixel of every pair in the image that was clicked, shape (N, 2)."""
        points, _, _ = self.transform(theta, self.measurements.known)
        camera = self.measurements.camera
        seen = (self.camera_rotation[camera] @ points[:, :, None])[:, :, 0] + self.camera_translation[camera]
        with np.errstate(divide="ignore", invalid="ignore"):
            of_depth, of_color = self.rig.proximity.intrinsics.project(seen), color_lens(self.rig).project(seen)
        return np.asarray(self.points.proximity - np.where((camera == 1)[:, None], of_color, of_depth))

    def _rays_of_depth_camera(self) -> Float64Array:
        """Map clicks in the colour image to rays of the depth camera, assuming the tactile distance.

        The cameras stand side by side, so the error is about a pixel, which is enough for an initial value.
        """
        seen, depth = self.measurements.seen[:, :2], self.measurements.known[:, 2:]
        T_depth_color = np.linalg.inv(color_pose(self.rig))
        moved = np.column_stack([seen * depth, depth]) @ T_depth_color[:3, :3].T + T_depth_color[:3, 3]
        return np.ascontiguousarray(np.where(self.measurements.camera[:, None] == 1, moved[:, :2] / moved[:, 2:], seen))

    def _prior_residuals(self, theta: Pose) -> tuple[Float64Array, Float64Array]:
        """Return how far scale and offset are from none, and, if the scale is fitted, the baseline from the stated."""
        apart, sigma = (theta.scale - 1.0, theta.offset_m), (_SCALE_SIGMA, _OFFSET_SIGMA_M)
        residuals = [apart[which] / sigma[which] for which in self.free]
        derivative = np.zeros((len(self.free) + 1, 6 + len(self.free)))
        for row, which in enumerate(self.free):
            derivative[row, 6 + row] = 1.0 / sigma[which]
        stated = self.rig.T_proximity_tactile
        if stated is None or 0 not in self.free:
            return np.array(residuals), derivative[:-1]
        baseline = float(np.linalg.norm(theta.translation))
        stated_baseline = float(np.linalg.norm(np.asarray(stated)[:3, 3]))
        residuals.append((baseline - stated_baseline) / BASELINE_SIGMA_M)
        derivative[-1, 3:6] = theta.translation / (baseline * BASELINE_SIGMA_M)
        return np.array(residuals), derivative


def fit_rigid(
    points: RigidPoints,
    rig: Rig,
    *,
    sigma_tactile_px: float = CLICK_SIGMA_PX,
    sigma_proximity_px: float = CLICK_SIGMA_PX,
    sigma_depth_m: float = TACTILE_DEPTH_SIGMA_M,
    depth_fit: DepthFit = "none",
    like: RigidFit | None = None,
    names: Sequence[str] | None = None,
) -> RigidFit:
    """Fit the tactile camera's pose in the proximity frame; outliers are left out.

    Parameters
    ----------
    points : RigidPoints
    rig : Rig
        Lenses and the colour camera's extrinsic.
    sigma_tactile_px, sigma_proximity_px, sigma_depth_m : float
        Noise of clicks and of the tactile depth. Their ratios weigh the measurements; their common size is replaced by
        the observed noise if there are surplus pairs.
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
    stated, observed = np.array([sigma_tactile_px, sigma_proximity_px, sigma_depth_m]), 1.0
    known: BoolArray | None = None
    rivals: tuple[Rival[Pose], ...] = ()
    if like is not None:
        known, observed = like.used, like.noise_factor
    for _ in range(_NOISE_ROUNDS if free and like is None else 1):
        problem = RigidProblem(points, rig, observed * stated, depth_fit, names)
        fit = fit_robustly(problem, known)
        rivals = fit.rivals or rivals  # only the first round looks for them
        known, observed = fit.used, max(observed * fit.noise_factor, _MIN_NOISE)
    fit = replace(fit, rivals=rivals)
    return RigidFit(
        pose=fit.solution.theta,
        used=fit.used,
        residuals_px=problem.residual_vectors_px(fit.solution.theta),
        degrees=fit.solution.degrees,
        noise_factor=observed,
        condition=fit.condition,
        doubtful=doubtful(fit),
        rig=rig,
        problem=problem,
        fit=fit,
    )


def _cross_matrices(vectors: Float64Array) -> Float64Array:
    matrices = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
    matrices[:, 1, 0], matrices[:, 2, 0], matrices[:, 2, 1] = z, -y, x
    return matrices
