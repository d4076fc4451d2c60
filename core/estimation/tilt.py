"""The tilt of a contact patch: its plane as two angles, and the direction of its long axis in the image.

Two estimators. `pca` takes the normal from the principal components of the points, as Yin et al. do. `noise` fits the
plane by least squares and uses what is known of the errors:

* On a plane the inverse depth is linear in the rays, 1 / z = a + b x / z + c y / z, and the normal is along (b, c, a).
  An error of the depth moves a point along its ray, so only the left side has errors: least squares of it is unbiased.
* Points are not independent. Each camera has white noise and noise that neighbours share (`CameraNoise`), and a time of
  flight camera has errors that vary over a large part of the image. The covariance of every linear functional of the
  depth follows exactly from these: f C f', where C is the sum of a diagonal and of products of Gaussians of rows and
  columns, so it costs two small matrix products.
* In contact both cameras see the same surface. So the difference of their depths shows the errors of both, and the
  error of the plane is predicted from the difference's plane and three quadratic modes (the best linear prediction, as
  in kriging). The amplitude of the slow error is that measured on the rig (`rig.slow_error`). Where it was not, the
  result is a sum over amplitudes, weighted by how well they explain the difference.

The standard deviation is about the plane that fits best. It does not contain a wrong rotation between the cameras'
calibration and the robot, nor the shape of an object that is not flat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from ..contact.checks import rig_in_use
from ..methods.method import MethodPatch
from ..model.arrays import Float32Array, Float64Array
from ..model.frames import Rig
from ..model.intrinsics import Intrinsics
from ..model.patch import ContactPatch
from ..preset import Preset
from ..rig.slow_error import SLOW_CHANCE, SLOW_LENGTH, SLOW_M
from .plane import Cells, DepthNoise, Functionals

TiltMethod = Literal["pca", "noise"]

#: Noise of an L515 and a D405, in proximity pixels, for a rig whose noise was not measured.
_USUAL_PROXIMITY: Final = DepthNoise(0.0002, 0.0009, 2.0, 0.5, 0.285, power=0)
_USUAL_TACTILE: Final = DepthNoise(0.0003, 0.0011, 6.0, 0.5, 0.285, power=2)
#: Slow error that is assumed where it was not measured and no difference shows it, metres.
_USUAL_SLOW_M: Final = 0.0004
#: The tactile plane has this share of the slow proximity error: where that error is towards the camera, membrane beside
#: the contact counts as contact. Measured with sim:tray on sensors that are not held out.
_SHARED_SLOW: Final = 0.25
#: That share differs from patch to patch: the tactile plane has an error of its own, this share of the slow error.
_OWN_SLOW: Final = 0.125
#: An angle with a larger standard deviation is not determined, radians: 5 and 15 degrees.
MAX_SIGMA_RAD: Final = math.radians(5.0)
MAX_AXIS_SIGMA_RAD: Final = math.radians(15.0)
#: Random displacement of the patch's edge: standard deviation, and the length over which it is shared, metres.
_EDGE_M, _EDGE_LENGTH_M = 0.0015, 0.010
_MIN_POINTS: Final = 12


@dataclass(frozen=True)
class Tilt:
    r"""The plane of a contact patch at one moment.

    All vectors are in the proximity depth frame: x right, y down, z forward, away from the camera. The patch's normal
    points away from the camera. ``roll`` turns about x, ``pitch`` about y, both right-handed, in ROS's order (first
    roll, then pitch, about the camera's axes)::

        normal = R_y(pitch) R_x(roll) (0, 0, 1) = (sin(pitch) cos(roll), -sin(roll), cos(pitch) cos(roll))

        roll > 0: seen from +x           pitch > 0: seen from -y, from above

             z (forward)                      z (forward)
             |      / patch                   | \ patch
             |    /                           |   \
             |  /                             |     \
             +--------- y (down)              +--------- x (right)

    So the lower edge of the image is farther with a positive roll, the right edge is nearer with a positive pitch. Both
    are 0 where the patch faces the camera.

    Attributes
    ----------
    sequence : int
        Number of the frame.
    time_s : float
        Time stamp of the proximity image, seconds.
    method : {"pca", "noise"}
    points : int
        Number of points of the patch.
    centroid_m : (float, float, float) or None
        Mean of the points, metres; None without contact.
    roll_rad, pitch_rad : float or None
        Radians, -pi/2 to pi/2; None if not determined: no contact, or the patch is a line or a dot.
    roll_sigma_rad, pitch_sigma_rad : float or None
        Their standard deviations, radians; None where the angle is.
    roll_pitch_covariance_rad2 : float
        Covariance of roll and pitch; 0 unless both are determined.
    axis_rad : float or None
        Direction of the long axis in the image, radians, -pi/2 to pi/2, from +u (right) towards +v (down); None for a
        patch that is about as wide as long.
    axis_sigma_rad : float or None
    fixed_share : float
        Share of the variance of roll and pitch that stays from frame to frame, 0 to 1: time does not average it.
    roll_rate_rad_s, pitch_rate_rad_s : float or None
        Rates, radians per second; None unless the tilt was filtered over time.
    roll_rate_sigma_rad_s, pitch_rate_sigma_rad_s : float or None
    """

    sequence: int
    time_s: float
    method: TiltMethod
    points: int
    centroid_m: tuple[float, float, float] | None = None
    roll_rad: float | None = None
    roll_sigma_rad: float | None = None
    pitch_rad: float | None = None
    pitch_sigma_rad: float | None = None
    roll_pitch_covariance_rad2: float = 0.0
    axis_rad: float | None = None
    axis_sigma_rad: float | None = None
    fixed_share: float = 0.0
    roll_rate_rad_s: float | None = None
    roll_rate_sigma_rad_s: float | None = None
    pitch_rate_rad_s: float | None = None
    pitch_rate_sigma_rad_s: float | None = None

    def record(self) -> dict[str, Any]:
        """Return the angles and their standard deviations as JSON values, None where not determined."""
        names = [f"{angle}{sigma}_rad" for angle in ("roll", "pitch", "axis") for sigma in ("", "_sigma")]
        if self.roll_rate_rad_s is not None or self.pitch_rate_rad_s is not None:
            names += [f"{angle}_rate{sigma}_rad_s" for angle in ("roll", "pitch") for sigma in ("", "_sigma")]
        return {name: getattr(self, name) for name in names}


class TiltEstimator:
    """Estimates the tilt of one patch after another.

    Parameters
    ----------
    preset : Preset
        Its measured noise, if any; else that of usual cameras is assumed.
    rig : Rig
    method : {"noise", "pca"}
        The standard deviations follow from the noise with both.
    """

    def __init__(self, preset: Preset, rig: Rig, method: TiltMethod = "noise") -> None:
        self.method: TiltMethod = method
        rig = rig_in_use(preset, rig)
        self._lens = rig.proximity.intrinsics
        self._proximity, self._tactile = _USUAL_PROXIMITY, _USUAL_TACTILE
        if preset.noise is not None:
            pixels = rig.proximity.intrinsics.fx / rig.tactile.intrinsics.fx
            self._proximity = DepthNoise.of(preset.noise.proximity, 1.0, power=0)
            self._tactile = DepthNoise.of(preset.noise.tactile, pixels, power=2)
        self._slow_m = None if preset.noise is None else preset.noise.slow_m
        length_px = SLOW_LENGTH * rig.proximity.intrinsics.width
        self._slow = DepthNoise(0.0, 1.0, length_px, 1.0, 1.0, power=0)

    def estimate(self, patch: ContactPatch | MethodPatch, sequence: int = 0, time_s: float = 0.0) -> Tilt:
        """Return the tilt of a patch.

        Parameters
        ----------
        patch : ContactPatch or MethodPatch
            The differences of both depths are used where the membrane test found the patch. Points of other tests and
            methods count as proximity points.
        sequence, time_s
            Number and time stamp of the frame, passed on.
        """
        difference, weight = None, 0.0
        if isinstance(patch, ContactPatch) and patch.membrane is not None and len(patch.points):
            difference, weight = patch.membrane.difference_m.get(), patch.membrane.tactile_weight
        return self.of_points(patch.points, difference, weight, patch.averaged_frames, sequence, time_s)

    def of_points(
        self,
        points: Float32Array,
        difference_m: Float32Array | None = None,
        tactile_weight: float = 0.0,
        averaged_frames: int = 1,
        sequence: int = 0,
        time_s: float = 0.0,
    ) -> Tilt:
        """Return the tilt of points in any order.

        Parameters
        ----------
        points : float, shape (N, 3)
            Metres, proximity depth frame.
        difference_m : float, shape (N,), optional
            Proximity less tactile depth at the points, without their constant bias, metres; nan where one is missing.
        tactile_weight : float
            Weight of the tactile depth in the depth of the points, 0 to 1.
        averaged_frames, sequence, time_s
            As in the patch and the frame.
        """
        found = Tilt(sequence, time_s, self.method, len(points))
        if len(points) < _MIN_POINTS:
            return found
        cells = Cells.of(points, difference_m, self._lens)
        if len(cells.count) < 3:
            return found
        power = (1 - tactile_weight) ** 2 * self._proximity.power_m2(cells.depth_m)
        power += tactile_weight**2 * self._tactile.power_m2(cells.depth_m)
        variance = power * cells.inverse_m**4  # of the inverse depth of a point
        weights = cells.count / (variance if self.method == "noise" else variance.mean())
        fit = Functionals(cells, weights, self._lens.fx)
        plane, covariance, changing = self._fit(cells, fit, tactile_weight, averaged_frames)
        if self.method == "pca":
            plane = _principal_plane(points)
        angles, jacobian = _angles(plane)
        covariance, changing = (jacobian @ matrix @ jacobian.T for matrix in (covariance, changing))
        sigma = np.sqrt(np.diag(covariance))
        roll, pitch = (
            (float(angles[i]), float(sigma[i])) if sigma[i] <= MAX_SIGMA_RAD else (None, None) for i in (0, 1)
        )
        axis = _long_axis(cells, self._lens)
        x, y, z = np.full(len(points), 1 / len(points)) @ points
        return replace(
            found,
            centroid_m=(float(x), float(y), float(z)),
            roll_rad=roll[0],
            roll_sigma_rad=roll[1],
            pitch_rad=pitch[0],
            pitch_sigma_rad=pitch[1],
            roll_pitch_covariance_rad2=float(covariance[0, 1]) if None not in (roll[0], pitch[0]) else 0.0,
            axis_rad=axis[0],
            axis_sigma_rad=axis[1],
            fixed_share=1.0 - float(np.trace(changing) / np.trace(covariance)),
        )

    def _fit(
        self, cells: Cells, fit: Functionals, tactile_weight: float, averaged_frames: int
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return the plane (a, b, c), its covariance, and the part of it that changes from frame to frame.

        With a gain G the estimate is the plane of the points less G times the modes of the difference. Its error is
        linear in the errors of both cameras. It is averaged over the amplitudes of the slow error by their chances.
        """
        plane = fit.matrix[:3] @ cells.inverse_m
        errors = self._errors(fit, averaged_frames)
        modes, chance, gains = np.zeros(len(errors.near) - 3), errors.prior, np.zeros((1, 3, len(errors.near) - 3))
        if cells.difference_m is not None:
            modes = fit.matrix[3:] @ (-cells.difference_m * cells.inverse_m**2)
            chance, gains = errors.explain(modes, tactile_weight)
            if self.method == "pca":
                gains = np.zeros_like(gains)
        shifts = gains @ modes
        shift = chance @ shifts

        from_near, from_far = _operators(tactile_weight, gains)
        from_slow = from_near + _SHARED_SLOW * from_far
        parts = ((from_near, errors.near), (from_far, errors.far), (from_slow, errors.slow))
        each = sum(np.asarray(to @ error @ to.swapaxes(1, 2)) for to, error in parts)
        away = shifts - shift
        covariance = np.tensordot(chance, each, 1) + (away.T * chance) @ away + fit.unknown
        from_near, from_far = _operators(tactile_weight, np.tensordot(chance, gains, 1))
        changing = from_near @ errors.near_changing @ from_near.T + from_far @ errors.far_changing @ from_far.T
        return plane - shift, covariance, changing

    def _errors(self, fit: Functionals, averaged_frames: int) -> _Errors:
        near, near_fixed = fit.covariance(self._proximity, averaged_frames)
        far, far_fixed = fit.covariance(self._tactile, averaged_frames)
        slow_m, prior = np.array([_USUAL_SLOW_M if self._slow_m is None else self._slow_m]), np.ones(1)
        if self._slow_m is None and fit.cells.difference_m is not None:
            slow_m, prior = SLOW_M, SLOW_CHANCE
        slow = (slow_m**2)[:, None, None] * fit.covariance(self._slow, 1)[0]
        return _Errors(near, near - near_fixed, far + _OWN_SLOW**2 * slow, far - far_fixed, slow, prior)


class _Errors(NamedTuple):
    """Covariances of the errors of the eight functionals, (8, 8), or (S, 8, 8) for S amplitudes of the slow error.

    The proximity depth has the errors ``near`` and ``slow``, the tactile depth ``far`` and `_SHARED_SLOW` of ``slow``.
    ``prior`` are the chances of the amplitudes, (S,).
    """

    near: Float64Array
    near_changing: Float64Array
    far: Float64Array
    far_changing: Float64Array
    slow: Float64Array
    prior: Float64Array

    def explain(self, modes: Float64Array, tactile_weight: float) -> tuple[Float64Array, Float64Array]:
        """Return the chance of each amplitude, (S,), and its gain, (S, 3, 5), by the modes m of the difference.

        m is normal with the covariance V, so the chance is proportional to ``prior exp(-m' V^-1 m / 2) / |V|^(1/2)``.
        The best linear prediction of the plane's error is ``G m`` with ``G = cov(plane, m) V^-1``.
        """
        of_difference = (self.near + self.far + (1 - _SHARED_SLOW) ** 2 * self.slow)[:, 3:, 3:]
        inverse = np.linalg.inv(of_difference)
        log_chance = -0.5 * (np.einsum("i,sij,j->s", modes, inverse, modes) + np.linalg.slogdet(of_difference)[1])
        chance = self.prior * np.exp(log_chance - log_chance.max())
        own_slow = 1 - tactile_weight * (1 - _SHARED_SLOW)  # of the points' depth
        both = (1 - tactile_weight) * self.near - tactile_weight * self.far
        return chance / chance.sum(), (both + own_slow * (1 - _SHARED_SLOW) * self.slow)[:, :3, 3:] @ inverse


def _operators(tactile_weight: float, gains: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return how the plane's error follows from the functionals of either camera's errors, shape (..., 3, 8)."""
    own = np.broadcast_to(np.eye(3), (*gains.shape[:-2], 3, 3))
    return np.concatenate([(1 - tactile_weight) * own, -gains], -1), np.concatenate([tactile_weight * own, gains], -1)


def _angles(plane: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return roll and pitch of the plane 1 / z = a + b x / z + c y / z, radians, and their Jacobian, shape (2, 3)."""
    a, b, c = plane
    flat, all_ = math.hypot(a, b), float(plane @ plane)
    angles = np.array([math.atan2(-c, flat), math.atan2(b, a)])
    jacobian = np.array(
        [[c * a / (flat * all_), c * b / (flat * all_), -flat / all_], [-b / flat**2, a / flat**2, 0.0]]
    )
    return angles, jacobian


def _principal_plane(points: Float32Array) -> Float64Array:
    """Return (a, b, c) of the plane through the centroid, across the direction of least scatter (Yin et al.)."""
    centroid = np.full(len(points), 1 / len(points)) @ points
    away = points - centroid
    x, y, z = np.linalg.eigh(away.T @ away)[1][:, 0]
    plane: Float64Array = np.array([z, x, y]) / (np.array([x, y, z]) @ centroid)
    return plane


def _long_axis(cells: Cells, lens: Intrinsics) -> tuple[float | None, float | None]:
    """Return direction of the long axis in the image and its standard deviation, radians; None where it has none.

    It is the direction of the larger principal component of the pixels. A displacement d of the edge changes their
    mixed second moment by the integral of u v d along the edge, over the area; the edge is taken for an ellipse's.
    """
    moments = np.cov(lens.fx * cells.x, lens.fy * cells.y, bias=True, aweights=cells.count)
    moments += np.eye(2) * cells.size_px**2 / 12  # within a cell
    angle = 0.5 * math.atan2(2 * moments[0, 1], moments[0, 0] - moments[1, 1])
    small, large = np.linalg.eigvalsh(moments)
    around = 2 * math.pi * math.sqrt(2 * (small + large))
    pixels = lens.fx * float(np.average(cells.inverse_m, weights=cells.count))
    sigma_px2 = _EDGE_M * math.sqrt(_EDGE_LENGTH_M * around / 8) / math.pi * pixels**1.5
    if sigma_px2 > MAX_AXIS_SIGMA_RAD * (large - small):
        return None, None
    return angle, float(sigma_px2 / (large - small))
