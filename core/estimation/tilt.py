"""The tilt of a contact patch: its plane as two angles, and the direction of its long axis.

The plane is fitted by weighted least squares and corrected by the difference of both depths:

* On a plane the inverse depth is linear in the rays, 1 / z = a + b x / z + c y / z, and the normal is along (b, c, a).
  An error of the depth moves a point along its ray, so only the left side has errors: least squares of it is unbiased.
* In contact both cameras see the same surface. So the slopes of the difference of their depths predict the error of
  the plane (the best linear prediction, as in kriging).

The standard deviations follow from the noise, which is not independent: each camera has white noise and noise that
neighbours share (`CameraNoise`), and a time of flight camera has a slow error over the image, for which 0.4 mm is
assumed. The plane is a linear functional f of the inverse depths of square cells of the image. So its covariance is
f C f', where C is the sum of a diagonal and of products of Gaussians of rows and columns. It is about the plane that
fits best, and contains neither a wrong rotation between the cameras' calibration and the robot, nor the shape of an
object that is not flat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from scipy.special import erf

from ..model.arrays import Float32Array, Float64Array, IndexArray
from ..model.frames import Rig
from ..model.intrinsics import Intrinsics
from ..model.patch import ContactPatch
from ..preset import CameraNoise, Preset

#: Standard deviation of the slow error of the proximity depth, metres, and the length over which it is shared, as a
#: share of the image's width: typical of time of flight cameras.
_SLOW_M, _SLOW_LENGTH = 0.0004, 1 / 12
#: The tactile plane has this share of the slow proximity error: where that error is towards the camera, membrane beside
#: the contact counts as contact. Measured with sim:tray on sensors that are not held out.
_SHARED_SLOW: Final = 0.25
#: An angle with a larger standard deviation is not determined, radians: 5 and 15 degrees.
MAX_SIGMA_RAD: Final = math.radians(5.0)
MAX_AXIS_SIGMA_RAD: Final = math.radians(15.0)
#: Random displacement of the patch's edge: standard deviation, and the length over which it is shared, metres.
_EDGE_M, _EDGE_LENGTH_M = 0.0015, 0.010
_MIN_POINTS: Final = 12
#: Most cells along a side of the patch, and their smallest side, pixels.
_MAX_CELLS, _MIN_CELL_PX = 24, 4.0
#: What is known before the points are seen: standard deviations of the inverse depth, 1/m, and of dz/dx and dz/dy.
_ANY_PER_M, _ANY_SLOPE = 100.0, 3.0
#: Lower limit of the white noise of a camera: none is exact, metres.
_MIN_WHITE_M: Final = 1e-6


@dataclass(frozen=True)
class Tilt:
    """The plane of a contact patch at one moment.

    All vectors are in the proximity depth frame: x right, y down, z forward, away from the camera. The patch's normal
    points away from the camera. ``roll`` turns about x, ``pitch`` about y, both right-handed, in ROS's order (first
    roll, then pitch, about the camera's axes)::

        normal = R_y(pitch) R_x(roll) (0, 0, 1) = (sin(pitch) cos(roll), -sin(roll), cos(pitch) cos(roll))

    So the lower edge of the image is farther with a positive roll, the right edge is nearer with a positive pitch. Both
    are 0 where the patch faces the camera.

    Angles are in radians, -pi/2 to pi/2, and None if not determined: no contact, or a patch that is a line or a dot.
    ``axis_rad`` is the direction of the long axis in the image, from +u (right) to +v (down), None for a patch that is
    about as wide as long. ``centroid_m`` is the mean of the points, metres.
    """

    centroid_m: tuple[float, float, float] | None = None
    roll_rad: float | None = None
    roll_sigma_rad: float | None = None
    pitch_rad: float | None = None
    pitch_sigma_rad: float | None = None
    axis_rad: float | None = None
    axis_sigma_rad: float | None = None

    def record(self) -> dict[str, Any]:
        """Return the angles and their standard deviations as JSON values, None where not determined."""
        names = [f"{angle}{sigma}_rad" for angle in ("roll", "pitch", "axis") for sigma in ("", "_sigma")]
        return {name: getattr(self, name) for name in names}


class TiltEstimator:
    """Estimates the tilt of one patch after another.

    Parameters
    ----------
    preset : Preset
        Its measured noise, if any; else that of usual cameras is assumed.
    rig : Rig
        The rig that takes the frames.

    Examples
    --------
    >>> tilts = TiltEstimator(preset, source.rig)
    >>> tilt = tilts.estimate(pipeline.process(frame))
    >>> tilt.roll_rad, tilt.roll_sigma_rad
    """

    def __init__(self, preset: Preset, rig: Rig) -> None:
        self._lens = rig.proximity.intrinsics
        self._proximity, self._tactile = _USUAL_PROXIMITY, _USUAL_TACTILE
        if preset.noise is not None:
            pixels = rig.proximity.intrinsics.fx / rig.tactile.intrinsics.fx
            self._proximity = _DepthNoise.of(preset.noise.proximity, 1.0, power=0)
            self._tactile = _DepthNoise.of(preset.noise.tactile, pixels, power=2)
        self._slow = _DepthNoise(0.0, _SLOW_M, _SLOW_LENGTH * self._lens.width, 1.0, 1.0, power=0)

    def estimate(self, patch: ContactPatch) -> Tilt:
        """Return the tilt of a patch."""
        difference, weight = None, 0.0  # points of other tests and methods count as proximity points
        if patch.membrane is not None and len(patch.points):
            difference, weight = patch.membrane.difference_m.get(), patch.membrane.tactile_weight
        return self.of_points(patch.points, difference, weight, patch.averaged_frames)

    def of_points(
        self,
        points: Float32Array,
        difference_m: Float32Array | None = None,
        tactile_weight: float = 0.0,
        averaged_frames: int = 1,
    ) -> Tilt:
        """Return the tilt of points (N, 3) in any order, metres in the proximity depth frame.

        ``difference_m`` (N,) is proximity less tactile depth at the points, without their constant bias, nan where one
        is missing; ``tactile_weight`` the weight of the tactile depth in the depth of the points, 0 to 1.
        """
        if len(points) < _MIN_POINTS:
            return Tilt()
        cells = _Cells.of(points, difference_m, self._lens)
        if len(cells.count) < 3:
            return Tilt()
        depth_m = 1 / cells.inverse_m
        power = (1 - tactile_weight) ** 2 * self._proximity.power_m2(depth_m)
        power += tactile_weight**2 * self._tactile.power_m2(depth_m)
        variance = power * cells.inverse_m**4  # of the inverse depth of a point
        matrix, unknown = _plane_fit(cells, cells.count / variance, self._lens.fx)
        plane = matrix @ cells.inverse_m

        near = _covariance(matrix, cells, self._proximity, averaged_frames)
        far = _covariance(matrix, cells, self._tactile, averaged_frames)
        slow, weight = _covariance(matrix, cells, self._slow, 1), tactile_weight
        of_slow, apart = 1 - (1 - _SHARED_SLOW) * weight, 1 - _SHARED_SLOW  # shares in the points and the difference
        gain = np.zeros((3, 3))
        if cells.difference_m is not None:
            # The best linear prediction of the plane's error by the slopes of the difference, as in kriging. The
            # difference's mean says nothing: it was taken for a bias.
            together = (1 - weight) * near - weight * far + of_slow * apart * slow
            gain[:, 1:] = together[:, 1:] @ np.linalg.inv((near + far + apart**2 * slow)[1:, 1:])
            plane = plane + gain @ matrix @ (cells.difference_m * cells.inverse_m**2)
        of_near, of_far = (1 - weight) * np.eye(3) - gain, weight * np.eye(3) + gain
        of_slow_error = of_slow * np.eye(3) - apart * gain
        parts = ((of_near, near), (of_far, far), (of_slow_error, slow))
        whole = unknown + sum(part @ covariance @ part.T for part, covariance in parts)

        angles, jacobian = _angles(plane)
        sigma = np.sqrt(np.diag(jacobian @ whole @ jacobian.T))
        roll, pitch = (
            (float(angles[i]), float(sigma[i])) if sigma[i] <= MAX_SIGMA_RAD else (None, None) for i in (0, 1)
        )
        axis = _long_axis(cells, self._lens)
        x, y, z = points.mean(axis=0, dtype=np.float64)
        return Tilt((float(x), float(y), float(z)), roll[0], roll[1], pitch[0], pitch[1], axis[0], axis[1])


@dataclass(frozen=True)
class _DepthNoise:
    """Errors of a camera's depth in pixels of the proximity image, as standard deviations at a distance.

    The white part differs from pixel to pixel. Of the shared part two pixels d pixels apart share
    exp(-d^2 / (4 length_px^2)); ``fixed_share`` of it stays from frame to frame. Both grow with a power of the depth.
    """

    white_m: float
    shared_m: float
    length_px: float
    fixed_share: float
    distance_m: float
    power: int

    @classmethod
    def of(cls, noise: CameraNoise, pixels: float, power: int) -> _DepthNoise:
        """Return the measured noise of a camera of which one pixel covers ``pixels`` pixels of the proximity image."""
        shared = noise.correlated_m**2
        changing = noise.changing_share * noise.total_m**2 - noise.white_m**2  # white noise changes
        fixed_share = 1.0 - min(max(changing / shared, 0.0), 1.0) if shared > 0 else 0.0
        white_m, length_px = max(noise.white_m, _MIN_WHITE_M) * pixels, noise.length_px * pixels
        return cls(white_m, noise.correlated_m, length_px, fixed_share, noise.distance_m, power)

    def power_m2(self, depth_m: Float64Array) -> Float64Array:
        """Return the variance of a mean over many pixels times their number, m^2."""
        growth = (depth_m / self.distance_m) ** (2 * self.power)
        return (self.white_m**2 + 4 * math.pi * (self.shared_m * self.length_px) ** 2) * growth


#: Noise of an L515 and a D405, in proximity pixels, for a rig whose noise was not measured.
_USUAL_PROXIMITY: Final = _DepthNoise(0.0002, 0.0009, 2.0, 0.5, 0.285, power=0)
_USUAL_TACTILE: Final = _DepthNoise(0.0003, 0.0011, 6.0, 0.5, 0.285, power=2)


@dataclass(frozen=True)
class _Cells:
    """Cells with points, (K,), of a grid: flat number ``place``, and the means of x / z, y / z and 1 / z there."""

    rows: int
    columns: int
    size_px: float
    place: IndexArray
    count: Float64Array
    x: Float64Array
    y: Float64Array
    inverse_m: Float64Array
    difference_m: Float64Array | None

    @classmethod
    def of(cls, points: Float32Array, difference_m: Float32Array | None, lens: Intrinsics) -> _Cells:
        """Sort points, shape (N, 3), N > 0, into cells; cells without any known difference are left out."""
        inverse = 1 / points[:, 2]
        x, y = points[:, 0] * inverse, points[:, 1] * inverse
        left, top = float(x.min()), float(y.min())
        width, height = lens.fx * (float(x.max()) - left), lens.fy * (float(y.max()) - top)
        # in steps of half a pixel, so that the tables of `_shared_by_cells` serve again
        size = max(_MIN_CELL_PX, math.ceil(2 * max(width, height) / (_MAX_CELLS - 1)) / 2)
        rows, columns = int(height / size) + 2, int(width / size) + 2
        row, column = (y - top) * (lens.fy / size), (x - left) * (lens.fx / size)
        index = row.astype(np.intp) * columns + column.astype(np.intp)
        count = np.bincount(index, minlength=rows * columns)
        kept, difference = count > 0, None
        if difference_m is not None:
            known = np.isfinite(difference_m)
            seen = np.bincount(index, known, rows * columns)
            total = np.bincount(index, np.where(known, difference_m, 0.0), rows * columns)
            kept = seen > 0
            difference = total[kept] / seen[kept]
        place = np.flatnonzero(kept)
        number = count[place].astype(np.float64)
        x, y, inverse = (np.bincount(index, values, rows * columns)[place] / number for values in (x, y, inverse))
        return cls(rows, columns, size, place, number, x, y, inverse, difference)


def _plane_fit(cells: _Cells, weights: Float64Array, focal_px: float) -> tuple[Float64Array, Float64Array]:
    """Return (3, K), which takes inverse depths to a, b, c, and the covariance that the points leave, (3, 3)."""
    share = weights / weights.sum()
    (x, mean_x, scale_x), (y, mean_y, scale_y) = (
        _normalised(values, share, cells.size_px / focal_px) for values in (cells.x, cells.y)
    )
    basis = np.stack([np.ones_like(x), x, y])
    any_slope = _ANY_SLOPE * float(share @ cells.inverse_m)
    known = np.diag(np.array([_ANY_PER_M, any_slope * scale_x, any_slope * scale_y]) ** -2)
    inverse = np.linalg.inv((basis * weights) @ basis.T + known)
    back = np.array([[1.0, -mean_x / scale_x, -mean_y / scale_y], [0.0, 1.0 / scale_x, 0.0], [0.0, 0.0, 1.0 / scale_y]])
    return back @ inverse @ (basis * weights), back @ inverse @ known @ inverse @ back.T


def _normalised(values: Float64Array, share: Float64Array, cell: float) -> tuple[Float64Array, float, float]:
    """Return values with mean 0 and deviation 1, their mean and their deviation; a cell has a width, too."""
    mean = float(share @ values)
    scale = math.sqrt(float(share @ (values - mean) ** 2) + cell**2 / 12)
    return (values - mean) / scale, mean, scale


def _covariance(matrix: Float64Array, cells: _Cells, noise: _DepthNoise, averaged_frames: int) -> Float64Array:
    """Return the covariance of a, b, c from the noise of a camera; only what changes between frames is averaged."""
    scaled = matrix * (cells.inverse_m ** (2 - noise.power) / noise.distance_m**noise.power)
    white = (scaled * (noise.white_m**2 / cells.count)) @ scaled.T
    grid = np.zeros((len(scaled), cells.rows, cells.columns))
    grid.reshape(len(scaled), -1)[:, cells.place] = scaled
    along, across = (_shared_by_cells(noise.length_px, cells.size_px, n) for n in (cells.rows, cells.columns))
    shared = noise.shared_m**2 * np.einsum("aij,bij->ab", along @ grid @ across, grid)
    fixed = noise.fixed_share * shared
    return np.asarray((white + shared - fixed) / averaged_frames + fixed)


@lru_cache(maxsize=256)
def _shared_by_cells(length_px: float, size_px: float, count: int) -> Float64Array:
    """Return the covariances of the means over ``count`` intervals side by side, shape (count, count).

    The process has the covariance exp(-d^2 / (4 length_px^2)). Twice integrated, it gives the covariance of two means.
    """
    if length_px <= 0:
        return np.zeros((count, count))
    distance = np.arange(-1, count + 1) * (size_px / (2 * length_px))
    twice = math.sqrt(math.pi) / 2 * distance * erf(distance) + np.exp(-(distance**2)) / 2
    means = np.diff(twice, 2) * (2 * length_px / size_px) ** 2
    steps = np.arange(count)
    return np.asarray(means[np.abs(steps[:, None] - steps)])


def _angles(plane: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return roll and pitch of the plane 1 / z = a + b x / z + c y / z, radians, and their Jacobian, shape (2, 3)."""
    a, b, c = plane
    flat, all_ = math.hypot(a, b), float(plane @ plane)
    angles = np.array([math.atan2(-c, flat), math.atan2(b, a)])
    jacobian = np.array(
        [[c * a / (flat * all_), c * b / (flat * all_), -flat / all_], [-b / flat**2, a / flat**2, 0.0]]
    )
    return angles, jacobian


def _long_axis(cells: _Cells, lens: Intrinsics) -> tuple[float | None, float | None]:
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
