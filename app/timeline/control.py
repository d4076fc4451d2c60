"""The time strip of the window: its series, cursor and in and out marks, for recordings and live sources."""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.preset import Preset
from ...core.sources.registry import opens_by_name
from ...widgets.basics.controls import timer
from ...widgets.plots.time_strip import CURVES, LIVE_S, STALL_FACTOR, STALL_S, TimeStrip
from ..context import Context
from ..worker.results import Pace, SourceInfo
from .series import Answer, FrameValues, Order, Series, frame_values, serve_series

#: Rest after a change of the preset before its series is computed, in ms: a drag changes it many times.
_REST_MS = 500
#: Interval between movements of the cursor while frames play, seconds.
_CURSOR_S = 0.1
#: Interval between updates of a live strip, in ms.
_LIVE_MS = 200
#: Interval at which the answers of the process are looked for, in ms; longest wait for it to end, in s.
_LOOK_MS, _ENDING_S = 100, 2.0
#: Fields of a preset that no patch depends on.
_WITHOUT_EFFECT = {"name", "notes", "created", "modified", "cameras", "untouched", "rig"}


class Timeline(QObject):
    """Fills the time strip, and sets the in and out marks of the open recording."""

    availableChanged = pyqtSignal(bool)  # whether the source has frames to mark

    def __init__(self, context: Context, strip: TimeStrip) -> None:
        super().__init__(context)
        self._context, self._strip = context, strip
        self.job = SeriesJob(self)
        self._info: SourceInfo | None = None
        #: The series of the open recording with the present preset, as far as it is computed.
        self.series: Series | None = None
        self._series_of = ""
        self._live: deque[tuple[float, FrameValues]] = deque()
        self._rest = timer(self, _REST_MS, self._compute, once=True)
        self._pace = Pace(_CURSOR_S)
        self._scroll = timer(self, _LIVE_MS, self._show_live)
        strip.choose_curve(context.settings.text("view/time_curve"))
        strip.curveChosen.connect(lambda key: context.settings.set("view/time_curve", key))
        worker = context.worker
        strip.seekRequested.connect(worker.seek)
        strip.held.connect(worker.set_held)
        worker.opened.connect(self._opened)
        context.frameShown.connect(self._frame_shown)
        context.document.presetChanged.connect(self._preset_changed)
        self.job.found.connect(self._found)
        self.job.ended.connect(strip.set_words)

    def close(self) -> None:
        self.job.stop()
        self._rest.stop()
        self._scroll.stop()

    def mark_in(self) -> None:
        """Mark the first frame of a part; an out mark before it goes."""
        result = self._context.result
        if result is not None and (length := result.source.length) is not None:
            index, (_, end) = result.frame_number, self._context.trim or (0, length)
            self._set_trim((index, end if end > index else length))

    def mark_out(self) -> None:
        """Mark the last frame of a part; an in mark behind it goes."""
        result = self._context.result
        if result is not None and result.source.length is not None:
            index, (first, _) = result.frame_number, self._context.trim or (0, 0)
            self._set_trim((first if first <= index else 0, index + 1))

    def clear_marks(self) -> None:
        self._set_trim(None)

    def _set_trim(self, trim: tuple[int, int] | None) -> None:
        self._context.trim = trim
        self._strip.set_trim(trim)

    def _opened(self, info: SourceInfo) -> None:
        self._info = info
        if info.length == 1:
            self._strip.set_series(np.zeros(1), {}, np.zeros(1, np.bool_))
        self.job.stop()  # the file may have been replaced by another of the same name
        self._live.clear()
        self.series = None
        self.availableChanged.emit((info.length or 0) > 1)
        self._strip.set_words("")
        self._preset_changed(self._context.document.preset)
        self.clear_marks()
        if info.length is None:
            self._show_live()
            self._scroll.start()
        else:
            self._scroll.stop()

    def _preset_changed(self, preset: Preset) -> None:
        """Begin an empty series, unless the present one holds for the preset too; compute it after a moment."""
        info = self._info
        if info is None or info.length is None or info.length < 2:
            return
        depends_on = preset.model_dump_json(exclude=_WITHOUT_EFFECT)
        if self.series is None or depends_on != self._series_of:
            self.series, self._series_of = Series(info.length, info.frame_rate_hz, info.times_s), depends_on
            self.job.rest()
            self._show_series()
        if not self.series.complete:
            self._rest.start()

    def _compute(self) -> None:
        if self._info is None or self.series is None or self.series.complete:
            return
        if not opens_by_name(self._info.name):
            self._strip.set_words("This source cannot be opened a second time, so nothing is computed.")
            return
        result = self._context.result
        if result is None or (result.patch is None and not result.problem):
            self._rest.start()  # the contact test is being compiled; the other process would do the same at once
            return
        self._strip.set_words("Computing…")
        document = self._context.document
        self.job.start(self._info.name, len(self.series), document.preset, document.untouched_home)

    def _found(self, values: list[FrameValues]) -> None:
        if self.series is None:
            return
        for each in values:
            self.series.put(each)
        self._strip.set_words(f"Computing {100 * self.series.computed.mean():.0f} %")
        self._show_series()

    def _show_series(self) -> None:
        if (series := self.series) is not None:
            self._strip.set_series(series.seconds, series.values, series.computed)

    def _frame_shown(self) -> None:
        result = self._context.result
        if result is None or result.source is not self._info:
            return
        if result.source.length is not None:
            if self._pace.due(result):
                self._strip.set_cursor(result.frame_number)
            return
        now_s = time.monotonic()
        if result.patch is not None and (not self._live or self._live[-1][1].index != result.frame.sequence):
            self._live.append((now_s, frame_values(result.frame.sequence, result.frame, result.patch)))
        while self._live and now_s - self._live[0][0] > LIVE_S:
            self._live.popleft()

    def _show_live(self) -> None:
        now_s = time.monotonic()
        seconds = np.array([arrived_s - now_s for arrived_s, _ in self._live])
        values = {curve.key: np.array([getattr(each, curve.key) for _, each in self._live], float) for curve in CURVES}
        steps = np.diff(seconds)
        stalls = steps > max(STALL_S, STALL_FACTOR * float(np.quantile(steps, 0.25))) if len(steps) else steps > 0
        for column in values.values():
            column[1:][stalls] = np.nan  # no line over a time without frames
        self._strip.set_live(seconds, values)


class SeriesJob(QObject):
    """Computes a series in a process of low priority, which stays for the next preset, with its source open."""

    found = pyqtSignal(object)  # list of FrameValues
    ended = pyqtSignal(str)  # empty where the series is complete, else the problem

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        #: The process; None before the first series.
        self.process: BaseProcess | None = None
        self._orders: Connection | None = None
        self._number = 0
        self._timer = timer(self, _LOOK_MS, self._look)

    def start(self, source: str, length: int, preset: Preset, home: Path | None = None) -> None:
        """Compute the series of ``length`` frames, with the untouched frame beside ``home``; ends the one before."""
        self._number += 1
        if self._orders is None:
            self._start_process()
        assert self._orders is not None
        with suppress(OSError):  # the process has died: `_look` says so
            self._orders.send(Order(self._number, source, length, preset, home))
        self._timer.start()

    def rest(self) -> None:
        """Stop computing; the process stays."""
        if self._timer.isActive() and self._orders is not None:
            self._timer.stop()
            with suppress(OSError):
                self._orders.send(None)

    def stop(self) -> None:
        self._timer.stop()
        if self._orders is not None and self.process is not None:
            self._orders.close()
            self.process.kill()
            self.process.join(_ENDING_S)
        self._orders = self.process = None

    def _start_process(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._orders, other = context.Pipe()
        self.process = context.Process(target=serve_series, args=(other,), name="time strip", daemon=True)
        # A Ctrl+C while it still imports would end it with a traceback; it inherits that they are held back.
        usual = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, usual)
        other.close()

    def _look(self) -> None:
        try:
            while self._timer.isActive() and self._orders is not None and self._orders.poll():
                answer: Answer = self._orders.recv()
                if answer.number != self._number:
                    continue
                if answer.values:
                    self.found.emit(answer.values)
                if answer.problem is not None:
                    self._timer.stop()
                    self.ended.emit(answer.problem)
        except (EOFError, OSError):
            self.stop()
            self.ended.emit("The process that computes the time strip has ended; change the preset to start it again.")
