"""The time strip of the window: its series, cursor and marks, for recordings and live sources."""

from __future__ import annotations

import time
from collections import deque

import numpy as np
from PyQt6.QtCore import QObject, QTimer, pyqtSignal

from ...core.output.markers import Marks
from ...core.preset import Preset
from ...core.sources.registry import opens_by_name
from ...widgets.basics.messages import Severity
from ...widgets.plots.time_strip import CURVES, LIVE_S, TimeStrip
from ..context import SOURCE, Context
from ..worker.results import Result, SourceInfo
from .marks import MarksKeeper
from .series import FrameValues, Series, frame_values
from .series_job import SeriesJob

#: Rest after a change of the preset before its series is computed, in ms: a drag changes it many times.
_REST_MS = 500
#: Interval between updates of a live strip, in ms.
_LIVE_MS = 200
#: Series of presets that are remembered for undo.
_REMEMBERED = 40
#: Fields of a preset that no patch depends on.
_WITHOUT_EFFECT = {"name", "notes", "created", "modified", "cameras", "untouched", "rig"}


class Timeline(QObject):
    """Fills the time strip, and keeps the marks of the open source."""

    availableChanged = pyqtSignal(bool)  # whether the source has frames to mark

    def __init__(self, context: Context, strip: TimeStrip) -> None:
        super().__init__(context)
        self._context, self._strip = context, strip
        self.keeper = MarksKeeper(context.data_folder / "markers", self)
        self.job = SeriesJob(self)
        self._info: SourceInfo | None = None
        self._shown = True
        self._series: Series | None = None
        self._former: Series | None = None
        self._remembered: dict[str, Series] = {}
        self._live: deque[tuple[float, FrameValues]] = deque()
        self._rest = QTimer(self)
        self._rest.setSingleShot(True)
        self._rest.setInterval(_REST_MS)
        self._rest.timeout.connect(self._compute)
        self._scroll = QTimer(self)
        self._scroll.setInterval(_LIVE_MS)
        self._scroll.timeout.connect(self._show_live)
        strip.choose_curve(context.settings.text("view/time_curve"))
        strip.curveChosen.connect(lambda key: context.settings.set("view/time_curve", key))
        strip.hide()
        worker = context.worker
        strip.seekRequested.connect(worker.seek)
        strip.held.connect(worker.set_held)
        worker.opened.connect(self._opened)
        context.frameShown.connect(self._frame_shown)
        context.document.presetChanged.connect(self._preset_changed)
        context.trimChanged.connect(lambda: worker.set_trim(context.trim))
        self.job.found.connect(self._found)
        self.job.ended.connect(strip.set_words)
        self.keeper.changed.connect(self._show_marks)
        self.keeper.failed.connect(
            lambda sentence: context.messages.show_message("markers", Severity.WARNING, sentence, subject=SOURCE)
        )

    @property
    def series(self) -> Series | None:
        """The series of the open recording with the present preset, as far as it is computed."""
        return self._series

    def set_shown(self, shown: bool) -> None:
        """Show the strip, or hide it and compute nothing."""
        self._shown = shown
        self._show_strip()
        if shown:
            self._preset_changed(self._context.document.preset)
        else:
            self.job.stop()

    def close(self) -> None:
        """Stop computing, and wait until the last marker is written."""
        self.job.stop()
        self._rest.stop()
        self._scroll.stop()
        self.keeper.close()

    def mark_in(self) -> None:
        if (index := self._index()) is not None:
            self.keeper.set_in(index)

    def mark_out(self) -> None:
        if (index := self._index()) is not None:
            self.keeper.set_out(index)

    def add_marker(self) -> None:
        """Add a marker at the frame on the screen, or delete the one there."""
        index = self._index()
        if index is not None and self._series is not None:
            self.keeper.toggle(index, float(self._series.seconds()[index]))

    def go_to_marker(self, forward: bool) -> None:
        """Show the next marker's frame, or that of the marker before."""
        index = self._index()
        target = None if index is None else self.keeper.beyond(index, forward)
        if target is not None:
            self._context.worker.seek(target)

    def _index(self) -> int | None:
        """Return the index of the frame on the screen; None for a source without marks."""
        result = self._context.result
        return result.playback.index if result is not None and self._several(result.source) else None

    def _show_marks(self, marks: Marks) -> None:
        self._strip.set_markers([(marker.frame, marker.name) for marker in marks.markers])
        self._strip.set_trim(self.keeper.trim)
        if self._context.trim != self.keeper.trim:
            self._context.trim = self.keeper.trim
            self._context.trimChanged.emit()

    @staticmethod
    def _several(info: SourceInfo) -> bool:
        return info.length is not None and info.length > 1

    def _opened(self, info: SourceInfo) -> None:
        self._info = info
        self.job.stop()  # the file may have been replaced by another of the same name
        self._remembered.clear()
        self._live.clear()
        self._series = self._former = None
        several = self._several(info)
        self.availableChanged.emit(several)
        self._context.messages.clear("markers")
        self._strip.set_words("")
        if several:
            self._preset_changed(self._context.document.preset)
        self.keeper.open(info.name, info.length if several and info.length is not None else 0)
        self._show_strip()

    def _show_strip(self) -> None:
        info = self._info
        live = info is not None and info.length is None
        self._strip.setVisible(self._shown and info is not None and (live or self._several(info)))
        if live and self._shown:
            self._strip.set_words("")
            self._show_live()
            self._scroll.start()
        else:
            self._scroll.stop()

    def _preset_changed(self, preset: Preset) -> None:
        """Show the series of a preset as far as it is known; compute the rest after a moment."""
        info = self._info
        if info is None or info.length is None or not self._several(info):
            return
        series = self._remembered.get(_key(preset))
        if series is None:
            series = Series(info.length, info.frame_rate_hz)
            if self._series is not None:  # stamps do not depend on the preset
                series.values["time_s"][:] = self._series.values["time_s"]
        if series is not self._series:
            if self._series is not None and self._series.complete:
                self._former = self._series
            self._series = series
            self.job.rest()
            self._show_series()
        if series.complete:
            self._rest.stop()
            self._strip.set_words("")
        elif self._shown:
            self._rest.start()

    def _compute(self) -> None:
        if self._info is None or self._series is None or self._series.complete or not self._shown:
            return
        if not opens_by_name(self._info.name):
            self._strip.set_words("This source cannot be opened a second time, so nothing is computed.")
            return
        result = self._context.result
        if result is None or (result.patch is None and not result.problem):
            self._rest.start()  # the contact test is being compiled; the other process would do the same at once
            return
        preset = self._context.document.preset
        if preset.averaged_frames > 1:  # such a preset must see all frames in order
            self._series.computed[:] = False
        self._remembered[_key(preset)] = self._series
        while len(self._remembered) > _REMEMBERED:
            self._remembered.pop(next(iter(self._remembered)))
        self._strip.set_words("Computing…")
        known = frozenset(np.flatnonzero(self._series.computed).tolist())
        self.job.start(self._info.name, len(self._series), preset, known)

    def _found(self, values: list[FrameValues]) -> None:
        if self._series is None:
            return
        for each in values:
            self._series.put(each)
        self._strip.set_words(f"Computing {self._series.computed.mean():.0%}")
        self._show_series()

    def _show_series(self) -> None:
        if (series := self._series) is not None:
            older = None if self._former is None or series.complete else self._former.values
            self._strip.set_series(series.seconds(), series.values, series.computed, older)

    def _frame_shown(self) -> None:
        result = self._context.result
        if result is None or result.source is not self._info:
            return
        if result.source.length is None:
            self._note_live(result)
        else:
            self._strip.set_cursor(result.playback.index)

    def _note_live(self, result: Result) -> None:
        now_s = time.monotonic()
        if result.patch is not None and (not self._live or self._live[-1][1].index != result.frame.sequence):
            self._live.append((now_s, frame_values(result.frame.sequence, result.frame, result.patch)))
        while self._live and now_s - self._live[0][0] > LIVE_S:
            self._live.popleft()

    def _show_live(self) -> None:
        now_s = time.monotonic()
        seconds = np.array([arrived_s - now_s for arrived_s, _ in self._live])
        values = {curve.key: np.array([getattr(each, curve.key) for _, each in self._live]) for curve in CURVES}
        self._strip.set_live(seconds, values)


def _key(preset: Preset) -> str:
    """Return what a preset's patches depend on."""
    return preset.model_dump_json(exclude=_WITHOUT_EFFECT)
