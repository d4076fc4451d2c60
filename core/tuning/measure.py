"""Measures trials over all clips: what one thread of a worker does, and the workers, as executors.

Each frame is read once for all trials of a batch.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from multiprocessing.connection import Connection
from statistics import fmean, median
from typing import Any, Final

import cv2
import numpy as np

from ..contact.kernels.threads import set_threads
from ..contact.pipeline import ContactPipeline
from ..errors import TactuneError, extra, foreign
from ..model.arrays import BoolArray, Float32Array
from ..model.frames import Rig, SensorFrame
from ..model.metrics import TruthTree, pixel_scores, true_contact
from ..model.patch import ContactPatch
from ..preset import Preset
from ..rig.untouched import untouched_frame
from ..sources.base import SeekableSource
from ..warmup import warm_up
from .plan import Plan, TuneError, open_recording

#: Values of `OBJECTIVES` and ``points``; those that are undefined are missing. And why the
#: trial's parameters cannot be used; empty if they can.
Measured = tuple[dict[str, float], str]


@lru_cache(8)
def _source(name: str) -> SeekableSource:
    """Open a source once for all batches of this process."""
    warm_up()  # so that no measured time includes loading code
    return open_recording(name)


def measure(plan: Plan, trials: Sequence[dict[str, Any]]) -> list[Measured]:
    """Measure trials, each given by the values of its fields; the calling thread is a worker's and only does this."""
    set_threads(1)
    cv2.setNumThreads(1)
    runs = [_Run(plan.base, values) for values in trials]
    for clip in plan.clips:
        source = _source(clip.source)
        untouched = untouched_frame(source) if plan.base.test.needs_untouched else None
        shared = ContactPipeline(plan.base, source.rig, untouched)
        for run in runs:
            run.attempt(run.begin, shared, source.rig)
        for frame in map(source.read, clip.frames):
            truth = _Truth(frame, source.rig) if frame.truth is not None else None
            for run in runs:
                run.attempt(run.judge, frame, truth)
    return [({}, run.failure) if run.failure else (run.figures(), "") for run in runs]


class _Run:
    """One trial: its preset, its pipeline on the present clip, and its figures of all frames so far."""

    def __init__(self, base: Preset, values: dict[str, Any]) -> None:
        self.failure = ""
        self._base, self._values = base, values
        self._clips: list[dict[str, list[float]]] = []
        self._ms: list[float] = []

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
        self._pipeline.update(self._preset)
        asked = frame if self._averages else replace(frame)  # of a copy no step is known; an average must not see two
        if not self._ms and not self._averages:
            self._pipeline.process(replace(frame))  # the first is slow
        started_ns = time.thread_time_ns()  # without the time in which others have the processor
        patch = self._pipeline.process(asked)
        self._ms.append(1e-6 * (time.thread_time_ns() - started_ns))
        figures = {"points": float(len(patch.points))}
        if truth is not None:
            figures |= truth.compare(patch)
        if self._mask is not None:
            figures["stability"] = pixel_scores(self._mask, patch.mask).iou
        self._mask = patch.mask
        for name, figure in figures.items():
            self._clips[-1].setdefault(name, []).append(figure)

    def figures(self) -> dict[str, float]:
        """Return the figures: means over frames, then over clips."""
        figures = {"ms": median(self._ms)}
        for name in dict.fromkeys(name for clip in self._clips for name in clip):
            figures[name] = _mean([_mean(clip[name], math.nan) for clip in self._clips if name in clip], 0.0)
        return figures


class _Truth:
    """The true contact of a frame, for many patches."""

    def __init__(self, frame: SensorFrame, rig: Rig) -> None:
        assert frame.truth is not None
        self._contact = frame.truth.contact
        self._points, _ = true_contact(frame, rig)
        self._tree = TruthTree(self._points)

    def compare(self, patch: ContactPatch) -> dict[str, float]:
        """Return the figures of a patch that need truth; without true depth only the IoU."""
        figures = {"iou": pixel_scores(patch.mask, self._contact).iou}
        if len(self._points) or not self._contact.any():
            figures["rmse"] = self._rmse_mm(patch.points)
        return figures

    def _rmse_mm(self, points: Float32Array) -> float:
        """Return the symmetric RMSE, mm; nan if nothing touches and nothing was found.

        If only one of patch and truth is empty, it is the diagonal of the other's bounding box, which no misplaced
        patch within it exceeds: finding nothing must never pay.
        """
        if len(points) and len(self._points):
            return 1e3 * self._tree.symmetric_rmse_m(points)
        cloud = points if len(points) else self._points
        return 1e3 * float(np.linalg.norm(np.ptp(cloud, axis=0))) if len(cloud) else math.nan


def _mean(numbers: Sequence[float], default: float) -> float:
    known = [number for number in numbers if math.isfinite(number)]
    return fmean(known) if known else default


@dataclass(frozen=True)
class Workers:
    """An executor, and the number of batches that it measures at once."""

    executor: Executor
    count: int

    def submit(self, work: Callable[..., Any], *arguments: object) -> Future[Any]:
        """Submit a batch; Ctrl+C is held back, since a process started for it would end with a traceback."""
        usual = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            return self.executor.submit(work, *arguments)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, usual)


@contextmanager
def local_workers(jobs: int) -> Iterator[Workers]:
    """Yield workers on this computer: processes of one thread each, or with one job a thread of this process."""
    # Processes inherit it. PYTHONSAFEPATH: they import nothing from the working folder.
    ours = {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PYTHONSAFEPATH"} - os.environ.keys()
    os.environ.update(dict.fromkeys(ours, "1"))
    context = multiprocessing.get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    executor: Executor = (
        ProcessPoolExecutor(jobs, context, _begin_worker, (reader,)) if jobs > 1 else ThreadPoolExecutor(1)
    )
    try:
        yield Workers(executor, jobs)
    finally:
        writer.close()
        executor.shutdown(cancel_futures=True)
        for name in ours:
            del os.environ[name]


def _begin_worker(parent: Connection) -> None:
    """Ignore Ctrl+C, which a terminal sends to all processes, and end when the parent closes the pipe or dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        with suppress(EOFError, OSError):
            parent.recv()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


#: Longest wait for a Dask scheduler, seconds.
_CONNECT_S: Final = 10.0


@contextmanager
def cluster_workers(address: str) -> Iterator[Workers]:
    """Yield the workers of a Dask scheduler, one thread each; `TuneError` if no scheduler with a worker answers."""
    distributed = extra("distributed", "--scheduler", "cluster")
    try:
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
        client.wait_for_workers(1, timeout=_CONNECT_S)
    except (OSError, ValueError, TypeError) as error:
        raise TuneError(
            f"no Dask scheduler with a worker answers at {address} ({foreign(error)}); give "
            "the address that dask scheduler prints, such as tcp://192.168.0.5:8786, and start dask worker ADDRESS "
            "--nthreads 1"
        ) from error
    with client:
        yield Workers(client.get_executor(pure=False), sum(client.nthreads().values()))
