"""The delay between both cameras, measured from motion that both see, and its compensation."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import QEvent, Qt, QTimer, pyqtSignal
from PyQt6.QtWidgets import QDoubleSpinBox, QHBoxLayout, QLabel, QVBoxLayout, QWidget

from ...core.model.arrays import Float64Array
from ...core.rig.skew import MAX_GAP_S, MIN_TIME_S, MotionSeries, Sample, Skew, measure_skew
from ...widgets.basics.controls import ProgressBar, make_verdict, push_button
from ...widgets.basics.theme import theme_colors
from ..document.document import Document
from ..worker.jobs import Job
from ..worker.results import Result, SourceInfo
from ..worker.worker import Worker

DELAY_PATH = "cameras.tactile_delay_s"
_START_TIME_S, _LONGEST_TIME_S = 6.0, 30.0
_GATHERING_SHARE = 0.8
#: Seconds without a frame after which a source counts as stopped.
PATIENCE_S = 5.0
_TICK_MS = 100
_INTRO = (
    "Press an object into the membrane and pull it out, several times, a few centimetres deep and irregularly. "
    "Both cameras see this motion. The delay at which they agree best is their skew, independent of their time stamps."
)
_NO_FRAME = "There is no frame yet: open a source in the main window first."
_NO_MORE_FRAMES = "No more frames arrive: play the source, in a loop if it is a recording, and measure again."
#: A second colour that is readable in both themes.
_TACTILE_HUE = "#d9730d"


class SkewTab(QWidget):
    """Collects frames of the main window for some seconds, measures on another thread, and shows curve and result."""

    _watchingFailed = pyqtSignal(str)

    def __init__(self, worker: Worker, document: Document) -> None:
        super().__init__()
        self._worker, self._document = worker, document
        self._result: Result | None = None
        self._info: SourceInfo | None = None
        self._gathering = False
        self._samples: list[Sample] = []
        self._counted, self._last_frame_s = 0, 0.0
        self.skew: Skew | None = None
        self._job = Job(self)
        self._timer = QTimer(self)
        self._timer.setInterval(_TICK_MS)
        self._timer.timeout.connect(self._look)
        self.seconds = QDoubleSpinBox()
        self.start = push_button("Measure skew", "Observe the motion and measure the delay (Ctrl+M)", shortcut="Ctrl+M")
        self.cancel = push_button("Cancel", "Cancel this measurement")
        self.progress = ProgressBar()
        self.sentence = QLabel()
        self.compensate = push_button("Compensate", "Save the delay in the preset; Ctrl+Z in the main window undoes it")
        self.curve = pg.PlotWidget()
        self.motion = pg.PlotWidget()
        self._lay_out()
        self.start.clicked.connect(self.begin)
        self.cancel.clicked.connect(self.stop)
        self.compensate.clicked.connect(self._compensate)
        self._job.progress.connect(
            lambda share, words: self.progress.show_share(_GATHERING_SHARE + (1 - _GATHERING_SHARE) * share, words)
        )
        self._job.done.connect(self._done)
        self._job.failed.connect(self._fail)
        self._watchingFailed.connect(self._give_up)
        self._show_busy(False)
        self._recolor()
        self._draw()

    @property
    def busy(self) -> bool:
        """Whether a measurement is running."""
        return self._gathering or self._job.busy

    def show_result(self, result: Result) -> None:
        """Note the source of a frame of the main window. The worker passes all frames on."""
        self._result = result
        if result.source is not self._info:
            self._give_up("Another source was opened meanwhile: measure again.")

    def begin(self) -> None:
        """Start collecting frames."""
        if self.busy:
            return
        if self._result is None:
            self._fail(_NO_FRAME)
            return
        if self._result.source.length == 1:
            self._fail("This source has a single frame; the delay can be measured from motion only.")
            return
        self._info = self._result.source
        samples: list[Sample] = []
        self._samples, self._counted = samples, 0
        self._last_frame_s = time.monotonic()
        self._forget()
        self._show_busy(True)
        # also frames that the window drops
        self._worker.recorder.watch(lambda frame: samples.append(Sample.of(frame)), self._watchingFailed.emit)
        self._gathering = True
        self._timer.start()
        if not self._result.playback.running:
            self._worker.play()

    def stop(self) -> None:
        """Cancel the measurement."""
        self._stop_gathering()
        self._job.cancel()
        if not self._job.busy:
            self._show_busy(False)

    def close_down(self) -> None:
        """Cancel permanently and wait for the thread."""
        self._stop_gathering()
        self._job.stop()
        self._show_busy(False)

    def _stop_gathering(self) -> None:
        if self._gathering:
            self._gathering = False
            self._timer.stop()
            self._worker.recorder.unwatch()

    def _give_up(self, sentence: str) -> None:
        if self._gathering:
            self.stop()
            self._fail(sentence)

    def _look(self) -> None:
        """Check the progress."""
        now = time.monotonic()
        if len(self._samples) > self._counted:
            self._counted, self._last_frame_s = len(self._samples), now
        share = min(watched_s(self._samples) / self.seconds.value(), 1.0)
        self.progress.show_share(_GATHERING_SHARE * share, f"Press in and pull out now: {self._counted} frames")
        if now - self._last_frame_s > PATIENCE_S:
            self._give_up(_NO_MORE_FRAMES)
        elif share == 1.0:
            self._measure()

    def _lay_out(self) -> None:
        intro = QLabel(_INTRO)
        intro.setWordWrap(True)
        self.seconds.setRange(MIN_TIME_S, _LONGEST_TIME_S)
        self.seconds.setValue(_START_TIME_S)
        self.seconds.setDecimals(0)
        self.seconds.setSuffix(" s")
        self.seconds.setAccessibleName("Duration")
        self.seconds.setToolTip("Duration of the measurement in seconds; longer is more accurate")
        policy = self.progress.sizePolicy()
        policy.setRetainSizeWhenHidden(True)  # so that the layout does not jump
        self.progress.setSizePolicy(policy)
        make_verdict(self.sentence)
        self.sentence.setWordWrap(True)
        self.sentence.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        row = QHBoxLayout()
        for widget in (QLabel("Watch for"), self.seconds, self.start, self.cancel):
            row.addWidget(widget)
        row.addWidget(self.progress, 1)
        result = QHBoxLayout()
        result.addWidget(self.sentence, 1)
        result.addWidget(self.compensate)
        layout = QVBoxLayout(self)
        layout.addWidget(intro)
        layout.addLayout(row)
        layout.addLayout(result)
        layout.addWidget(self.curve, 100)
        layout.addWidget(self.motion, 100)
        layout.addStretch(1)
        for plot, bottom, left in (
            (self.curve, "Delay of the tactile camera, ms", "Correlation"),
            (self.motion, "Time, s (tactile moved by the delay)", "Pressed in, mm"),
        ):
            plot.setMenuEnabled(False)
            plot.hideButtons()
            for axis, text in (("bottom", bottom), ("left", left)):
                plot.getAxis(axis).enableAutoSIPrefix(False)
                plot.setLabel(axis, text)
            plot.getPlotItem().showGrid(x=True, y=True, alpha=0.2)
            plot.setAccessibleName(bottom)
        self.motion.addLegend(offset=(-10, 10))

    def _measure(self) -> None:
        self._stop_gathering()
        assert self._info is not None
        self._job.start(partial(measure_skew, tuple(self._samples), self._info.rig, self._document.preset.alignment))

    def _done(self, skew: Skew) -> None:
        self.skew = skew
        self._show_busy(False)
        self.sentence.setText(skew.sentence)
        self._draw()
        delay = self._new_delay_s()
        self.compensate.setText(f"Set the tactile delay to {1e3 * delay:.1f} ms")
        self.compensate.setVisible(not skew.agrees and delay != self._document.preset.cameras.tactile_delay_s)

    def _fail(self, sentence: str) -> None:
        self._show_busy(False)
        if sentence:
            self.sentence.setText(f"{sentence[0].upper()}{sentence[1:]}")

    def _new_delay_s(self) -> float:
        """Return the delay for the preset. Live time stamps are already corrected by the current one."""
        assert self.skew is not None
        present = self._document.preset.cameras.tactile_delay_s
        live = self._info is not None and self._info.length is None
        return round(self.skew.delay_s + (present if live else 0.0), 4)

    def _compensate(self) -> None:
        delay = self._new_delay_s()
        if self._document.edit(DELAY_PATH, delay):
            self.compensate.hide()
            self.sentence.setText(
                f"The preset's tactile delay is {1e3 * delay:.1f} ms now. It takes effect when the cameras are "
                "opened again; Ctrl+Z in the main window undoes it."
            )

    def _forget(self) -> None:
        self.skew = None
        self.sentence.clear()
        self.compensate.hide()
        self._draw()

    def _draw(self) -> None:
        """Plot the curve and both series."""
        self.curve.clear()
        self.motion.clear()
        skew = self.skew
        for plot in (self.curve, self.motion):
            plot.setVisible(skew is not None)
        if skew is None:
            return
        accent = theme_colors().accent_text
        known = np.isfinite(skew.correlations)
        self.curve.plot(1e3 * skew.delays_s[known], skew.correlations[known], pen=pg.mkPen(accent, width=2))
        text = theme_colors().text
        line = pg.InfiniteLine(1e3 * skew.delay_s, pen=pg.mkPen(text, style=Qt.PenStyle.DashLine))
        self.curve.addItem(line)
        start = float(skew.proximity.time_s[0])
        for name, series, hue, shift in (
            ("proximity camera", skew.proximity, accent, 0.0),
            ("tactile camera", skew.tactile, _TACTILE_HUE, skew.delay_s),
        ):
            x, y = _lines(series, start + shift)
            self.motion.plot(x, y, pen=pg.mkPen(hue, width=2), name=name, connect="finite")

    def _show_busy(self, busy: bool) -> None:
        self.start.setEnabled(not busy)
        self.seconds.setEnabled(not busy)
        self.cancel.setEnabled(busy)
        self.progress.setVisible(busy)
        if self.skew is None:
            self.compensate.hide()

    def changeEvent(self, event: QEvent | None) -> None:
        """Follow the theme."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.PaletteChange and hasattr(self, "motion"):
            self._recolor()
            self._draw()

    def _recolor(self) -> None:
        colors = theme_colors()
        for plot in (self.curve, self.motion):
            plot.setBackground(colors.base)
            for side in ("bottom", "left"):
                axis = plot.getAxis(side)
                axis.setPen(colors.muted)
                axis.setTextPen(colors.text)
        self.motion.getPlotItem().legend.setLabelTextColor(colors.text)


def watched_s(samples: Sequence[Sample]) -> float:
    """Return the time that the frames cover according to their own stamps, seconds."""
    steps = np.diff([sample.proximity_time_s for sample in samples])
    return float(steps[(steps > 0) & (steps <= MAX_GAP_S)].sum())


def _lines(series: MotionSeries, origin_s: float) -> tuple[Float64Array, Float64Array]:
    """Return times in seconds and depths in millimetres, with nan where time runs backwards."""
    time_s, depth_mm = series.time_s - origin_s, 1e3 * series.depth_m
    breaks = np.flatnonzero(np.diff(time_s) <= 0) + 1
    return np.insert(time_s, breaks, np.nan), np.insert(depth_mm, breaks, np.nan)
