"""Runs the chosen methods on a frame, on another thread: patches, times, scores against the truth, and their clouds."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from statistics import median
from typing import Any, Final

import numpy as np
from PyQt6.QtGui import QColor

from ...core.contact.pipeline import ContactPipeline
from ...core.errors import TactuneError
from ...core.lab.methods import PIPELINES, make_method, patch_area_mm2
from ...core.lab.single_camera import Find
from ...core.model.arrays import BoolArray, Uint8Array
from ...core.model.clouds import ray_table
from ...core.model.frames import SensorFrame
from ...core.model.metrics import compare_with_truth, truth_cloud
from ...core.model.patch import ContactPatch
from ...core.preset import Preset
from ...core.rig.untouched import FoundUntouched
from ...widgets.basics.colormaps import patch_index, patch_lut
from ...widgets.basics.theme import ThemeName
from ...widgets.clouds.cloud_data import DepthCloud
from ..worker.errors import explain
from ..worker.results import Result
from ..worker.threads import leave_room_for_the_window

TRUTH: Final = "truth"
#: Number of frames over which the median time is taken.
_TIMED_FRAMES: Final = 15
#: Longest rest after a comparison while frames play, seconds.
_MAX_REST_S: Final = 0.5

#: Okabe and Ito's colours, which colour-blind people can tell apart; two of them change on a dark background.
_RGB: Final = {
    TRUTH: (20, 20, 20),
    "straight": (148, 148, 148),
    "fusion-rigid": (213, 94, 0),
    "fusion-homography": (230, 159, 0),
    "fusion-membrane": (0, 158, 115),
    "fusion-averaged": (119, 68, 255),
    "proximity-only": (0, 114, 178),
    "tactile-only": (86, 180, 233),
    "mechanics": (110, 40, 0),
}
_DARK_RGB: Final = {TRUTH: (250, 250, 250), "mechanics": (210, 180, 110)}
_OTHER_RGB: Final = (204, 121, 167)
#: Rows of the clouds' colours after those of the context; the farthest shade is hidden.
CONTACT_ROW, HIDDEN_ROW = 255, 252


def method_color(name: str, theme: ThemeName) -> QColor:
    """Return the colour of a method, or of the truth."""
    rgb = _RGB.get(name, _OTHER_RGB)
    return QColor(*(_DARK_RGB.get(name, rgb) if theme == "dark" else rgb))


@cache
def _lut(contact: tuple[int, int, int], theme: ThemeName) -> Uint8Array:
    """Return the colours of a patch over the relief of the scene: uint8 (256, 4)."""
    lut = patch_lut(theme).copy()
    lut[CONTACT_ROW] = (*contact, 255)
    lut[HIDDEN_ROW] = 0
    lut.flags.writeable = False
    return lut


@dataclass(frozen=True, eq=False)
class Outcome:
    """One method, or the truth, on one frame, with its median time; numbers that do not exist are nan."""

    name: str
    cloud: DepthCloud
    points: float = math.nan
    area_mm2: float = math.nan
    ms: float = math.nan
    rmse_mm: float = math.nan
    iou: float = math.nan
    note: str = ""
    averaged: int = 1


@dataclass(frozen=True, eq=False)
class Comparison:
    """The outcomes on one frame; the truth comes first if it is known."""

    result: Result
    methods: tuple[str, ...]
    outcomes: tuple[Outcome, ...]


@dataclass(eq=False)
class _Entrant:
    """A method as it was made, and its times; or why it could not be made."""

    made_for: tuple[Any, ...]
    preset: Preset
    find: Find | None = None
    problem: str = ""
    pipeline: ContactPipeline | None = None
    warm: bool = False
    newest: SensorFrame | None = None
    times_ms: deque[float] = field(default_factory=lambda: deque(maxlen=_TIMED_FRAMES))
    found: dict[str, Any] = field(default_factory=dict)
    mask: BoolArray | None = None


class Comparer:
    """Keeps the methods from frame to frame; belongs to one thread at a time."""

    def __init__(self) -> None:
        self._entrants: dict[str, _Entrant] = {}
        self._rest_s = 0.0

    def compare(
        self, result: Result, methods: Sequence[str], untouched: FoundUntouched, theme: ThemeName
    ) -> Comparison:
        """Run the methods on a frame, except those that have already run on it."""
        leave_room_for_the_window()
        if result.playback.playing:  # window and worker share the processor
            time.sleep(min(self._rest_s, _MAX_REST_S))
        started = time.perf_counter()
        truth = result.frame.truth
        outcomes = []
        if truth is not None:
            points = truth_cloud(truth, result.source.rig).points
            lens = result.source.rig.proximity.intrinsics
            area_mm2 = 1e6 * float(np.square(points[:, 2], dtype=np.float64).sum()) / (lens.fx * lens.fy)
            note = "" if truth.contact.any() else "Nothing touches the membrane in this frame"
            cloud = _cloud(TRUTH, truth.contact, result, theme)
            count = int(np.count_nonzero(truth.contact))
            outcomes.append(Outcome(TRUTH, cloud, count, area_mm2 if len(points) else math.nan, note=note))
        for name in methods:
            entrant = self._entrant(name, result, untouched)
            self._run(name, entrant, result)
            cloud = _cloud(name, entrant.mask, result, theme)
            ms = median(entrant.times_ms) if entrant.times_ms else math.nan
            outcomes.append(Outcome(name, cloud, ms=ms, **entrant.found))
        self._rest_s = time.perf_counter() - started
        return Comparison(result, tuple(methods), tuple(outcomes))

    def _entrant(self, name: str, result: Result, untouched: FoundUntouched) -> _Entrant:
        """Return a method that fits the frame; a changed preset updates a pipeline in place."""
        preset, rig = result.preset, result.source.rig
        rival = name not in PIPELINES
        made_for = (id(result.source), *((id(untouched), preset.alignment) if rival else ()))
        known = self._entrants.get(name)
        if known is not None and known.made_for == made_for and (rival or known.preset is preset):
            return known
        fresh = self._entrants[name] = _Entrant(made_for, preset)
        try:
            if known is not None and known.made_for == made_for and known.pipeline is not None:
                known.pipeline.update(preset.with_values(PIPELINES[name]))
                fresh.pipeline, fresh.find, fresh.warm = known.pipeline, known.find, known.warm
            elif not rival:
                fresh.pipeline = ContactPipeline(preset.with_values(PIPELINES[name]), rig)
                fresh.find = fresh.pipeline.process
            elif untouched.frame is None:
                fresh.problem = " ".join(untouched.warnings)
            else:
                fresh.find = make_method(name, preset, rig, untouched.frame)
        except Exception as error:  # another package's method may raise anything
            fresh.problem = explain(error, f"{name} cannot be set up")
        return fresh

    def _run(self, name: str, entrant: _Entrant, result: Result) -> None:
        if entrant.newest is result.frame:
            return
        entrant.found, entrant.mask = {"note": entrant.problem}, None
        if entrant.find is not None:
            try:
                patch = self._timed(entrant, entrant.find, result.frame)
                entrant.found = _numbers(patch, result)
                entrant.mask = patch.mask
            except TactuneError as error:
                entrant.found = {"note": str(error)}
            except Exception as error:
                entrant.found = {"note": explain(error, f"{name} failed on frame {result.frame_number}")}
        entrant.newest, entrant.warm = result.frame, True

    def _timed(self, entrant: _Entrant, find: Find, frame: SensorFrame) -> ContactPatch:
        """Run a method on a frame and note its time, except that of its first run."""
        averages = entrant.pipeline is not None and entrant.pipeline.preset.averaged_frames > 1
        # A copy, since a pipeline skips steps for a known frame; one that averages must not see a frame twice.
        asked = frame if averages else replace(frame)
        if not entrant.warm and not averages:
            find(replace(frame))
        started = time.perf_counter_ns()
        patch = find(asked)
        if entrant.warm or not averages:
            entrant.times_ms.append((time.perf_counter_ns() - started) / 1e6)
        return patch


def _numbers(patch: ContactPatch, result: Result) -> dict[str, Any]:
    """Return the numbers of a patch as the fields of an `Outcome`."""
    numbers: dict[str, Any] = {
        "points": len(patch.points),
        "area_mm2": patch_area_mm2(patch),
        "averaged": patch.averaged_frames,
        "note": "" if len(patch.points) else "No contact found in this frame",
    }
    if result.frame.truth is not None:
        known = compare_with_truth(patch, result.frame.truth, result.source.rig)
        numbers |= {"rmse_mm": known["rmse_mm"], "iou": known["iou"]}
    return numbers


def _cloud(name: str, mask: BoolArray | None, result: Result, theme: ThemeName) -> DepthCloud:
    """Return a patch over the scene within the range of the depth colours."""
    frame, camera = result.frame, result.source.rig.proximity
    near, far = (limit / camera.depth_unit_m for limit in result.rendered.depth_range_m)
    rows = patch_index(np.zeros(frame.proximity_depth.shape, bool), frame.proximity_depth, near, far)
    rows = np.minimum(rows, np.uint8(HIDDEN_ROW))
    contact = np.zeros(rows.shape, bool) if mask is None else mask
    rows[contact] = CONTACT_ROW
    rgb = method_color(name, theme).getRgb()[:3]
    return DepthCloud(
        depth=frame.proximity_depth,
        depth_unit_m=camera.depth_unit_m,
        rays=ray_table(camera.intrinsics),
        lut=_lut(rgb, theme),
        pose=np.eye(4),
        index=rows,
        depth_range_m=result.rendered.depth_range_m,
        count=int(np.count_nonzero(contact)),
    )
