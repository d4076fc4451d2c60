"""The delay between both cameras, measured from motion that both see, and its compensation."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QDoubleSpinBox, QLabel

from ...core.errors import counted
from ...core.model.arrays import Float64Array
from ...core.rig.skew import MAX_GAP_S, MIN_TIME_S, MotionSeries, Sample, Skew, measure_skew
from ...widgets.basics.controls import make_verdict, push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.basics.theme import theme_colors
from ...widgets.plots.plot import Plot
from ..document.document import Document
from ..worker.results import Result
from ..worker.worker import Worker
from .gathering import NO_FRAME, OTHER_SOURCE, GatheringTab

DELAY_PATH = "cameras.tactile_delay_s"
_START_TIME_S, _LONGEST_TIME_S = 6.0, 30.0
_INTRO = (
    "Press an object into the membrane and pull it out, several times, a few centimetres deep and irregularly. "
    "Both cameras see this motion. The delay at which they agree best is their skew, independent of their time stamps."
)
#: A second colour that is readable in both themes.
_TACTILE_HUE = "#d9730d"


class SkewTab(GatheringTab):
    """Measures frames of the main window over some seconds, and shows curve and result."""

    def __init__(self, worker: Worker, document: Document) -> None:
        self.seconds = QDoubleSpinBox()
        start = push_button("Measure skew", "Observe the motion and measure the delay (Ctrl+M)", shortcut="Ctrl+M")
        cancel = push_button("Cancel", "Cancel this measurement")
        super().__init__(worker, document, start, cancel, self.seconds, gathered_share=0.8)
        self._samples: list[Sample] = []
        self.skew: Skew | None = None
        self.compensate = push_button("Compensate", "Save the delay in the preset; Ctrl+Z in the main window undoes it")
        self.curve = Plot("Delay of the tactile camera, ms", "Correlation", movable=True)
        self.motion = Plot("Time, s (tactile moved by the delay)", "Pressed in, mm", movable=True)
        self._lay_out()
        self.compensate.clicked.connect(self._compensate)
        self._show_busy(False)
        self.curve.follow_theme()
        self.motion.follow_theme(lambda _colors: self._draw())

    def show_result(self, result: Result) -> None:
        """Note the source of a frame of the main window. The worker passes all frames on."""
        self._result = result
        if result.source is not self._info:
            self._give_up(OTHER_SOURCE)

    def begin(self) -> None:
        """Start collecting frames."""
        if self.busy:
            return
        if self._result is None:
            self._fail(NO_FRAME)
            return
        if self._result.source.length == 1:
            self._fail("This source has a single frame; the delay can be measured from motion only.")
            return
        self._info = self._result.source
        samples: list[Sample] = []
        self._samples, self.skew = samples, None
        self.sentence.clear()
        self._draw()
        self._gather(lambda frame: samples.append(Sample.of(frame)))

    def _gathered(self) -> tuple[int, float, str]:
        count, share = len(self._samples), watched_s(self._samples) / self.seconds.value()
        return count, share, f"Press in and pull out now: {counted(count, 'frame')}"

    def _lay_out(self) -> None:
        intro = wrapped_label(_INTRO)
        self.seconds.setRange(MIN_TIME_S, _LONGEST_TIME_S)
        self.seconds.setValue(_START_TIME_S)
        self.seconds.setDecimals(0)
        self.seconds.setSuffix(" s")
        self.seconds.setAccessibleName("Duration")
        self.seconds.setToolTip("Duration of the measurement in seconds; longer is more accurate")
        make_verdict(self.sentence)
        self.sentence.setWordWrap(True)
        self.sentence.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        result = hbox((self.sentence, 1), self.compensate)
        row = self._row(QLabel("Watch for"))
        vbox(intro, row, result, (self.curve, 100), (self.motion, 100), STRETCH, within=self)
        for plot, name in ((self.curve, "Correlation against delay"), (self.motion, "Motion of both cameras")):
            plot.getPlotItem().showGrid(x=True, y=True, alpha=0.2)
            plot.setAccessibleName(name)
        self.motion.add_legend(2)

    def _measure(self) -> None:
        assert self._info is not None
        self._job.start(partial(measure_skew, tuple(self._samples), self._info.rig, self._document.preset.alignment))

    def _done(self, skew: Skew) -> None:
        self.skew = skew
        self._show_busy(False)
        self.sentence.setText(skew.sentence)
        self._draw()
        delay = self._new_delay_s()
        self.compensate.setText(f"Set the tactile delay to {1e3 * delay:.1f} ms")
        self.compensate.setVisible(skew.significant and delay != self._document.preset.cameras.tactile_delay_s)

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
        super()._show_busy(busy)
        if self.skew is None:
            self.compensate.hide()


def watched_s(samples: Sequence[Sample]) -> float:
    """Return the time that the frames cover according to their own stamps, seconds."""
    steps = np.diff([sample.proximity_time_s for sample in samples])
    return float(steps[(steps > 0) & (steps <= MAX_GAP_S)].sum())


def _lines(series: MotionSeries, origin_s: float) -> tuple[Float64Array, Float64Array]:
    """Return times in seconds and depths in millimetres, with nan where time runs backwards."""
    time_s, depth_mm = series.time_s - origin_s, 1e3 * series.depth_m
    breaks = np.flatnonzero(np.diff(time_s) <= 0) + 1
    return np.insert(time_s, breaks, np.nan), np.insert(depth_mm, breaks, np.nan)
