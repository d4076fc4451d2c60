"""The delay between both cameras, measured from a motion that both of them see.

Time stamps state when the driver believes an image was taken. Here the delay is measured: the indentation by an object
is correlated between both cameras over a range of delays, and the peak is refined by a parabola.

Both cameras see different surfaces until they touch: the proximity camera the object, the tactile camera the membrane.
They share the depth of the indentation. For the tactile camera it is the distance of the membrane from its rest
position; for the proximity camera, the distance of the object behind that rest position, or 0 before it. The rest
position is the farthest depth that the tactile camera has seen at each pixel, so no untouched frame is needed.

The cameras average over different places and one of them drifts, so their scales may differ. The change of the tactile
depth over 0.1 s is therefore predicted by a piecewise linear function of the proximity depth, and the coefficient of
multiple correlation of the best function is used. With a wrong delay, the tactile depth differs between pressing and
releasing at the same proximity depth (a loop), so no function fits.

The uncertainty is the delete-a-group jackknife over stretches of time. No delay is returned if there is too little
motion, if both series disagree, or if several delays fit almost equally well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from ..contact.alignment import make_alignment, tactile_homography
from ..contact.kernels.chain import Region
from ..errors import FrameError, TactuneError, counted, minus
from ..model.arrays import AnyArray, Float32Array, Float64Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..model.robust import spread
from ..preset import AlignmentSection
from ..sources.base import Progress

#: Largest delay that is searched, seconds.
MAX_DELAY_S = 0.75
#: Shortest time and smallest motion for a measurement.
MIN_TIME_S = 2.0
MIN_MOTION_M = 0.004
#: Longest gap between two frames that is interpolated, seconds.
MAX_GAP_S = 0.25
_MIN_NOISE_RATIO = 5.0
_MIN_CORRELATION = 0.8
#: The result is ambiguous if another delay leaves less than this many times the unexplained variance.
_AMBIGUOUS_RATIO = 3.0
_MAX_UNCERTAINTY_S = 0.015

_DELAY_STEP_S = 0.002
_GRID_STEP_S = 0.01
#: Depth changes over this time are compared, which suppresses slow drift, seconds.
_CHANGE_OVER_S = 0.1
_KNOTS = 14
#: Largest distance of a jackknife peak from that of the whole series, seconds.
_REACH_S = 0.06
#: Share of the time, and of the variance, that must remain in the overlap of both series.
_MIN_OVERLAP = 0.5
_MIN_VARIANCE = 0.25
_GROUPS = 10
#: Uncertainty of interpolation between frames, added to the jackknife, seconds.
_INTERPOLATION_S = 0.001
_MIN_SAMPLES = 20
_MIN_STRETCH = 6
#: Images are subsampled by this factor, which keeps 10 s below 50 MB.
STEP = 4
_REST_SHARE = 0.95
#: Pixels with at least this share of the largest indentation belong to the object.
_CORE_SHARE = 0.5
_DEEPEST_SHARE = 0.98
_SEEN_SHARE = 0.8
_TRIMMED_SHARE = 0.05
_MIN_PIXELS = 20


class SkewError(TactuneError):
    """The delay cannot be measured; the message says why and what to do."""


@dataclass(frozen=True, eq=False)
class Skew:
    """The delay between both cameras.

    Attributes
    ----------
    delay_s : float
        Tactile minus proximity time stamp for the same moment, seconds. Subtract it from the tactile time stamps:
        preset field ``cameras.tactile_delay_s``.
    uncertainty_s : float
        95 % uncertainty, seconds.
    correlation : float
        Multiple correlation at the peak, 0 to 1.
    delays_s, correlations : float64, shape (K,)
        The correlation curve; nan where both series overlap too little.
    proximity, tactile : MotionSeries
        The compared series.
    """

    delay_s: float
    uncertainty_s: float
    correlation: float
    delays_s: Float64Array
    correlations: Float64Array
    proximity: MotionSeries
    tactile: MotionSeries

    @property
    def agrees(self) -> bool:
        """Whether the delay is 0 within its uncertainty."""
        return abs(self.delay_s) <= self.uncertainty_s

    @property
    def significant(self) -> bool:
        """Whether the delay is so far from 0 that compensating it helps: more than twice its uncertainty."""
        return abs(self.delay_s) > 2 * self.uncertainty_s

    @property
    def sentence(self) -> str:
        """The result in words."""
        about = f"± {max(1e3 * self.uncertainty_s, 0.1):.1f} ms"
        if self.agrees:
            delay = minus(f"{1e3 * self.delay_s:+.1f}")
            return f"Both cameras' time stamps agree within the uncertainty: {delay} {about}."
        later = "later" if self.delay_s > 0 else "earlier"
        doubt = "" if self.significant else " This is too uncertain to compensate: measure again for longer."
        return (
            f"The tactile camera's time stamps are {1e3 * abs(self.delay_s):.1f} {about} {later} "
            f"than the proximity camera's for the same moment.{doubt}"
        )


def measure_skew(
    samples: Sequence[Sample], rig: Rig, section: AlignmentSection, progress: Progress | None = None
) -> Skew:
    """Measure the delay from a few seconds in which an object is pressed in and released.

    Parameters
    ----------
    samples : sequence of Sample
        In the order of arrival; a recording may have restarted in between.
    rig : Rig
    section : AlignmentSection
        The preset's alignment.
    progress : callable, optional

    Raises
    ------
    SkewError
        The series is too short, moves too little, does not agree or is ambiguous; the message says what to do.
    RigMismatchError, FrameError
        See `pressed_depths`.
    """
    if len(samples) < _MIN_SAMPLES:
        raise SkewError(
            f"only {counted(len(samples), 'frame')} came; record at least {MIN_TIME_S:g} s in which something moves"
        )
    proximity, tactile = pressed_depths(samples, rig, section, progress)
    return find_delay(proximity, tactile)


def find_delay(proximity: MotionSeries, tactile: MotionSeries) -> Skew:
    """Find the delay of the tactile series against the proximity series.

    Parameters
    ----------
    proximity, tactile : MotionSeries
        Series of the same frames.

    Raises
    ------
    SkewError
        See `measure_skew`.
    """
    _check_motion("proximity", proximity)
    _check_motion("tactile", tactile)
    steps = round(MAX_DELAY_S / _DELAY_STEP_S)
    delays: Float64Array = _DELAY_STEP_S * np.arange(-steps, steps + 1, dtype=np.float64)
    regressors, shifted = _resample(proximity, tactile, delays)
    curve = _correlate(regressors, shifted)
    best = _check_peak(delays, curve)
    delay = _refine(delays, curve, best)
    uncertainty = _jackknife(regressors, shifted, delays, best)
    if uncertainty > _MAX_UNCERTAINTY_S:
        raise SkewError(
            f"the delay is uncertain by {1e3 * uncertainty:.0f} ms; move longer, faster and irregularly, "
            "and measure again"
        )
    return Skew(delay, uncertainty, float(curve[best]), delays, curve, proximity, tactile)


def _check_motion(camera: str, series: MotionSeries) -> None:
    """Raise if a series has too little motion."""
    way, needed = series.way_m, max(MIN_MOTION_M, _MIN_NOISE_RATIO * series.noise_m)
    if not way >= needed:
        raise SkewError(
            f"the {camera} camera sees too little motion, {1e3 * way:.1f} mm where {1e3 * needed:.0f} mm are needed; "
            "press an object into the membrane and pull it out, several times and irregularly"
        )


def _resample(
    proximity: MotionSeries, tactile: MotionSeries, delays: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return regressors from the proximity depth on a fine time grid, and tactile depth changes at each delay.

    Depths are interpolated by splines, nan outside. Gaps and clock jumps are not bridged.

    Returns
    -------
    regressors : float64, shape (M, R)
        A constant, and the changes of hat functions of the proximity depth.
    shifted : float64, shape (K, M)
        Change of the tactile depth at each delay, relative to its range.
    """
    depth, shifted = [], []
    half = _CHANGE_OVER_S / 2
    for stretch in _stretches(proximity, tactile):
        near, far = _spline(proximity, stretch), _spline(tactile, stretch)
        if near is None or far is None:
            continue
        grid = np.arange(near.x[0] + half, near.x[-1] - half, _GRID_STEP_S)
        later = grid[None, :] + delays[:, None]
        depth.append(np.stack([near(grid - half), near(grid + half)]))
        shifted.append((far(later + half) - far(later - half)) / tactile.way_m)
    if not depth:
        raise SkewError("the time stamps jump too often; check the cameras' clocks and measure again")
    before, after = np.concatenate(depth, axis=1)
    knots = np.linspace(before.min(), before.max(), _KNOTS)
    # the last hat function is redundant: all of them sum to 1
    tents = [np.interp(after, knots, tent) - np.interp(before, knots, tent) for tent in np.eye(_KNOTS)[:-1]]
    return np.column_stack([np.ones_like(before), *tents]), np.concatenate(shifted, axis=1)


def _stretches(proximity: MotionSeries, tactile: MotionSeries) -> list[slice]:
    """Split where time runs backwards (a recording restarts) or a gap is too long."""
    steps = np.stack([np.diff(proximity.time_s), np.diff(tactile.time_s)])
    breaks = np.flatnonzero(((steps <= 0) | (steps > MAX_GAP_S)).any(axis=0)) + 1
    ends = [0, *breaks.tolist(), len(proximity.time_s)]
    return [slice(first, last) for first, last in pairwise(ends)]


def _spline(series: MotionSeries, stretch: slice) -> CubicSpline | None:
    time, depth = series.time_s[stretch], series.depth_m[stretch]
    seen = np.isfinite(depth)
    return CubicSpline(time[seen], depth[seen], extrapolate=False) if seen.sum() >= _MIN_STRETCH else None


def _correlate(regressors: Float64Array, shifted: Float64Array) -> Float64Array:
    """Return the multiple correlation R at each delay; nan where the overlap is too small or nothing moves.

    At each delay y = X b + error by least squares over the n times where both are known, with the normal equations
    (X'X) b = X'y, and R^2 = (y'X b / n - mean(y)^2) / var(y).
    """
    both = np.isfinite(shifted) & np.isfinite(regressors[:, 0])
    number = both.sum(axis=1)
    n = np.maximum(number, 1)
    x = np.nan_to_num(regressors)
    y = np.where(both, shifted, 0.0)
    mean = y.sum(axis=1) / n
    variance = (y * y).sum(axis=1) / n - mean**2
    known = (number >= _MIN_OVERLAP * number.max()) & (variance > _MIN_VARIANCE * variance.max())

    # X'X of all delays is one product: rows of `both` choose the times, columns are the products of two regressors.
    rows, columns = np.triu_indices(x.shape[1])
    squares = np.empty((len(shifted), x.shape[1], x.shape[1]))
    squares[:, rows, columns] = squares[:, columns, rows] = both.astype(np.float64) @ (x[:, rows] * x[:, columns])
    ridge = 1e-9 * n[known, None, None] * np.eye(x.shape[1])
    products = (y @ x)[known]
    fitted = np.linalg.solve(squares[known] + ridge, products[:, :, None])[:, :, 0]
    explained = (products * fitted).sum(axis=1) / n[known] - mean[known] ** 2
    curve: Float64Array = np.full(len(shifted), np.nan)
    curve[known] = np.sqrt(np.clip(explained / variance[known], 0.0, 1.0))
    return curve


def _check_peak(delays: Float64Array, curve: Float64Array) -> int:
    """Return the index of the only clear peak."""
    known = np.flatnonzero(np.isfinite(curve))
    if len(known) < 3:
        raise SkewError("the series of both cameras overlap too little in time; check their clocks and measure again")
    best = int(np.nanargmax(curve))
    if curve[best] < _MIN_CORRELATION:
        raise SkewError(
            f"both cameras do not see the same motion (correlation {curve[best]:.2f}, {_MIN_CORRELATION} is needed); "
            "press one object into the middle of the membrane, and check the alignment"
        )
    if best in (known[0], known[-1]):
        raise SkewError(
            f"no peak lies within ±{1e3 * MAX_DELAY_S:.0f} ms; check that both cameras use global time, "
            "and measure again"
        )
    other = _other_peak(curve, best)
    if other is not None:
        raise SkewError(
            f"delays of {1e3 * delays[best]:.0f} ms and {1e3 * delays[other]:.0f} ms fit almost equally well, because "
            "the motion repeats or goes one way only; press in and pull out irregularly and measure again"
        )
    return best


def _other_peak(curve: Float64Array, best: int) -> int | None:
    """Return the highest other peak if it explains almost as much variance."""
    inner = curve[1:-1]
    tops = np.flatnonzero((inner > curve[:-2]) & (inner >= curve[2:])) + 1
    tops = tops[np.abs(tops - best) * _DELAY_STEP_S > _REACH_S]
    if len(tops) == 0:
        return None
    highest = int(tops[np.argmax(curve[tops])])
    unexplained = (1.0 - curve[highest] ** 2) / max(1.0 - curve[best] ** 2, 1e-9)
    return highest if unexplained <= _AMBIGUOUS_RATIO else None


def _refine(delays: Float64Array, curve: Float64Array, best: int) -> float:
    """Return the vertex of the parabola through the highest value and its neighbours."""
    before, top, after = curve[best - 1 : best + 2]
    bend = before - 2 * top + after
    return float(delays[best] + (0.5 * (before - after) / bend * _DELAY_STEP_S if bend < 0 else 0.0))


def _jackknife(regressors: Float64Array, shifted: Float64Array, delays: Float64Array, best: int) -> float:
    """Return the 95 % uncertainty of the delay by the delete-a-group jackknife over tenths of the time.

    ``var = (G - 1) / G * sum (d_g - mean d)^2`` over G groups (Efron, The Jackknife, the Bootstrap and Other
    Resampling Plans, 1982, ch. 3, applied to blocks because neighbouring values are correlated).
    """
    reach = round(_REACH_S / _DELAY_STEP_S)
    first, last = max(best - reach, 0), min(best + reach + 1, len(delays))
    estimates = []
    for group in np.array_split(np.arange(len(regressors)), _GROUPS):
        left_out = regressors.copy()
        left_out[group] = np.nan
        curve = _correlate(left_out, shifted[first:last])
        top = int(np.nanargmax(curve))
        inner = 0 < top < len(curve) - 1
        estimates.append(_refine(delays[first:last], curve, top) if inner else delays[first + top])
    deviations = np.asarray(estimates) - np.mean(estimates)
    jackknife = 2.0 * float(np.sqrt((_GROUPS - 1) / _GROUPS * np.sum(deviations**2)))
    return float(np.hypot(jackknife, _INTERPOLATION_S))


@dataclass(frozen=True, eq=False)
class Sample:
    """One subsampled frame; depth is uint16 (ceil(H / STEP), ceil(W / STEP)), raw counts."""

    proximity_time_s: float
    tactile_time_s: float
    proximity_depth: Uint16Array
    tactile_depth: Uint16Array

    @classmethod
    def of(cls, frame: SensorFrame) -> Sample:
        """Subsample a frame."""
        return cls(
            frame.proximity_time_s,
            frame.tactile_time_s,
            frame.proximity_depth[::STEP, ::STEP].copy(),
            frame.tactile_depth[::STEP, ::STEP].copy(),
        )


@dataclass(frozen=True, eq=False)
class MotionSeries:
    """Indentation over time, as one camera sees it.

    Attributes
    ----------
    time_s : float64, shape (N,)
    depth_m : float64, shape (N,)
        Mean over the pixels that the object pushes, metres; nan if none of them has depth.
    noise_m : float
        Frame-to-frame noise of ``depth_m``, metres.
    """

    time_s: Float64Array
    depth_m: Float64Array
    noise_m: float

    @property
    def way_m(self) -> float:
        """Range of the motion: 5 % to 95 % quantile, metres."""
        low, high = np.nanpercentile(self.depth_m, (5.0, 95.0))
        return float(high - low)


def pressed_depths(
    samples: Sequence[Sample], rig: Rig, section: AlignmentSection, progress: Progress | None = None
) -> tuple[MotionSeries, MotionSeries]:
    """Return the indentation as the proximity and as the tactile camera see it.

    Parameters
    ----------
    samples : sequence of Sample
        In the order of arrival.
    rig : Rig
    section : AlignmentSection
        The preset's alignment, which relates the pixels of both cameras.
    progress : callable, optional

    Raises
    ------
    RigMismatchError
        Neither preset nor rig knows how the cameras stand to each other.
    FrameError
        A camera sees too little depth.
    """
    unit = rig.tactile.depth_unit_m
    tactile = np.stack([sample.tactile_depth for sample in samples])
    seen = valid_depth(tactile)
    often = seen.mean(axis=0) >= _SEEN_SHARE
    if often.sum() < _MIN_PIXELS:
        raise FrameError("the tactile camera sees almost no depth; check its light and its distance")
    rest = np.where(often, _high(np.where(seen, tactile, np.uint16(0)), _REST_SHARE), np.uint16(0))
    membrane = np.where(seen & often, rest.astype(np.float32) - tactile, np.float32(np.nan)) * np.float32(unit)
    object_ = np.empty((len(samples), *samples[0].proximity_depth.shape), np.float32)
    coarse = make_alignment(_coarse_section(section, rig), _coarse_rig(rig))
    everywhere = Region(0, 0, object_.shape[2], object_.shape[1])
    for index, sample in enumerate(samples):
        aligned = coarse.align(sample.proximity_depth, rest, everywhere)
        object_[index] = np.maximum(aligned.measured_m - aligned.expected_m, np.float32(0.0))
        if progress is not None:
            progress(index / len(samples), "Following the motion in both cameras")
    times = np.array([[sample.proximity_time_s, sample.tactile_time_s] for sample in samples])
    return _series(times[:, 0], object_, "proximity"), _series(times[:, 1], membrane, "tactile")


def _series(time_s: Float64Array, depth_m: Float32Array, camera: str) -> MotionSeries:
    """Average over the pixels with the largest indentation."""
    flat = depth_m.reshape(len(depth_m), -1)
    flat = flat[:, np.isfinite(flat).mean(axis=0) >= _SEEN_SHARE]
    if flat.shape[1] < _MIN_PIXELS:
        raise FrameError(f"the {camera} camera sees almost no depth where the membrane is; check the alignment")
    deepest = _high(np.where(np.isfinite(flat), flat, np.float32(-np.inf)), _DEEPEST_SHARE)
    core = flat[:, deepest >= _CORE_SHARE * np.percentile(deepest, 99.0)]
    mean = np.array([_trimmed_mean(row[np.isfinite(row)]) for row in core])
    # second differences of a smooth motion are small; those of white noise have 6 times its variance
    bends = mean[2:] - 2 * mean[1:-1] + mean[:-2]
    noise = spread(bends) / np.sqrt(6.0) if len(bends) else 0.0
    return MotionSeries(np.asarray(time_s), mean, noise)


def _trimmed_mean(values: Float32Array) -> float:
    """Return the trimmed mean without 5 % at either end, such as mixed pixels at edges."""
    cut = int(_TRIMMED_SHARE * len(values))
    middle = np.sort(values)[cut : len(values) - cut]
    return float(middle.mean(dtype=np.float64)) if len(middle) else float("nan")


def _high(values: AnyArray, share: float) -> AnyArray:
    """Return the ``share`` quantile over time; missing values are given as the lowest."""
    rank = int(share * (len(values) - 1))
    return np.asarray(np.partition(values, rank, axis=0)[rank])


def _coarse_rig(rig: Rig) -> Rig:
    """Return the rig for subsampled images; pixel centres stay at integers."""
    update = {"proximity": _coarse_camera(rig.proximity), "tactile": _coarse_camera(rig.tactile)}
    return rig.model_copy(update=update)


def _coarse_camera(camera: DepthCamera) -> DepthCamera:
    lens = camera.intrinsics
    coarse = Intrinsics(
        width=-(-lens.width // STEP),
        height=-(-lens.height // STEP),
        fx=lens.fx / STEP,
        fy=lens.fy / STEP,
        cx=lens.cx / STEP,
        cy=lens.cy / STEP,
        distortion=lens.distortion,
        coefficients=lens.coefficients,
    )
    return camera.model_copy(update={"intrinsics": coarse})


def _coarse_section(section: AlignmentSection, rig: Rig) -> AlignmentSection:
    """Return the alignment for subsampled images; only a homography depends on pixels."""
    if section.model != "homography":
        return section
    scale = np.diag([1.0 / STEP, 1.0 / STEP, 1.0])
    H_p_t = scale @ tactile_homography(section, rig) @ np.linalg.inv(scale)
    matrix = tuple(tuple(float(value) for value in row) for row in H_p_t)
    homography = section.homography.model_copy(update={"H_p_t": matrix})
    return section.model_copy(update={"homography": homography})
