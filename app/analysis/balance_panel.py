"""The part *Balance* of the tab Tilt: a controller levels the simulated tray by the angle of its contact patch."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Final

import pyqtgraph as pg
from PyQt6.QtCore import Qt, QTimer
from PyQt6.QtWidgets import QComboBox, QDoubleSpinBox, QHBoxLayout, QVBoxLayout, QWidget

from ...core.errors import minus
from ...core.estimation.balance import LEVEL_DEG, BalanceLoop, BalanceMethod, BalanceStep, Gains, summarise
from ...core.evaluation.sensor_table import measured_rig
from ...core.sources.presets import load_preset
from ...core.sources.simulator.source import SimulatorSource
from ...core.sources.simulator.tray import BOOKS, DELAY_S, MAX_RATE_DEG_S, SECONDS
from ...widgets.basics.controls import CollapsibleSection, caption, push_button, wrapped_label
from ...widgets.basics.theme import ThemeColors
from ...widgets.plots.plot import Plot
from ..context import Context
from ..worker.jobs import Job, Progress
from ..worker.threads import leave_room_for_the_window

_P_GAIN, _D_GAIN, _METHOD = "balance/p_per_s", "balance/d", "balance/method"
_METHODS: Final[dict[str, BalanceMethod]] = {"Contact patch": "patch", "Proximity camera alone": "proximity"}
_WAITING: Final = "Press Start: the simulator puts books on a tray at 3, 6 and 9 s, and the controller levels it."
#: Time between two redraws, ms.
_REDRAW_MS: Final = 66
#: Height of the plot, px: the plane and the angles over it stay visible in a small window.
_PLOT_HEIGHT: Final = 180
#: Range of the roll axis, degrees.
_SHOWN_DEG: Final = 8.0
_PATCH_RGB: Final = (0, 158, 115)
_PROXIMITY_RGB: Final = (213, 94, 0)


@dataclass
class _Run:
    """What the thread of one run and the window share; each field is written by one of them only."""

    method: BalanceMethod
    gains: Gains
    steps: deque[BalanceStep] = field(default_factory=deque)

    def work(self, progress: Progress) -> None:
        """Balance at the frame rate of the cameras, or as fast as this computer can."""
        leave_room_for_the_window()
        with SimulatorSource("tray", progress=progress) as source:
            progress(0.0, "Measuring the noise of both cameras")
            loop = BalanceLoop(source, measured_rig(load_preset("simulator"), source), self.method)
            due = time.monotonic()
            for _ in range(round(SECONDS * source.frame_rate_hz)):
                loop.gains = self.gains
                self.steps.append(loop.step())
                progress(0.0, "")
                due = max(due + 1.0 / source.frame_rate_hz, time.monotonic())
                time.sleep(due - time.monotonic() if due > time.monotonic() else 0.0)


class BalancePanel(CollapsibleSection):
    """Start and stop, the gains, and the tray's true and measured roll over time; folded at first."""

    def __init__(self, context: Context) -> None:
        super().__init__("Balance")
        self.button.setToolTip("A controller levels a simulated tray by the tilt of its patch. Fold or unfold")
        self._settings = context.settings
        self._run: _Run | None = None
        self.steps: list[BalanceStep] = []
        self.start = push_button("&Start balancing", "Balance the simulated tray for 12 s; press again to stop")
        usual = Gains()
        self.p_gain = _gain(
            "P gain",
            "Rate at which the sensor turns, per roll of the tray, in 1/s. Larger: levels faster, and overshoots "
            f"because the actuator is {1e3 * DELAY_S:.0f} ms late",
            (0.0, 50.0, 0.5),
            " 1/s",
            self._settings.number(_P_GAIN, usual.p_per_s),
        )
        self.d_gain = _gain(
            "D gain",
            "Rate at which the sensor turns, per rate of the tray, without unit. Larger: damps more, and passes on "
            "more noise",
            (0.0, 5.0, 0.05),
            "",
            self._settings.number(_D_GAIN, usual.d),
        )
        self.method = QComboBox()
        self.method.addItems(list(_METHODS))
        self.method.setCurrentText(self._settings.text(_METHOD, next(iter(_METHODS))))
        self.method.setAccessibleName("Angle from")
        self.method.setToolTip("The angle that controls. The other one is measured and drawn as well")
        self.defaults = push_button("Defaul&ts", f"Set the gains to {usual.p_per_s:g} 1/s and {usual.d:g}")
        self.curves = BalancePlot()
        self.status = wrapped_label(_WAITING, selectable=True)
        self._job = Job(self)
        self._timer = QTimer(self)
        self._timer.setInterval(_REDRAW_MS)
        self._lay_out()
        self._connect()
        self.set_collapsed(True)

    def shut_down(self) -> None:
        """Stop the thread, for good."""
        self._timer.stop()
        self._job.stop()

    def _lay_out(self) -> None:
        row = QHBoxLayout()
        row.addWidget(self.start)
        for text, entry in (("&P", self.p_gain), ("&D", self.d_gain), ("An&gle from", self.method)):
            row.addSpacing(8)
            row.addWidget(caption(text, entry))
            row.addWidget(entry)
        row.addWidget(self.defaults)
        row.addStretch(1)
        layout = QVBoxLayout(self.body)
        layout.setContentsMargins(4, 4, 4, 4)
        layout.addLayout(row)
        layout.addWidget(self.curves)
        layout.addWidget(self.status)

    def _connect(self) -> None:
        self.start.clicked.connect(self._start_or_stop)
        self.defaults.clicked.connect(self._reset_gains)
        self.p_gain.valueChanged.connect(self._gains_changed)
        self.d_gain.valueChanged.connect(self._gains_changed)
        self.method.currentTextChanged.connect(lambda text: self._settings.set(_METHOD, text))
        self._timer.timeout.connect(self._redraw)
        self._job.busyChanged.connect(self._show_busy)
        self._job.progress.connect(lambda _, words: self.status.setText(f"{words}…") if words else None)
        self._job.done.connect(lambda _: self._ended(""))
        self._job.failed.connect(self._ended)

    def _start_or_stop(self) -> None:
        if self._job.busy:
            self._job.cancel()
            return
        self.steps = []
        self.curves.show_steps([])
        self._run = _Run(_METHODS[self.method.currentText()], self._gains())
        self._job.start(self._run.work)

    def _show_busy(self, busy: bool) -> None:
        self.start.setText("&Stop" if busy else "&Start balancing")
        self.method.setEnabled(not busy)
        if busy:
            self._timer.start()
        else:
            self._timer.stop()

    def _gains(self) -> Gains:
        return Gains(self.p_gain.value(), self.d_gain.value())

    def _gains_changed(self) -> None:
        gains = self._gains()
        self._settings.set(_P_GAIN, gains.p_per_s)
        self._settings.set(_D_GAIN, gains.d)
        if self._run is not None:
            self._run.gains = gains

    def _reset_gains(self) -> None:
        usual = Gains()
        self.p_gain.setValue(usual.p_per_s)
        self.d_gain.setValue(usual.d)

    def _redraw(self) -> None:
        """Take the newest steps of the thread."""
        if self._run is None or not self._run.steps:
            return
        while self._run.steps:
            self.steps.append(self._run.steps.popleft())
        self.curves.show_steps(self.steps)
        last = self.steps[-1]
        measured = "no angle" if last.measured_rad is None else f"measured {_degrees(last.measured_rad)}"
        self.status.setText(
            f"{last.time_s:.1f} s: tray {_degrees(last.roll_rad)}, {measured}, sensor turned "
            f"{_degrees(last.sensor_rad)}; {1e3 * last.latency_s:.0f} ms from frame to angle"
        )

    def _ended(self, problem: str) -> None:
        self._redraw()
        if problem:
            self.status.setText(problem)
        elif self.steps:
            self.status.setText(_summary(self.steps))
        else:
            self.status.setText(_WAITING)


class BalancePlot(QWidget):
    """The tray's roll over the ground: true, from the patch, from the proximity camera alone."""

    def __init__(self) -> None:
        super().__init__()
        self.plot = Plot("Time, s", "Roll, °")
        self.plot.setFixedHeight(_PLOT_HEIGHT)
        self.plot.setAccessibleName("Roll of the tray over time")
        self.plot.setToolTip(
            "Roll of the tray over the ground against time: true, from the contact patch, and from the proximity "
            "camera alone. Vertical lines: a book is put on. The tray counts as level between the dotted lines, "
            f"±{LEVEL_DEG:g}°"
        )
        item = self.plot.getPlotItem()
        item.setXRange(0.0, SECONDS, padding=0.01)
        item.setYRange(-_SHOWN_DEG, _SHOWN_DEG, padding=0.0)
        self._limits = [pg.InfiniteLine(sign * LEVEL_DEG, angle=0) for sign in (-1, 1)]
        self._books = [
            pg.InfiniteLine(book.time_s, angle=90, label=f"{1e3 * book.mass_kg:.0f} g", labelOpts={"position": 0.06})
            for book in BOOKS
        ]
        for line in (*self._limits, *self._books):
            item.addItem(line)
        self.plot.add_legend(3)
        self._proximity = item.plot(name="proximity alone", connect="finite")
        self._patch = item.plot(name="patch", connect="finite")
        self._true = item.plot(name="true")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.plot)
        self.plot.follow_theme(self._recolor)

    def show_steps(self, steps: list[BalanceStep]) -> None:
        """Draw a run."""
        times = [step.time_s for step in steps]
        self._true.setData(times, [math.degrees(step.roll_rad) for step in steps])
        for curve, name in ((self._patch, "patch"), (self._proximity, "proximity")):
            rolls = [(getattr(step, name).roll_rad, step.sensor_rad) for step in steps]
            curve.setData(times, [math.nan if roll is None else math.degrees(roll + turn) for roll, turn in rolls])

    def _recolor(self, colors: ThemeColors) -> None:
        self._true.setPen(pg.mkPen(colors.text, width=2))
        self._patch.setPen(pg.mkPen(_PATCH_RGB, width=1.5))
        self._proximity.setPen(pg.mkPen(_PROXIMITY_RGB, width=1))
        for line in self._limits:
            line.setPen(pg.mkPen(colors.muted, style=Qt.PenStyle.DotLine))
        for line in self._books:
            line.setPen(pg.mkPen(colors.muted, style=Qt.PenStyle.DashLine))
            line.label.setColor(colors.text)


def _degrees(radians: float) -> str:
    return minus(f"{math.degrees(radians):+z.1f}°")


def _gain(name: str, tip: str, limits: tuple[float, float, float], suffix: str, value: float) -> QDoubleSpinBox:
    box = QDoubleSpinBox()
    low, high, step = limits
    box.setRange(low, high)
    box.setSingleStep(step)
    box.setDecimals(2)
    box.setSuffix(suffix)
    box.setKeyboardTracking(False)
    box.setValue(value)
    box.setAccessibleName(name)
    box.setToolTip(f"{tip}. The actuator turns at most {MAX_RATE_DEG_S:g} degrees per second")
    return box


def _summary(steps: list[BalanceStep]) -> str:
    found = summarise(steps)
    settled = ", ".join("never" if each is None else f"{each:.2f} s" for each in found.settle_s)
    return (
        f"{f'Level after {settled}' if settled else 'No book yet'}. "
        f"RMS error of the angle: patch {found.patch.rms_deg:.2f}°, proximity alone "
        f"{found.proximity.rms_deg:.2f}° ({found.rms_factor:.1f} times). From frame to angle "
        f"{found.latency_median_ms:.0f} ms, 95 % below {found.latency_p95_ms:.0f} ms."
    )
