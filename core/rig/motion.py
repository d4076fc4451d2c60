"""How far an object is pressed in, as each camera sees it by itself: two series over time that can be compared.

Both cameras look at different surfaces until they touch: the proximity camera at the object, the tactile camera at
the membrane. What both see alike is the depth by which the object has pushed the membrane in. For the tactile
camera that is how far the membrane has come from where it rests; for the proximity camera it is how far the object
has come past the place where the membrane rests, and nothing before that. The resting membrane is the farthest
that the tactile camera has seen each pixel, so no frame of the untouched membrane is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..contact.alignment import make_alignment, tactile_homography
from ..contact.kernels.chain import Region
from ..errors import FrameError
from ..model.arrays import AnyArray, Float32Array, Float64Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..preset import AlignmentSection
from ..sources.base import Progress

#: Every n-th pixel in both directions is enough for a mean, and keeps ten seconds below 50 MB.
STEP = 4
_REST_SHARE = 0.95
#: Pixels that come at least this share of the deepest way belong to the object.
_CORE_SHARE = 0.5
_DEEPEST_SHARE = 0.98
_SEEN_SHARE = 0.8
_TRIMMED_SHARE = 0.05
_LEAST_PIXELS = 20


@dataclass(frozen=True, eq=False)
class Sample:
    """One frame, thinned out; ``depth`` is uint16 (ceil(H / STEP), ceil(W / STEP)), raw counts."""

    proximity_time_s: float
    tactile_time_s: float
    proximity_depth: Uint16Array
    tactile_depth: Uint16Array

    @classmethod
    def of(cls, frame: SensorFrame) -> Sample:
        """Keep what is needed of a frame."""
        return cls(
            frame.proximity_time_s,
            frame.tactile_time_s,
            frame.proximity_depth[::STEP, ::STEP].copy(),
            frame.tactile_depth[::STEP, ::STEP].copy(),
        )


@dataclass(frozen=True, eq=False)
class MotionSeries:
    """How far something was pressed in over time, as one camera sees it.

    Attributes
    ----------
    time_s : float64, shape (N,)
    depth_m : float64, shape (N,)
        Mean over the pixels that the object pushes; nan where none of them was seen.
    noise_m : float
        Of ``depth_m`` from frame to frame.
    """

    time_s: Float64Array
    depth_m: Float64Array
    noise_m: float

    @property
    def way_m(self) -> float:
        """How far the motion goes: the range of the middle 90 % of the values, metres."""
        low, high = np.nanpercentile(self.depth_m, (5.0, 95.0))
        return float(high - low)


def pressed_depths(
    samples: Sequence[Sample], rig: Rig, section: AlignmentSection, progress: Progress | None = None
) -> tuple[MotionSeries, MotionSeries]:
    """Return how far the object is pressed in, as the proximity and as the tactile camera see it.

    Parameters
    ----------
    samples : sequence of Sample
        In the order in which they came.
    rig : Rig
    section : AlignmentSection
        The preset's; it tells which pixels of both cameras see the same place.
    progress : callable, optional

    Raises
    ------
    RigMismatchError
        Neither preset nor rig knows how the cameras stand to each other.
    FrameError
        A camera sees no depth.
    """
    unit = rig.tactile.depth_unit_m
    tactile = np.stack([sample.tactile_depth for sample in samples])
    seen = valid_depth(tactile)
    often = seen.mean(axis=0) >= _SEEN_SHARE
    if often.sum() < _LEAST_PIXELS:
        raise FrameError("the tactile camera sees hardly any depth; check its light and its distance")
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
    """Average over the pixels that the object pushes farthest."""
    flat = depth_m.reshape(len(depth_m), -1)
    flat = flat[:, np.isfinite(flat).mean(axis=0) >= _SEEN_SHARE]
    if flat.shape[1] < _LEAST_PIXELS:
        raise FrameError(f"the {camera} camera sees hardly any depth where the membrane is; check the alignment")
    deepest = _high(np.where(np.isfinite(flat), flat, np.float32(-np.inf)), _DEEPEST_SHARE)
    core = flat[:, deepest >= _CORE_SHARE * np.percentile(deepest, 99.0)]
    mean = np.array([_trimmed_mean(row[np.isfinite(row)]) for row in core])
    # Second differences of a smooth motion are small; those of white noise have six times its variance.
    bends = mean[2:] - 2 * mean[1:-1] + mean[:-2]
    noise = 1.4826 * float(np.nanmedian(np.abs(bends))) / np.sqrt(6.0) if len(bends) else 0.0
    return MotionSeries(np.asarray(time_s), mean, noise)


def _trimmed_mean(values: Float32Array) -> float:
    """Return the mean without the outer 5 %: pixels that mix two depths at an edge are far off."""
    cut = int(_TRIMMED_SHARE * len(values))
    middle = np.sort(values)[cut : len(values) - cut]
    return float(middle.mean(dtype=np.float64)) if len(middle) else float("nan")


def _high(values: AnyArray, share: float) -> AnyArray:
    """Return what ``share`` of the values over time do not exceed; missing ones stand at the low end."""
    rank = int(share * (len(values) - 1))
    return np.asarray(np.partition(values, rank, axis=0)[rank])


def _coarse_rig(rig: Rig) -> Rig:
    """Return the rig as it is for every n-th pixel, whose centres stay at integers."""
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
    """Return the alignment for every n-th pixel; only a homography is in pixels."""
    if section.model != "homography":
        return section
    scale = np.diag([1.0 / STEP, 1.0 / STEP, 1.0])
    H_p_t = scale @ tactile_homography(section, rig) @ np.linalg.inv(scale)
    matrix = tuple(tuple(float(value) for value in row) for row in H_p_t)
    homography = section.homography.model_copy(update={"H_p_t": matrix})
    return section.model_copy(update={"homography": homography})
