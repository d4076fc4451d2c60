"""The delay between both cameras, measured from a motion that both of them see.

Time stamps state when the driver believes an image was taken. Here the delay is measured: both cameras see how deep an
object is pressed in. For the tactile camera it is the distance of the membrane from its rest position; for the
proximity camera, the distance of the object behind that rest position, or 0 before it touches. The rest position is the
farthest depth that the tactile camera has seen at each pixel, so no untouched frame is needed. The scales of both may
differ, and one of them may have a bias: the change of the tactile depth is predicted by a cubic of the proximity depth.
The multiple correlation is computed over a range of delays, and its peak is refined by a parabola.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from ..contact.alignment import make_alignment
from ..contact.kernels.chain import Region
from ..errors import FrameError, counted, minus
from ..model.arrays import Float32Array, Float64Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import Rig, SensorFrame
from ..preset import AlignmentSection
from ..sources.base import Progress

#: Largest delay that is searched, shortest measurement and longest gap between frames, seconds; smallest motion.
MAX_DELAY_S, MIN_TIME_S, MAX_GAP_S, MIN_MOTION_M = 0.75, 2.0, 0.25, 0.004
_MIN_SAMPLES: Final = 20
#: Smallest correlation. The result is ambiguous if another peak, so far from the first, leaves less than a factor of
#: its unexplained variance.
_MIN_CORRELATION, _AMBIGUOUS_RATIO, _REACH_S = 0.8, 3.0, 0.06
#: Steps of the delay and of the time, seconds; share of the time in which both series must overlap; jackknife groups.
_STEP_S, _GRID_S, _MIN_OVERLAP, _GROUPS = 0.002, 0.01, 0.5, 10
#: Depths are compared over this time, which suppresses slow drift, seconds.
_CHANGE_OVER_S: Final = 0.1
_MAX_UNCERTAINTY_S: Final = 0.015
#: Images are subsampled by this factor, which keeps 10 s below 50 MB.
STEP: Final = 4
#: Quantile over time of a pixel's depth at rest, and of its deepest indentation; share of the deepest indentation from
#: which on a pixel belongs to the object; share of the frames in which a pixel needs a depth; fewest pixels.
_REST, _DEEPEST, _CORE, _SEEN, _MIN_PIXELS = 95, 98, 0.5, 0.8, 20

#: Times, seconds, and how deep the object is pressed in, metres, as one camera sees it.
_Series = tuple[Float64Array, Float64Array]


@dataclass(frozen=True, eq=False)
class Sample:
    """One frame; depth is uint16 (ceil(H / STEP), ceil(W / STEP)), raw counts."""

    proximity_time_s: float
    tactile_time_s: float
    proximity_depth: Uint16Array
    tactile_depth: Uint16Array

    @classmethod
    def of(cls, frame: SensorFrame) -> Sample:
        depths = (depth[::STEP, ::STEP].copy() for depth in (frame.proximity_depth, frame.tactile_depth))
        return cls(frame.proximity_time_s, frame.tactile_time_s, *depths)


@dataclass(frozen=True)
class Skew:
    """``cameras.tactile_delay_s``: tactile minus proximity stamp of one moment, and its 95 % uncertainty, s."""

    delay_s: float
    uncertainty_s: float

    @property
    def significant(self) -> bool:
        """Whether the delay is so far from 0 that compensating it helps: more than twice its uncertainty."""
        return abs(self.delay_s) > 2 * self.uncertainty_s

    @property
    def sentence(self) -> str:
        delay = minus(f"{1e3 * self.delay_s:+.1f}") + f" ± {1e3 * self.uncertainty_s:.1f} ms"
        doubt = "" if self.significant else ", too little to compensate"
        return f"Time stamps for the same moment, tactile minus proximity: {delay}{doubt}."


def measure_skew(
    samples: Sequence[Sample], rig: Rig, section: AlignmentSection, progress: Progress | None = None
) -> Skew:
    """Measure the delay from a few seconds of samples, by their stamps, of an object pressed in and released."""
    if len(samples) < _MIN_SAMPLES:
        raise FrameError(
            f"only {counted(len(samples), 'frame')} came; record at least {MIN_TIME_S:g} s in which something moves"
        )
    proximity, tactile = _pressed_depths(samples, rig, section, progress)
    for camera, (_, depth_m) in (("proximity", proximity), ("tactile", tactile)):
        low_m, high_m = np.percentile(depth_m, (5, 95))
        if high_m - low_m < MIN_MOTION_M:
            raise FrameError(
                f"the {camera} camera sees too little motion, {1e3 * (high_m - low_m):.1f} mm where "
                f"{1e3 * MIN_MOTION_M:.0f} mm are needed; press an object into the membrane and pull it out, several "
                "times and irregularly"
            )
    delays_s, near, far = _resampled(proximity, tactile)
    curve = _correlations(near, far)
    best, reach = int(np.argmax(curve)), round(_REACH_S / _STEP_S)
    if curve[best] < _MIN_CORRELATION or not reach <= best < len(curve) - reach:
        raise FrameError(
            f"both cameras do not see the same motion within ±{1e3 * MAX_DELAY_S:.0f} ms (correlation "
            f"{curve[best]:.2f}, {_MIN_CORRELATION} is needed); press one object into the middle of the membrane, and "
            "check the alignment"
        )
    inner = curve[1:-1]
    tops = np.flatnonzero((inner > curve[:-2]) & (inner >= curve[2:])) + 1
    for other in tops[np.abs(tops - best) > reach]:
        if 1 - curve[other] ** 2 <= _AMBIGUOUS_RATIO * (1 - curve[best] ** 2):
            raise FrameError(
                f"delays of {1e3 * delays_s[best]:.0f} ms and {1e3 * delays_s[other]:.0f} ms fit almost equally well, "
                "because the motion repeats; press in and pull out irregularly and measure again"
            )
    # Delete-a-group jackknife over tenths of the time (Efron 1982, ch. 3), since neighbouring values are correlated.
    around = slice(best - reach, best + reach + 1)
    estimates = [
        _peak(delays_s[around], _correlations(np.delete(near, group, axis=0), np.delete(far[around], group, axis=1)))
        for group in np.array_split(np.arange(len(near)), _GROUPS)
    ]
    uncertainty_s = float(np.hypot(2 * np.sqrt(_GROUPS - 1) * np.std(estimates), 0.001))  # 1 ms of interpolation
    if uncertainty_s > _MAX_UNCERTAINTY_S:
        raise FrameError(
            f"the delay is uncertain by {1e3 * uncertainty_s:.0f} ms; move longer, faster and irregularly, "
            "and measure again"
        )
    return Skew(_peak(delays_s, curve), uncertainty_s)


def _resampled(proximity: _Series, tactile: _Series) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return delays (K,), and on M times changes of the proximity depth's powers (M, 4) and of the tactile's (K, M)."""
    reach = round(MAX_DELAY_S / _STEP_S)
    delays_s: Float64Array = np.arange(-reach, reach + 1, dtype=np.float64) * _STEP_S
    half = _CHANGE_OVER_S / 2
    near, far = (
        CubicSpline(time_s, depth_m / np.max(depth_m), extrapolate=False) for time_s, depth_m in (proximity, tactile)
    )
    grid = np.arange(proximity[0][0] + half, proximity[0][-1] - half, _GRID_S)
    later = grid + delays_s[:, None]
    powers = [near(grid + half) ** power - near(grid - half) ** power for power in (1, 2, 3)]
    return delays_s, np.column_stack([np.ones_like(grid), *powers]), far(later + half) - far(later - half)


def _correlations(near: Float64Array, far: Float64Array) -> Float64Array:
    """Return the multiple correlation of `_resampled` changes at each delay; 0 without enough overlap."""
    curve = np.zeros(len(far))
    for number, change in enumerate(far):
        both = np.isfinite(change)
        if both.sum() > _MIN_OVERLAP * len(change):
            wanted = change[both] - change[both].mean()
            left = wanted - near[both] @ np.linalg.lstsq(near[both], wanted, rcond=None)[0]
            curve[number] = np.sqrt(max(1 - left @ left / max(wanted @ wanted, 1e-18), 0.0))
    return curve


def _peak(delays_s: Float64Array, curve: Float64Array) -> float:
    """Return the vertex of the parabola through the largest value and its neighbours."""
    best = int(np.clip(np.argmax(curve), 1, len(curve) - 2))
    before, top, after = curve[best - 1 : best + 2]
    bend = before - 2 * top + after
    return float(delays_s[best] + (0.5 * (before - after) / bend * _STEP_S if bend < 0 else 0.0))


def _pressed_depths(
    samples: Sequence[Sample], rig: Rig, section: AlignmentSection, progress: Progress | None
) -> tuple[_Series, _Series]:
    """Return the indentation as the proximity and as the tactile camera see it."""
    tactile = np.stack([sample.tactile_depth for sample in samples])
    seen = valid_depth(tactile)
    often = seen.mean(axis=0) >= _SEEN
    if often.sum() < _MIN_PIXELS:
        raise FrameError("the tactile camera sees almost no depth; check its light and its distance")
    rest = np.where(often, np.percentile(np.where(seen, tactile, 0), _REST, axis=0, method="lower"), 0)
    unit_m = np.float32(rig.tactile.depth_unit_m)
    membrane = np.where(seen & often, rest.astype(np.float32) - tactile, np.float32(np.nan)) * unit_m
    # The images are put back to full size with depth at every STEP-th pixel only, so rig and alignment hold.
    object_ = np.empty((len(samples), *samples[0].proximity_depth.shape), np.float32)
    near, far = (np.zeros(camera.intrinsics.shape, np.uint16) for camera in (rig.proximity, rig.tactile))
    far[:] = np.repeat(np.repeat(rest, STEP, axis=0), STEP, axis=1)[: far.shape[0], : far.shape[1]]
    alignment = make_alignment(section, rig)
    whole = Region(0, 0, near.shape[1], near.shape[0])
    for index, sample in enumerate(samples):
        near[::STEP, ::STEP] = sample.proximity_depth
        aligned = alignment.align(near, far, whole)
        behind_m = (aligned.measured_m - aligned.expected_m)[::STEP, ::STEP]
        object_[index] = np.maximum(behind_m, np.float32(0.0))
        if progress is not None:
            progress(index / len(samples), "Following the motion in both cameras")
    times = np.array([[sample.proximity_time_s, sample.tactile_time_s] for sample in samples])
    return _series(times[:, 0], object_, "proximity"), _series(times[:, 1], membrane, "tactile")


def _series(time_s: Float64Array, depth_m: Float32Array, camera: str) -> _Series:
    """Return the mean over the pixels with the largest indentation; frames without depth are left out."""
    flat = depth_m.reshape(len(depth_m), -1)
    flat = flat[:, np.isfinite(flat).mean(axis=0) >= _SEEN]
    if flat.shape[1] < _MIN_PIXELS:
        raise FrameError(f"the {camera} camera sees almost no depth where the membrane is; check the alignment")
    deepest = np.percentile(np.nan_to_num(flat), _DEEPEST, axis=0, method="lower")
    core = flat[:, deepest >= _CORE * np.percentile(deepest, 99.0)]
    known = np.isfinite(core).any(axis=1)
    known &= time_s > np.append(-np.inf, np.fmax.accumulate(time_s)[:-1])  # a spline needs increasing times
    if known.sum() < _MIN_SAMPLES:
        raise FrameError(f"the {camera} camera gave only {counted(int(known.sum()), 'time stamp')}; record longer")
    return time_s[known], np.nanmean(core[known], axis=1, dtype=np.float64)
