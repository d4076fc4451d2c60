"""Runs the chosen methods on the newest frame, on a thread of its own: patches, times, scores against the truth."""

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
_MOST_COUNTS = 65534


class Drawing:
    """Makes the clouds of one frame, which share all but the patches.

    Parameters
    ----------
    result : Result
    theme : "light" or "dark"
    by_truth : bool
        Colour by the agreement with the frame's truth, which there must be, not by method.
    step : int
        Every how many rows and columns a point is drawn.
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
        """Return a patch at its own depth; the scene around it ends where the depth colours end."""
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
        """Put pixels to the depth of the point that is projected nearest to each.

        Points need not be proximity pixels: those of tactile methods are another camera's.
        """
        points = points[points[:, 2] > 0]
        columns, rows = np.rint(self._camera.intrinsics.project(points) / self._step).astype(np.intp).T
        inside = (columns >= 0) & (columns < depth.shape[1]) & (rows >= 0) & (rows < depth.shape[0])
        if not inside.any() or not where.any():
            return
        known: Uint16Array = np.zeros(depth.shape, np.uint16)
        counts = np.clip(np.rint(points[:, 2] / self._camera.depth_unit_m), 1, _MOST_COUNTS)
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


#: Over how many frames the median of the times goes.
TIMED_FRAMES = 15

NO_CONTACT = "No contact found in this frame"


@dataclass(frozen=True, eq=False)
class Task:
    """What to compare.

    Attributes
    ----------
    result : Result
        The frame, its source and the preset.
    methods : tuple of str
    untouched : SensorFrame or None
    no_untouched : str
        Why there is no untouched frame, as a sentence with the next step.
    by_truth : bool
        Colour points by their agreement with the truth.
    step : int
        Every how many rows and columns a point is drawn.
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
    """What can be said of a patch; None where there is no patch, no truth, or no distance to it."""

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
        The median of the last frames.
    note : str
        Why there is no patch.
    averaged_frames : int
        Over how many frames the method has averaged, this one included.
    """

    name: str
    scores: Scores
    cloud: DepthCloud
    ms: float | None = None
    note: str = ""
    averaged_frames: int = 1


@dataclass(frozen=True, eq=False)
class Comparison:
    """All chosen methods on one and the same frame; the truth first, where it is known."""

    task: Task
    outcomes: tuple[Outcome, ...]


@dataclass(frozen=True, eq=False)
class _Found:
    """What a method found in a frame."""

    frame: SensorFrame
    patch: MethodPatch
    scores: Scores
    note: str


@dataclass(eq=False)
class _Entrant:
    """A method that is ready, or the reason why it cannot be; and its last frame.

    Attributes
    ----------
    place : tuple
        Source, rig and untouched frame: where these change, the method is made anew.
    settings : tuple
        As `settings_of` returns them.
    warm : bool
        It has run once.
    shown : SensorFrame or None
        The last frame that it was given.
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
    """Keeps every method ready from frame to frame; belongs to one thread.

    Parameters
    ----------
    tell : callable
        Told the name of a method that is being set up, which may take a while.
    """

    def __init__(self, tell: Callable[[str], None] = lambda _name: None) -> None:
        self._tell = tell
        self._entrants: dict[str, _Entrant] = {}

    def compare(self, task: Task) -> Comparison:
        """Run the chosen methods on a frame; those that have seen it already are not run again.

        A method that fails, in whatever way, has an empty patch and a note.
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
        """Return a method that fits the task; where the preset has changed, a warm pipeline takes the new one over."""
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
        """Run a method and note how long that took, without what it loads at its first run."""
        if method.remembers > 1:
            return self._timed_once(name, entrant, method, frame)
        if not entrant.warm:
            self._tell(name)
            method.find(replace(frame))
            entrant.warm = True
        asked = replace(frame)  # a pipeline that knows the frame leaves stages out, and then the time is no frame's
        started = time.perf_counter_ns()
        patch = method.find(asked)
        entrant.times_ms.append((time.perf_counter_ns() - started) / 1e6)
        return patch

    def _timed_once(self, name: str, entrant: _Entrant, method: ContactMethod, frame: SensorFrame) -> MethodPatch:
        """Run a method that averages frames, to which the same frame must not be shown as if it were two."""
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
    """Return size and agreement of a patch; a method that failed has none."""
    if patch.failure:
        return Scores()
    size = len(patch.points), float(method_area_mm2(patch, rig))
    if truth is None:
        return Scores(*size)
    known = compare_with_truth(patch, truth, rig)
    rmse_mm = known["rmse_mm"] if math.isfinite(known["rmse_mm"]) else None
    return Scores(*size, rmse_mm, known["iou"], known["precision"], known["recall"])


_LONGEST_REST_S = 0.5


class CompareThread(QThread):
    """Takes tasks through a one-slot mailbox and gives comparisons back through another.

    While frames run it rests after each comparison for as long as that took, since window and worker
    share the processor with it.

    Signals
    -------
    compared()
        `take` has something new.
    settingUp(name: str)
        A method is made ready, which may take a while.
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
        """Frames that were not compared because a newer one came first."""
        return self._tasks.dropped

    def compare(self, task: Task) -> None:
        """Compare this frame next; one that still waits is skipped."""
        self._tasks.put(task)
        self._wake.set()

    def take(self) -> Comparison | None:
        """Take the newest comparison, or None."""
        return self._comparisons.take()

    def shut_down(self) -> None:
        """Stop after the present frame, for good; nobody waits for that, and nothing is emitted any more."""
        self._stopping.set()
        self._wake.set()
        abandon(self)

    def run(self) -> None:
        """Compare frame after frame until told to stop."""
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
                self._stopping.wait(min(time.perf_counter() - started, _LONGEST_REST_S))

    def _compare(self, comparer: Comparer, task: Task) -> None:
        try:
            comparison = comparer.compare(task)
        except Exception as error:
            self.failed.emit(explain(error, f"frame {task.result.frame_number} could not be compared"))
            return
        if self._comparisons.put(comparison):
            self.compared.emit()
