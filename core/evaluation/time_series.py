"""Area, points, time and IoU of every frame of a recording, over time: first coarsely, then every frame."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields

import numpy as np

from ..contact.pipeline import ContactPatch, ContactPipeline
from ..errors import FrameError, SourceError
from ..model.arrays import BoolArray, Float64Array
from ..model.frames import SensorFrame
from ..preset import Preset
from ..sources.base import FrameSource
from .metrics import pixel_scores

#: The first pass takes at most about this many frames of a recording.
_FIRST_PASS = 100


@dataclass(frozen=True)
class FrameValues:
    """What the time strip shows of one frame; nan where it is unknown.

    Attributes
    ----------
    index : int
        Of the frame in its source, from 0.
    time_s : float
        The proximity camera's time stamp, seconds.
    area_mm2 : float
        Area of the patch, as `ContactPatch.area_mm2`.
    points : float
        Points of the patch.
    ms : float
        Time of all steps of the contact test, milliseconds.
    iou : float
        With the true contact pixels, as `PixelScores.iou`; nan if the source has no ground truth.
    """

    index: int
    time_s: float = math.nan
    area_mm2: float = math.nan
    points: float = math.nan
    ms: float = math.nan
    iou: float = math.nan


def frame_values(index: int, frame: SensorFrame, patch: ContactPatch) -> FrameValues:
    """Return the values of a processed frame."""
    truth = frame.truth
    return FrameValues(
        index,
        frame.proximity_time_s,
        patch.area_mm2,
        len(patch.points),
        sum(patch.stage_ms.values()),
        pixel_scores(patch.mask, truth.contact).iou if truth is not None else math.nan,
    )


def visiting_order(length: int, preset: Preset) -> list[int]:
    """Return all frames of a recording in the order in which a picture of the whole emerges soonest.

    Every 2^k-th frame comes first, at most `_FIRST_PASS` of them, then those halfway between, and so on. A preset that
    averages over frames must see them in their own order.
    """
    if preset.averaged_frames > 1:
        return list(range(length))
    step = 1 << max(0, math.ceil(math.log2(max(1, length) / _FIRST_PASS)))
    order = list(range(0, length, step))
    while step > 1:
        order += range(step // 2, length, step)
        step //= 2
    return order


def time_series(source: FrameSource, preset: Preset, order: Iterable[int] | None = None) -> Iterator[FrameValues]:
    """Compute the values of frame after frame; to cancel, stop iterating.

    Parameters
    ----------
    source : FrameSource
        A recording; nothing else may read it meanwhile.
    preset : Preset
    order : iterable of int, optional
        The frames; default: all, in `visiting_order`.

    Yields
    ------
    FrameValues
        A frame that cannot be read or processed has nan for all values.

    Raises
    ------
    SourceError
        The source is live.
    RigMismatchError
        Preset and rig do not fit.
    """
    if source.length is None:
        raise SourceError(f"{source.name} is live, so it has no frame to return to; record it first")
    pipeline = ContactPipeline(preset, source.rig)
    for index in visiting_order(source.length, preset) if order is None else order:
        try:
            if source.position != index:
                source.seek(index)
            frame = source.next_frame()
            if frame is not None:
                yield frame_values(index, frame, pipeline.process(frame))
                continue
        except (SourceError, FrameError):
            pass
        yield FrameValues(index)


class Series:
    """The values of a recording's frames as far as they are known.

    Attributes
    ----------
    values : dict of str to float64, shape (N,)
        Per field of `FrameValues` but ``index``; nan where unknown.
    computed : bool, shape (N,)
        Which frames were computed.
    """

    def __init__(self, length: int, frame_rate_hz: float) -> None:
        self.values: dict[str, Float64Array] = {
            field.name: np.full(length, math.nan) for field in fields(FrameValues) if field.name != "index"
        }
        self.computed: BoolArray = np.zeros(length, np.bool_)
        self._rate_hz = frame_rate_hz

    def __len__(self) -> int:
        return len(self.computed)

    @property
    def complete(self) -> bool:
        """Whether every frame was computed."""
        return bool(self.computed.all())

    def put(self, found: FrameValues) -> None:
        """Store the values of a frame."""
        self.computed[found.index] = True
        for name, column in self.values.items():
            column[found.index] = getattr(found, name)

    def seconds(self) -> Float64Array:
        """Return the time of each frame since the first one, seconds, increasing, shape (N,).

        From the time stamps, between known ones interpolated and beyond them by the frame rate; by the frame rate
        alone where the stamps do not increase.
        """
        nominal = np.arange(len(self)) / self._rate_hz
        stamps = self.values["time_s"]
        known = np.flatnonzero(np.isfinite(stamps))
        times = stamps[known]
        if len(known) == 0 or np.any(np.diff(times) <= 0):
            return nominal
        late_s = np.interp(nominal, nominal[known], times - nominal[known])
        seconds = nominal + late_s
        return np.asarray(seconds - seconds[0])
