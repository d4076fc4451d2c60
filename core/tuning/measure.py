"""Measures a batch of trials over all clips, on one thread of a worker.

The outer loop is over frames, the inner loop over trials. Each frame is therefore read once for all trials, and
consecutive trials share the results of their common steps. A worker keeps its sources open.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from statistics import fmean, median
from typing import Any, Final

import cv2
import numpy as np
from scipy.spatial import cKDTree

from ..contact.kernels.threads import get_threads, set_threads
from ..contact.pipeline import ContactPipeline
from ..contact.warmup import warm_up
from ..errors import TactuneError
from ..evaluation.metrics import pixel_scores, truth_cloud
from ..evaluation.table_cell import code_version
from ..model.arrays import BoolArray, Float32Array
from ..model.clouds import pixel_areas_m2
from ..model.frames import Rig, SensorFrame
from ..model.patch import ContactPatch
from ..preset import Preset
from ..sources.registry import open_source
from .clips import Clip, add_frame, frames_identity, read_frames
from .space import STAGE_OF, TuneError


@dataclass(frozen=True)
class Objective:
    """One figure to optimise: its unit, whether larger is better, and whether it needs ground truth."""

    unit: str
    larger: bool
    needs_truth: bool
    meaning: str


#: What a search can optimise. Means over frames, then over sources; the time is the median of all frames.
OBJECTIVES: Final = {
    "rmse": Objective("mm", False, True, "mean symmetric distance between patch and truth"),
    "iou": Objective("", True, True, "intersection over union with the true pixels"),
    "area_error": Objective("mm2", False, True, "mean absolute difference to the true area"),
    "ms": Objective("ms", False, False, "median processor time of a frame on one thread"),
    "area": Objective("mm2", True, False, "mean area of the patch"),
    "stability": Objective("", True, False, "mean IoU of the masks of consecutive frames"),
}

#: Frames on which a trial is timed without shared steps, and runs of each; the least time of a frame counts.
_TIMES: Final = 5
_REPEATS: Final = 3
#: Upper limit of the clips that a worker keeps open.
_MAX_OPEN: Final = 8

_kept: Final = threading.local()


@dataclass(frozen=True)
class Batch:
    """Trials that a worker measures together.

    Attributes
    ----------
    base : Preset
    clips : tuple of Clip
    code : str
        Version of the program's code.
    trials : tuple of dict
        Values of the varying fields of each trial.
    timed : bool
        Whether the time matters.
    """

    base: Preset
    clips: tuple[Clip, ...]
    code: str
    trials: tuple[dict[str, Any], ...]
    timed: bool


@dataclass(frozen=True)
class Measured:
    """What a trial gave.

    Attributes
    ----------
    figures : dict of str to float
        Values of `OBJECTIVES` (the time only if it matters), ``points`` and ``missed`` (frames with true contact in
        which none was found). A figure that is undefined is missing.
    failure : str
        Why the parameters cannot be used; empty if they can.
    """

    figures: dict[str, float]
    failure: str = ""


def measure_batch(batch: Batch) -> list[Measured]:
    """Measure all trials of a batch on one thread, in the order given.

    Raises
    ------
    TactuneError
        This process runs another version of the code than the plan, or its recording has other frames.
    """
    if code_version() != batch.code:
        raise TuneError(
            "a worker runs another version of Tactune than this search; install the same one everywhere, "
            "restart the workers and give the same command again"
        )
    before = get_threads()
    set_threads(1)
    cv2.setNumThreads(1)  # for the whole process: a worker does nothing else
    try:
        return _measure(batch)
    finally:
        set_threads(before)


def _measure(batch: Batch) -> list[Measured]:
    shared = sorted(range(len(batch.trials)), key=lambda at: _early_first(batch.trials[at]))
    runs = [_Run() for _ in batch.trials]
    for clip in batch.clips:
        opened = _OpenClip.of(clip)
        pipelines = _Pipelines(batch.base, opened.source.rig)
        for run in runs:
            run.begin_clip()
        times = -(-_TIMES // len(batch.clips)) if batch.timed else 0
        for number, frame in enumerate(opened.frames()):
            judged = _JudgedFrame(frame, opened.source.rig)
            for at in shared:
                runs[at].judge_frame(pipelines, batch.trials[at], judged)
            due = len(range(number, times, len(clip.frames)))  # a short clip's frames are timed more than once
            for at in due * shared:
                runs[at].time_frame(pipelines, batch.trials[at], frame)
    return [run.measured() for run in runs]


def _early_first(values: dict[str, Any]) -> list[tuple[int, str, str]]:
    return sorted((STAGE_OF.get(path, 0), path, repr(value)) for path, value in values.items())


class _OpenClip:
    """A clip whose source is open."""

    def __init__(self, clip: Clip) -> None:
        self.clip = clip
        self.source = open_source(clip.name)
        self._checked = False

    @staticmethod
    def of(clip: Clip) -> _OpenClip:
        """Return the calling thread's open clip."""
        clips: dict[Clip, _OpenClip] | None = getattr(_kept, "clips", None)
        if clips is None:
            warm_up()  # so that no measured time includes loading code
            clips = _kept.clips = {}
        if clip not in clips:
            while len(clips) >= _MAX_OPEN:
                clips.pop(next(iter(clips))).source.close()
            clips[clip] = _OpenClip(clip)
        return clips[clip]

    def frames(self) -> Iterator[SensorFrame]:
        """Yield the frames; the first time, check that they are those of the plan."""
        digest = None if self._checked else frames_identity(self.source.rig)
        for frame in read_frames(self.clip.source, self.source, self.clip.frames):
            if digest is not None:
                add_frame(digest, frame)
            yield frame
        if digest is not None and digest.hexdigest() != self.clip.identity:
            raise TuneError(
                f"{self.clip.source} holds other frames than when this search began, or on this worker; "
                "make it the same everywhere and give the same command again"
            )
        self._checked = True


class _Pipelines:
    """One pipeline for all trials on a clip, so that unchanged steps are not repeated.

    A trial that averages frames has its own pipeline, because that pipeline keeps frames.
    """

    def __init__(self, base: Preset, rig: Rig) -> None:
        self._base, self._rig = base, rig
        self._shared = ContactPipeline(base, rig)
        self._own: dict[str, ContactPipeline] = {}

    def of(self, values: dict[str, Any]) -> ContactPipeline:
        """Return the pipeline for a trial, with its values."""
        preset = self._base.with_values(values)
        if preset.averaged_frames > 1:
            return self._own.setdefault(repr(values), ContactPipeline(preset, self._rig))
        self._shared.update(preset)
        return self._shared


def _timed(pipeline: ContactPipeline, frame: SensorFrame) -> tuple[ContactPatch, float]:
    """Return the patch and the processor time of this thread, ms.

    Time in which other workers and programs have the processor does not count, but they slow down memory. Windows
    counts processor time in steps of 16 ms; there it is the time of the steps of the contact test.
    """
    started = time.thread_time_ns()
    patch = pipeline.process(frame)
    busy_ms = (time.thread_time_ns() - started) / 1e6
    return patch, sum(patch.stage_ms.values()) if sys.platform == "win32" else busy_ms


class _JudgedFrame:
    """Measures patches against the truth of one frame; values that depend on the truth alone are computed once."""

    def __init__(self, frame: SensorFrame, rig: Rig) -> None:
        self.frame, self._rig = frame, rig
        self._last: tuple[ContactPatch, dict[str, float]] | None = None

    def judge(self, patch: ContactPatch) -> dict[str, float]:
        """Return the figures of a patch in this frame; nan where one is undefined."""
        if self._last is not None and np.array_equal(self._last[0].points, patch.points):
            return self._last[1]
        figures = {"points": float(len(patch.points)), "area": patch.area_mm2}
        if (truth := self.frame.truth) is not None:
            figures |= {
                "iou": pixel_scores(patch.mask, truth.contact).iou,
                "missed": float(len(patch.points) == 0 and bool(truth.contact.any())),
            }
            if len(self._truth) or not truth.contact.any():  # the true depth is known
                figures |= {
                    "rmse": self._rmse_mm(patch.points),
                    "area_error": abs(patch.area_mm2 - self._area_mm2),
                }
        self._last = patch, figures
        return figures

    @cached_property
    def _truth(self) -> Float32Array:
        assert self.frame.truth is not None
        return truth_cloud(self.frame.truth, self._rig).points

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._truth.astype(np.float64))

    @cached_property
    def _area_mm2(self) -> float:
        return 1e6 * float(pixel_areas_m2(self._truth[:, 2], self._rig.proximity.intrinsics).sum())

    def _rmse_mm(self, found: Float32Array) -> float:
        """Return `evaluation.metrics.symmetric_rmse_m` in mm; the tree of the truth is reused.

        If only one of patch and truth is empty, it is the diagonal of the other's bounding box, which no misplaced
        patch within it exceeds: finding nothing must never pay. nan if both are empty.
        """
        points = found.astype(np.float64)
        if len(points) == 0 or self._tree.n == 0:
            cloud = self._tree.data if self._tree.n else points
            return 1e3 * float(np.linalg.norm(np.ptp(cloud, axis=0))) if len(cloud) else math.nan
        there, back = self._tree.query(points)[0], cKDTree(points).query(self._tree.data)[0]
        return 500.0 * sum(math.sqrt(float(np.mean(np.square(distances)))) for distances in (there, back))


@dataclass
class _Run:
    """Collects the figures of one trial over all frames of all clips."""

    _clips: list[dict[str, list[float]]] = field(default_factory=list)
    _ms: list[float] = field(default_factory=list)
    _failure: str = ""
    _mask: BoolArray | None = None

    def begin_clip(self) -> None:
        self._clips.append({})
        self._mask = None

    def judge_frame(self, pipelines: _Pipelines, values: dict[str, Any], judged: _JudgedFrame) -> None:
        """Add the next frame."""
        if self._failure:
            return
        try:
            pipeline = pipelines.of(values)
            patch, ms = _timed(pipeline, judged.frame)
            if pipeline.preset.averaged_frames > 1:
                self._ms.append(ms)
            self._add(judged.judge(patch), patch.mask)
        except TactuneError as error:
            self._failure = str(error)
        except (ValueError, ArithmeticError, LookupError, TypeError, cv2.error) as error:  # not lack of memory
            self._failure = f"{type(error).__name__}: {error}"

    def time_frame(self, pipelines: _Pipelines, values: dict[str, Any], frame: SensorFrame) -> None:
        """Add the time of a frame; an average must not see a frame twice."""
        if not self._failure and (pipeline := pipelines.of(values)).preset.averaged_frames == 1:
            self._ms.append(min(_timed(pipeline, replace(frame))[1] for _ in range(_REPEATS)))  # a copy is unknown

    def _add(self, figures: dict[str, float], mask: BoolArray) -> None:
        if self._mask is not None:
            figures = figures | {"stability": pixel_scores(self._mask, mask).iou}
        self._mask = mask
        for name, figure in figures.items():
            self._clips[-1].setdefault(name, []).append(figure)

    def measured(self) -> Measured:
        """Return the figures: means over frames, then over clips."""
        if self._failure:
            return Measured({}, self._failure)
        figures = {"ms": median(self._ms)} if self._ms else {}
        for name in dict.fromkeys(name for clip in self._clips for name in clip):
            of_clips = [clip[name] for clip in self._clips if name in clip]
            if name == "missed":
                figures[name] = sum(map(sum, of_clips))
            else:  # nan only for an RMSE where nothing was to be found and nothing was
                figures[name] = _mean([_mean(clip) for clip in of_clips], default=0.0)
        return Measured(figures)


def _mean(numbers: Sequence[float], default: float = math.nan) -> float:
    known = [number for number in numbers if math.isfinite(number)]
    return fmean(known) if known else default
