"""Processes a batch of runs over one clip, on a worker of a sweep.

The outer loop is over frames, the inner loop over runs. Each frame is therefore read once for all runs, and
consecutive runs share the results of their common steps. A worker keeps its last source open.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

import cv2

from ..contact.kernels.threads import get_threads, set_threads
from ..contact.pipeline import ContactPipeline
from ..contact.warmup import warm_up
from ..errors import TactuneError
from ..evaluation.table_cell import code_version
from ..methods.fusion import Fusion
from ..methods.method import ContactMethod, MethodPatch
from ..methods.registry import make_method, needs_untouched
from ..model.frames import SensorFrame
from ..preset import Preset
from ..rig.untouched import untouched_frame
from ..sources.base import FrameSource
from ..sources.registry import open_source
from .clips import Clip, add_frame, frames_identity
from .plan import FUSION, Batch
from .results import JudgedFrame, Result, Tally
from .values import SweepError

#: Returns the patch of a frame and the computation time in ms.
Find = Callable[[SensorFrame], tuple[MethodPatch, float]]

_kept: Final = threading.local()


def run_batch(batch: Batch) -> list[Result]:
    """Process all runs of a batch on one thread and return their results.

    A run that fails because of its parameters gives a result with the reason in ``failure``.

    Raises
    ------
    TactuneError
        This process runs another version of the code than the plan, or its recording has other frames.
    """
    if code_version() != batch.code:
        raise SweepError(
            "a worker runs another version of Tactune than this sweep; install the same one everywhere, "
            "restart the workers and give the same command again"
        )
    with _one_thread():
        return _OpenClip.of(batch.clip).run(batch)


class _OpenClip:
    """A clip whose source is open."""

    def __init__(self, clip: Clip) -> None:
        self.clip = clip
        self.source = open_source(clip.name)
        self._checked = False
        self._untouched: SensorFrame | None = None

    @staticmethod
    def of(clip: Clip) -> _OpenClip:
        """Return the calling thread's open clip; open this clip if another one is open."""
        before: _OpenClip | None = getattr(_kept, "clip", None)
        if before is not None and before.clip == clip:
            return before
        if before is None:
            warm_up()  # so that no measured time includes loading code
        fresh = _OpenClip(clip)  # opened before the old one is closed, because both may share a solved scene
        _kept.clip = fresh
        if before is not None:
            before.source.close()
        return fresh

    def run(self, batch: Batch) -> list[Result]:
        """Do the runs of a batch."""
        digest = None if self._checked else frames_identity(self.source.rig)
        shared = _SharedPipeline(batch.base, self.source)
        tallies = [Tally(key) for key, _, _ in batch.runs]
        finds = [
            self._make_find(tally, shared, method, batch, values)
            for tally, (_, method, values) in zip(tallies, batch.runs, strict=True)
        ]
        for frame in self._frames():
            if digest is not None:
                add_frame(digest, frame)
            judged = JudgedFrame(frame, self.source.rig)
            for tally, find in zip(tallies, finds, strict=True):
                if find is not None:
                    with _failures_of(tally):
                        tally.add(judged, *find(frame))
        if digest is not None and digest.hexdigest() != self.clip.identity:
            raise SweepError(
                f"{self.clip.source} holds other frames than when this sweep began, or on this worker; "
                "make it the same everywhere and give the same command again"
            )
        self._checked = True
        return [tally.result() for tally in tallies]

    def _frames(self) -> Iterator[SensorFrame]:
        for index in self.clip.frames:
            self.source.seek(index)
            frame = self.source.next_frame()
            if frame is None:
                raise SweepError(f"{self.clip.source} ends before its frame {index}; check the recording")
            yield frame

    def _make_find(
        self, tally: Tally, shared: _SharedPipeline, method: str, batch: Batch, values: dict[str, Any]
    ) -> Find | None:
        """Return the function that finds patches for a run; None on failure, which is recorded in the tally."""
        with _failures_of(tally):
            preset = batch.base.with_values(values)
            if method != FUSION:
                return _find_by(make_method(method, preset, self.source.rig, self._untouched_for(method, batch)))
            if preset.averaged_frames > 1:
                return _find_by(Fusion(preset, self.source.rig, FUSION, {}))  # it keeps frames, so it is not shared
            return lambda frame: shared.find(preset, frame)
        return None

    def _untouched_for(self, method: str, batch: Batch) -> SensorFrame | None:
        if needs_untouched(method) and self._untouched is None:
            self._untouched = batch.untouched or untouched_frame(self.source)
        return self._untouched


def _find_by(method: ContactMethod) -> Find:
    def find(frame: SensorFrame) -> tuple[MethodPatch, float]:
        started = time.perf_counter_ns()
        patch = method.find(frame)
        return patch, (time.perf_counter_ns() - started) / 1e6

    return find


class _SharedPipeline:
    """One pipeline for all runs of a batch; unchanged stages are not computed again."""

    def __init__(self, base: Preset, source: FrameSource) -> None:
        self._pipeline = ContactPipeline(base, source.rig)
        self._stage_ms: dict[str, float] = {}

    def find(self, preset: Preset, frame: SensorFrame) -> tuple[MethodPatch, float]:
        """Return the patch and its computation time without caching, ms."""
        self._pipeline.update(preset)
        patch = self._pipeline.process(frame)
        before, self._stage_ms, fresh = self._stage_ms, {}, False
        for stage, ms in patch.stage_ms.items():
            fresh = fresh or ms > 0  # stages before the first one that ran were cached
            self._stage_ms[stage] = ms if fresh else before.get(stage, 0.0)
        return MethodPatch(patch.points, lambda: patch.mask), sum(self._stage_ms.values())


@contextmanager
def _failures_of(tally: Tally) -> Iterator[None]:
    """Record an error of a run as its failure. Errors of the machine, such as lack of memory, are raised."""
    try:
        yield
    except TactuneError as error:
        tally.fail(str(error))
    except (ValueError, ArithmeticError, LookupError, TypeError, cv2.error) as error:
        tally.fail(f"{type(error).__name__}: {error}")


@contextmanager
def _one_thread() -> Iterator[None]:
    """Run the calling thread's kernels and OpenCV on one thread while a batch is processed."""
    before = get_threads()
    set_threads(1)
    _single_opencv.enter()
    try:
        yield
    finally:
        _single_opencv.leave()
        set_threads(before)


class _SingleOpenCV:
    """OpenCV has one thread count per process: the first batch sets it to 1, the last batch restores it."""

    def __init__(self) -> None:
        self._lock, self._inside, self._before = threading.Lock(), 0, 1

    def enter(self) -> None:
        with self._lock:
            if self._inside == 0:
                self._before = cv2.getNumThreads()
                cv2.setNumThreads(1)
            self._inside += 1

    def leave(self) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                cv2.setNumThreads(self._before)


_single_opencv: Final = _SingleOpenCV()
