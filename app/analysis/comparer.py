"""Runs the chosen methods on the newest frame, on its own thread: patches, times, and scores against the truth."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from statistics import median
from threading import Event
from typing import Any

import cv2
import numpy as np
from PyQt6.QtCore import QObject, QThread, pyqtSignal

from ...core.evaluation.metrics import compare_with_truth, method_area_mm2, truth_cloud
from ...core.methods.fusion import Fusion
from ...core.methods.method import ContactMethod, MethodPatch, failed
from ...core.methods.registry import make_method, needs_untouched, settings_of
from ...core.model.arrays import BoolArray, Float32Array, Uint16Array
from ...core.model.clouds import ray_table
from ...core.model.frames import GroundTruth, Rig, SensorFrame
from ...core.model.intrinsics import Intrinsics
from ...widgets.basics.colormaps import Theme, patch_index
from ...widgets.clouds.cloud_data import DepthCloud
from ..worker.errors import explain
from ..worker.results import Result
from ..worker.threads import Mailbox, abandon, leave_room_for_the_window
from .method_looks import CONTACT_ROW, FALSE_ROW, HIDDEN_ROW, MISSED_ROW, TRUTH, agreement_lut, method_lut

_IDENTITY = np.eye(4)
_MAX_COUNTS = 65534


class Drawing:
    """Draws the clouds of one frame, which differ only in their patches.

    Parameters
    ----------
    result : Result
    theme : "light" or "dark"
    by_truth : bool
        Colour by agreement with the frame's truth, which must be known, instead of by method.
    step : int
        Draw every ``step``-th row and column.
    """

    def __init__(self, result: Result, theme: Theme, by_truth: bool, step: int) -> None:
        frame, self._rig = result.frame, result.source.rig
        camera = self._rig.proximity
        self._theme, self._step, self._camera = theme, step, camera
        self._depth = np.ascontiguousarray(frame.proximity_depth[::step, ::step])
        self._rays = _coarse_rays(camera.intrinsics, step)
        self._range_m = result.rendered.depth_range_m
        near, far = (limit / camera.depth_unit_m for limit in self._range_m)
        context = patch_index(np.zeros(self._depth.shape, bool), self._depth, near, far)
        self._context = np.minimum(context, np.uint8(HIDDEN_ROW))
        self._truth = frame.truth if by_truth else None

    def cloud(self, name: str, patch: MethodPatch) -> DepthCloud:
        """Return a patch at its own depth, over the scene within the range of the depth colours."""
        depth, rows = self._depth.copy(), self._context.copy()
        mask = self._coarse(patch.mask)
        rows[mask] = CONTACT_ROW
        if self._truth is not None:
            true = self._coarse(self._truth.contact)
            rows[mask & ~true] = FALSE_ROW
            rows[true & ~mask] = MISSED_ROW
            self._lift(depth, true & ~mask, truth_cloud(self._truth, self._rig).points)
        self._lift(depth, mask, patch.points)
        return DepthCloud(
            depth=depth,
            depth_unit_m=self._camera.depth_unit_m,
            rays=self._rays,
            lut=method_lut(name, self._theme) if self._truth is None else agreement_lut(self._theme),
            pose=_IDENTITY,
            index=rows,
            depth_range_m=self._range_m,
            count=len(patch.points) or int(np.count_nonzero(patch.mask)),
        )

    def _coarse(self, mask: BoolArray) -> BoolArray:
        return mask[:: self._step, :: self._step]

    def _lift(self, depth: Uint16Array, where: BoolArray, points: Float32Array) -> None:
        """Give each pixel in ``where`` the depth of the point projected nearest to it.

        The points of tactile methods come from the other camera, so they do not lie on proximity pixels.
        """
        points = points[points[:, 2] > 0]
        columns, rows = np.rint(self._camera.intrinsics.project(points) / self._step).astype(np.intp).T
        inside = (columns >= 0) & (columns < depth.shape[1]) & (rows >= 0) & (rows < depth.shape[0])
        if not inside.any() or not where.any():
            return
        known: Uint16Array = np.zeros(depth.shape, np.uint16)
        counts = np.clip(np.rint(points[:, 2] / self._camera.depth_unit_m), 1, _MAX_COUNTS)
        known[rows[inside], columns[inside]] = counts[inside].astype(np.uint16)
        _, labels = cv2.distanceTransformWithLabels(
            (known == 0).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
        )
        of_label = np.zeros(labels.max() + 1, np.uint16)
        of_label[labels[known > 0]] = known[known > 0]
        depth[where] = of_label[labels[where]]


@lru_cache(maxsize=4)
def _coarse_rays(intrinsics: Intrinsics, step: int) -> Float32Array:
    """Return the rays of every ``step``-th row and column, the same array each time."""
    return np.ascontiguousarray(ray_table(intrinsics)[::step, ::step])


#: Number of frames over which the median time is taken.
TIMED_FRAMES = 15

NO_CONTACT = "No contact found in this frame"


@dataclass(frozen=True, eq=False)
class Task:
    """A frame, and the methods to compare on it.

    Attributes
    ----------
    result : Result
        The frame, its source and the preset.
    methods : tuple of str
    untouched : SensorFrame or None
    no_untouched : str
        The reason why there is no untouched frame and what to do, as one sentence.
    by_truth : bool
        Colour points by their agreement with the truth.
    step : int
        Draw every ``step``-th row and column.
    """

    result: Result
    methods: tuple[str, ...]
    untouched: SensorFrame | None = None
    no_untouched: str = ""
    theme: Theme = "light"
    by_truth: bool = False
    step: int = 1


@dataclass(frozen=True)
class Scores:
    """Size and agreement of a patch; None without a patch, without truth, or if the distance is infinite."""

    points: int | None = None
    area_mm2: float | None = None
    rmse_mm: float | None = None
    iou: float | None = None
    precision: float | None = None
    recall: float | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """One method on one frame.

    Attributes
    ----------
    ms : float or None
        Median time of the last frames, in milliseconds.
    note : str
        The reason why there is no patch.
    averaged_frames : int
        Number of frames that the method averaged, including this one.
    """

    name: str
    scores: Scores
    cloud: DepthCloud
    ms: float | None = None
    note: str = ""
    averaged_frames: int = 1


@dataclass(frozen=True, eq=False)
class Comparison:
    """The outcomes of all chosen methods on one frame; the truth comes first if it is known."""

    task: Task
    outcomes: tuple[Outcome, ...]


@dataclass(frozen=True, eq=False)
class _Found:
    """The patch of one method in one frame."""

    frame: SensorFrame
    patch: MethodPatch
    scores: Scores
    note: str


@dataclass(eq=False)
class _Entrant:
    """A method, or the reason why it cannot be set up; with its last frame.

    Attributes
    ----------
    place : tuple
        Source, rig and untouched frame; if one changes, the method is made again.
    settings : tuple
        The preset fields it depends on, from `settings_of`.
    warm : bool
        Whether it has run once.
    shown : SensorFrame or None
        Its last frame.
    """

    place: tuple[Any, ...]
    settings: tuple[Any, ...]
    method: ContactMethod | None = None
    problem: str = ""
    warm: bool = False
    shown: SensorFrame | None = None
    times_ms: deque[float] = field(default_factory=lambda: deque(maxlen=TIMED_FRAMES))
    found: _Found | None = None


class Comparer:
    """Keeps the methods from frame to frame; belongs to one thread.

    Parameters
    ----------
    tell : callable
        Called with the name of a method before it is set up, which may take seconds.
    """

    def __init__(self, tell: Callable[[str], None] = lambda _name: None) -> None:
        self._tell = tell
        self._entrants: dict[str, _Entrant] = {}

    def compare(self, task: Task) -> Comparison:
        """Run the chosen methods on a frame, except those that have already run on it.

        A method that fails with any exception has an empty patch and a note.
        """
        drawing = Drawing(task.result, task.theme, task.by_truth, task.step)
        outcomes = []
        if (truth := task.result.frame.truth) is not None:
            outcomes.append(_truth_outcome(truth, task.result.source.rig, drawing))
        for name in task.methods:
            entrant = self._entrant(name, task)
            found = self._find(name, entrant, task)
            ms = median(entrant.times_ms) if entrant.times_ms else None
            cloud, averaged = drawing.cloud(name, found.patch), found.patch.averaged_frames
            outcomes.append(Outcome(name, found.scores, cloud, ms, found.note, averaged))
        return Comparison(task, tuple(outcomes))

    def _entrant(self, name: str, task: Task) -> _Entrant:
        """Return a method that fits the task; a changed preset updates a fusion pipeline in place."""
        preset, source = task.result.preset, task.result.source
        against = (task.untouched, task.no_untouched) if needs_untouched(name) else ()
        fresh = _Entrant((source.name, source.rig, *against), settings_of(name, preset))
        known = self._entrants.get(name)
        if known is not None and (known.place, known.settings) == (fresh.place, fresh.settings):
            return known
        self._entrants[name] = fresh
        if against and task.untouched is None and task.no_untouched:
            fresh.problem = task.no_untouched
            return fresh
        try:
            if known is not None and known.place == fresh.place and isinstance(known.method, Fusion):
                known.method.update(preset)
                fresh.method, fresh.warm, fresh.shown = known.method, known.warm, known.shown
            else:
                self._tell(name)
                fresh.method = make_method(name, preset, source.rig, task.untouched)
        except Exception as error:
            fresh.problem = explain(error, f"{name} cannot be set up")
        return fresh

    def _find(self, name: str, entrant: _Entrant, task: Task) -> _Found:
        frame, rig, number = task.result.frame, task.result.source.rig, task.result.frame_number
        if entrant.found is not None and entrant.found.frame is frame:
            return entrant.found
        patch = failed(rig.proximity.intrinsics.shape, entrant.problem)
        scores = Scores()
        if entrant.method is not None:
            try:
                patch = self._timed(name, entrant, entrant.method, frame)
                scores = _scores(patch, frame.truth, rig)
            except Exception as error:
                patch = failed(rig.proximity.intrinsics.shape, explain(error, f"{name} failed on frame {number}"))
        note = patch.failure or ("" if len(patch.points) else NO_CONTACT)
        entrant.found = _Found(frame, patch, scores, note)
        return entrant.found

    def _timed(self, name: str, entrant: _Entrant, method: ContactMethod, frame: SensorFrame) -> MethodPatch:
        """Run a method and note its time, except that of its first run."""
        if method.remembers > 1:
            return self._timed_once(name, entrant, method, frame)
        if not entrant.warm:
            self._tell(name)
            method.find(replace(frame))
            entrant.warm = True
        asked = replace(frame)  # a copy: for a known frame, a pipeline skips stages and the time would be too short
        started = time.perf_counter_ns()
        patch = method.find(asked)
        entrant.times_ms.append((time.perf_counter_ns() - started) / 1e6)
        return patch

    def _timed_once(self, name: str, entrant: _Entrant, method: ContactMethod, frame: SensorFrame) -> MethodPatch:
        """Run a method that averages frames; it must not see the same frame twice."""
        if not entrant.warm:
            self._tell(name)
        started = time.perf_counter_ns()
        patch = method.find(frame)
        if entrant.warm and entrant.shown is not frame:
            entrant.times_ms.append((time.perf_counter_ns() - started) / 1e6)
        entrant.warm, entrant.shown = True, frame
        return patch


def _truth_outcome(truth: GroundTruth, rig: Rig, drawing: Drawing) -> Outcome:
    patch = MethodPatch(truth_cloud(truth, rig).points, lambda: truth.contact)
    known_depth = truth.depth_m is not None
    count = len(patch.points) if known_depth else int(np.count_nonzero(truth.contact))
    scores = Scores(count, float(method_area_mm2(patch, rig)) if known_depth else None)
    note = "" if count else "Nothing touches the membrane in this frame"
    return Outcome(TRUTH, scores, drawing.cloud(TRUTH, patch), note=note)


def _scores(patch: MethodPatch, truth: GroundTruth | None, rig: Rig) -> Scores:
    """Return size and agreement of a patch; none for a method that failed."""
    if patch.failure:
        return Scores()
    size = len(patch.points), float(method_area_mm2(patch, rig))
    if truth is None:
        return Scores(*size)
    known = compare_with_truth(patch, truth, rig)
    rmse_mm = known["rmse_mm"] if math.isfinite(known["rmse_mm"]) else None
    return Scores(*size, rmse_mm, known["iou"], known["precision"], known["recall"])


_MAX_REST_S = 0.5


class CompareThread(QThread):
    """Takes tasks from a one-slot mailbox and returns comparisons through another.

    While frames play, it rests after each comparison for as long as the comparison took, because window and
    worker share the processor with it.

    Signals
    -------
    compared()
        `take` has a new comparison.
    settingUp(name: str)
        A method is being set up, which may take seconds.
    failed(sentence: str)
        A frame could not be compared.
    """

    compared = pyqtSignal()
    settingUp = pyqtSignal(str)
    failed = pyqtSignal(str)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._tasks: Mailbox[Task] = Mailbox(lambda old, new: old.result.frame is new.result.frame)
        self._comparisons: Mailbox[Comparison] = Mailbox()
        self._wake = Event()
        self._stopping = Event()

    @property
    def skipped(self) -> int:
        """Number of frames that were replaced by a newer one before they were compared."""
        return self._tasks.dropped

    def compare(self, task: Task) -> None:
        """Compare this frame next; a waiting one is skipped."""
        self._tasks.put(task)
        self._wake.set()

    def take(self) -> Comparison | None:
        """Return the newest comparison once; None if there is no new one."""
        return self._comparisons.take()

    def shut_down(self) -> None:
        """Stop for good after the present frame. Does not wait; no signal is emitted any more."""
        self._stopping.set()
        self._wake.set()
        abandon(self)

    def run(self) -> None:
        """Compare frames until `shut_down`."""
        leave_room_for_the_window()
        comparer = Comparer(self.settingUp.emit)
        while not self._stopping.is_set():
            self._wake.wait()
            self._wake.clear()
            task = self._tasks.take()
            if task is None or self._stopping.is_set():
                continue
            started = time.perf_counter()
            self._compare(comparer, task)
            if task.result.playback.running:
                self._stopping.wait(min(time.perf_counter() - started, _MAX_REST_S))

    def _compare(self, comparer: Comparer, task: Task) -> None:
        try:
            comparison = comparer.compare(task)
        except Exception as error:
            self.failed.emit(explain(error, f"frame {task.result.frame_number} could not be compared"))
            return
        if self._comparisons.put(comparison):
            self.compared.emit()
