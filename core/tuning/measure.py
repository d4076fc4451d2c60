"""Measures trials over all clips, on one thread of a worker.

The outer loop is over frames, the inner loop over trials. Each frame is therefore read once for all trials, and
consecutive trials share the results of their common steps.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from statistics import fmean, median
from typing import Any, Final

import cv2
import numpy as np

from ..contact.kernels.threads import set_threads
from ..contact.pipeline import ContactPipeline
from ..errors import TactuneError
from ..model.arrays import BoolArray, Float32Array
from ..model.frames import Rig, SensorFrame
from ..model.metrics import TruthTree, pixel_scores, true_contact
from ..model.patch import ContactPatch
from ..preset import Preset
from ..sources.base import SeekableSource
from ..warmup import warm_up
from .plan import STAGE_OF, Plan, open_recording

#: Values of `OBJECTIVES`, the time only if it is one, and ``points``; those that are undefined are missing. And why the
#: trial's parameters cannot be used; empty if they can.
Measured = tuple[dict[str, float], str]

#: Frames on which a trial is timed without shared steps, and runs of each; the least time of a frame counts.
_TIMES: Final = 5
_REPEATS: Final = 3
#: Time in which other workers and programs have the processor does not count, except on Windows, whose clock of
#: threads counts in 16 ms.
_clock_ns: Final = time.perf_counter_ns if sys.platform == "win32" else time.thread_time_ns


@lru_cache(8)
def _source(name: str) -> SeekableSource:
    """Open a source once for all batches of this process."""
    warm_up()  # so that no measured time includes loading code
    return open_recording(name)


def measure(plan: Plan, trials: Sequence[dict[str, Any]]) -> list[Measured]:
    """Measure trials, each given by the values of its fields. The calling thread does nothing else: it is a worker's.

    Raises a `TactuneError` if a source cannot be read.
    """
    set_threads(1)
    cv2.setNumThreads(1)
    runs = [_Run(plan.base, values) for values in trials]
    early_first = sorted(runs, key=_Run.order)
    timed_frames = -(-_TIMES // len(plan.clips)) if "ms" in plan.objectives else 0
    for clip in plan.clips:
        source = _source(clip.name)
        shared = ContactPipeline(plan.base, source.rig)
        for run in runs:
            run.attempt(run.begin, shared, source.rig)
        for number, frame in enumerate(map(source.read, clip.frames)):
            truth = _Truth(frame, source.rig) if frame.truth is not None else None
            for run in early_first:
                run.attempt(run.judge, frame, truth)
            for _ in range(number, timed_frames, len(clip.frames)):  # a short clip's frames are timed more than once
                for run in early_first:
                    run.attempt(run.time, frame)
    return [({}, run.failure) if run.failure else (run.figures(), "") for run in runs]


class _Run:
    """One trial: its preset, its pipeline on the present clip, and its figures of all frames so far."""

    def __init__(self, base: Preset, values: dict[str, Any]) -> None:
        self.failure = ""
        self._base, self._values = base, values
        self._clips: list[dict[str, list[float]]] = []
        self._ms: list[float] = []

    def order(self) -> list[tuple[int, str, str]]:
        """Return a key that puts trials with equal fields of early steps beside each other."""
        return sorted((STAGE_OF.get(path, 0), path, repr(value)) for path, value in self._values.items())

    def attempt(self, step: Callable[..., None], *arguments: object) -> None:
        """Take a step unless one has failed; parameters that cannot be used are a failure of this trial alone."""
        if self.failure:
            return
        try:
            step(*arguments)
        except TactuneError as error:
            self.failure = str(error)
        except (ValueError, ArithmeticError, LookupError, TypeError, cv2.error) as error:  # not lack of memory
            self.failure = f"{type(error).__name__}: {error}"

    def begin(self, shared: ContactPipeline, rig: Rig) -> None:
        """Begin a clip with the pipeline that all trials share; one that averages keeps frames, so it is not shared."""
        self._preset = self._base.with_values(self._values)
        self._averages = self._preset.averaged_frames > 1
        self._pipeline = ContactPipeline(self._preset, rig) if self._averages else shared
        self._mask: BoolArray | None = None
        self._clips.append({})

    def judge(self, frame: SensorFrame, truth: _Truth | None) -> None:
        """Add the figures of the next frame."""
        patch, ms = self._process(frame)
        if self._averages:
            self._ms.append(ms)
        figures = {"points": float(len(patch.points)), "area": patch.area_mm2}
        if truth is not None:
            figures |= truth.compare(patch)
        if self._mask is not None:
            figures["stability"] = pixel_scores(self._mask, patch.mask).iou
        self._mask = patch.mask
        for name, figure in figures.items():
            self._clips[-1].setdefault(name, []).append(figure)

    def time(self, frame: SensorFrame) -> None:
        """Add the time of a frame without shared steps; an average must not see a frame twice."""
        if not self._averages:
            self._ms.append(min(self._process(replace(frame))[1] for _ in range(_REPEATS)))  # a copy is unknown

    def figures(self) -> dict[str, float]:
        """Return the figures: means over frames, then over clips."""
        figures = {"ms": median(self._ms)} if self._ms else {}
        for name in dict.fromkeys(name for clip in self._clips for name in clip):
            figures[name] = _mean([_mean(clip[name], math.nan) for clip in self._clips if name in clip], 0.0)
        return figures

    def _process(self, frame: SensorFrame) -> tuple[ContactPatch, float]:
        """Return the patch and the processor time that it took, ms."""
        self._pipeline.update(self._preset)
        started = _clock_ns()
        patch = self._pipeline.process(frame)
        return patch, 1e-6 * (_clock_ns() - started)


class _Truth:
    """The true contact of a frame, for many patches."""

    def __init__(self, frame: SensorFrame, rig: Rig) -> None:
        assert frame.truth is not None
        self._contact = frame.truth.contact
        self._points, self._area_mm2 = true_contact(frame, rig)
        self._tree = TruthTree(self._points, samples=max(1, len(self._points)))
        self._last: tuple[Float32Array, dict[str, float]] | None = None

    def compare(self, patch: ContactPatch) -> dict[str, float]:
        """Return the figures of a patch that need truth; without true depth only the IoU."""
        if self._last is not None and np.array_equal(self._last[0], patch.points):
            return self._last[1]
        figures = {"iou": pixel_scores(patch.mask, self._contact).iou}
        if len(self._points) or not self._contact.any():
            figures["rmse"] = self._rmse_mm(patch.points)
            figures["area_error"] = abs(patch.area_mm2 - self._area_mm2)
        self._last = patch.points, figures
        return figures

    def _rmse_mm(self, points: Float32Array) -> float:
        """Return the symmetric RMSE, mm; nan if nothing touches and nothing was found.

        If only one of patch and truth is empty, it is the diagonal of the other's bounding box, which no misplaced
        patch within it exceeds: finding nothing must never pay.
        """
        if len(points) and len(self._points):
            return 1e3 * self._tree.symmetric_rmses_m([points])[0]
        cloud = points if len(points) else self._points
        return 1e3 * float(np.linalg.norm(np.ptp(cloud, axis=0))) if len(cloud) else math.nan


def _mean(numbers: Sequence[float], default: float) -> float:
    """Return the mean of the finite numbers, or else the default."""
    known = [number for number in numbers if math.isfinite(number)]
    return fmean(known) if known else default
