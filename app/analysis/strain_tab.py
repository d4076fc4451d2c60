"""The tab Membrane strain: strain map, largest strains, and strain against displacement."""

from __future__ import annotations

from collections import deque
from functools import partial
from pathlib import Path

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QComboBox,
    QDoubleSpinBox,
    QHBoxLayout,
    QLabel,
    QWidget,
)

from ...core.errors import counted
from ...core.evaluation.strain.strain import SPACING_M, SPACING_RANGE_M
from ...core.model.frames import SensorFrame
from ...widgets.basics.controls import caption, frame_count, push_button
from ...widgets.basics.layouts import STRETCH, hbox, splitter, vbox
from ...widgets.basics.messages import Severity
from ..context import Context
from ..worker.jobs import Job
from ..worker.results import Result, SourceInfo
from .measuring_tab import MeasuringTab
from .strain_views import StrainCurve, StrainMap, StrainNumbers
from .strain_work import MapOf, StrainTask, StrainView, examine

_SPACING, _AVERAGE, _MAP = "strain/spacing_mm", "strain/average", "strain/map"
_MAX_AVERAGED = 30
_WAITING = "Waiting for a frame: open a source in the main window, such as sim:cup?grid=dots."
_FIRST = "Measuring the first frame…"
_NO_UNTOUCHED = (
    "No displacement: the untouched membrane is not known. Show it without contact, then press “Take as untouched”."
)
_FILTERS = ["PNG picture, CSV beside it (*.png)", "Curve only (*.csv)"]


class StrainTab(MeasuringTab):
    """Measures the newest frame on another thread, as often as possible.

    Signals
    -------
    shown(StrainView)
    """

    shown = pyqtSignal(object)

    def __init__(self, context: Context) -> None:
        super().__init__(context, _WAITING)
        self._source: SourceInfo | None = None
        self._frames: deque[SensorFrame] = deque(maxlen=_MAX_AVERAGED)
        self._captured: SensorFrame | None = None
        self._last: SensorFrame | None = None
        self.view: StrainView | None = None
        self.map, self.curve, self.numbers = StrainMap(), StrainCurve(), StrainNumbers()
        self.spacing, self.map_of = QDoubleSpinBox(), QComboBox()
        self.average = frame_count(
            _MAX_AVERAGED,
            "Number of recent frames to average while the membrane does not move. "
            "10 is more accurate at steep places; 1 follows a moving press",
            round(context.settings.number(_AVERAGE, 1)),
        )
        self.capture = push_button(
            "Take as &untouched",
            "Measure displacement from the current membrane; press it while nothing touches the membrane",
        )
        self.reset = push_button("&Reset curve", "Start a new curve; the old one can be restored")
        self.pointed = QLabel(" ")
        self._job = Job(self)
        self._set_up_entries()
        self._lay_out()
        self._connect()
        self.map.show_view(None, MapOf.LARGEST, _WAITING)

    # What the window calls

    def show_result(self, result: Result) -> None:
        """Measure this frame next."""
        if result.source is not self._source:
            self._begin(result.source)
        self._result = result
        if not self._frames or result.frame is not self._frames[-1]:
            self._frames.append(result.frame)
        self.untouched.look(result)
        self._measure()

    def shut_down(self) -> None:
        """Stop all threads, for good."""
        super().shut_down()
        self._job.stop()

    # Building

    def _set_up_entries(self) -> None:
        low, high = (1e3 * end for end in SPACING_RANGE_M)
        self.spacing.setRange(low, high)
        self.spacing.setDecimals(2)
        self.spacing.setSingleStep(0.5)
        self.spacing.setSuffix(" mm")
        self.spacing.setKeyboardTracking(False)
        self.spacing.setValue(self._settings.number(_SPACING, 1e3 * SPACING_M))
        self.curve.set_spacing_mm(self.spacing.value())
        self.spacing.setToolTip("Distance between neighbouring dots on the flat, unstretched sheet, in millimetres")
        self.map_of.addItems([str(choice) for choice in MapOf])
        self.map_of.setCurrentText(self._settings.text(_MAP, MapOf.LARGEST))
        self.map_of.setToolTip("Strain that the colours show: along the length, along the width, or the larger one")
        self.export.setToolTip(
            "Save map and curve as a picture, and the curve's points as CSV beside it (Ctrl+E); files count from 0"
        )
        self.progress.setToolTip("The origin of the displacement; strain does not need it")
        self.capture.setEnabled(False)
        self.reset.setEnabled(False)

    def _lay_out(self) -> None:
        row = QHBoxLayout()
        for text, entry in (("Dot &spacing", self.spacing), ("&Average", self.average), ("&Map", self.map_of)):
            entry.setAccessibleName(text.replace("&", ""))
            row.addWidget(caption(text, entry))
            row.addWidget(entry)
            row.addSpacing(8)
        row.addWidget(self.status, 1)
        row.addWidget(self.progress)
        row.addWidget(self.capture)
        side = QWidget()
        right = vbox(self.numbers, (self.curve, 1), within=side, margins=0)
        buttons = hbox(STRETCH, self.reset, self.export)
        right.addLayout(buttons)
        left = QWidget()
        vbox((self.map, 1), self.pointed, within=left, margins=0)
        self.sheet = splitter(Qt.Orientation.Horizontal, (left, 3), (side, 2), sizes=(640, 480))
        self._lay_out_around(self.sheet, row)

    def _connect(self) -> None:
        self._job.done.connect(self._show)
        self._job.failed.connect(self._complain)
        self.untouched.changed.connect(self._untouched_changed)
        self.untouched.progress.connect(self._show_progress)
        self.spacing.valueChanged.connect(self._spacing_changed)
        self.average.valueChanged.connect(self._average_changed)
        self.map_of.currentTextChanged.connect(self._map_changed)
        self.map.pointed.connect(lambda text: self.pointed.setText(text or " "))
        self.capture.clicked.connect(self._capture)
        self.reset.clicked.connect(self._reset)
        self.export.clicked.connect(partial(self._ask_where, ""))

    # Frames

    def _begin(self, source: SourceInfo) -> None:
        """Discard the former source; its curve can still be saved."""
        former, points = self._source, self.curve.points
        self._source, self._captured, self._last = source, None, None
        self._frames.clear()
        self._job.cancel()
        self.messages.clear("reset")  # its points belong to the former source
        if former is not None and points:
            text = self.curve.as_csv()
            sentence = (
                f"The curve of {former.name} ({counted(len(points), 'point')}) ended because {source.name} was opened."
            )
            self.messages.show_message(
                "former", Severity.INFO, sentence, [("Save it…", partial(self._ask_where, text))]
            )
        self.curve.reset()
        self._offer_curve()

    def _measure(self) -> None:
        """Measure the newest frame with the present entries."""
        if self._result is None or not self._frames:
            return
        if self.view is None:
            self.status.setText(_FIRST)
            self.map.show_view(None, MapOf.LARGEST, _FIRST)
        frames = list(self._frames)[-self.average.value() :]
        untouched = self._captured or self.untouched.frame
        result, spacing_m = self._result, self.spacing.value() / 1e3
        task = StrainTask(frames, result.frame_number, result.source.rig, spacing_m, untouched)
        self._job.start(lambda _: examine(task))

    def _show(self, view: StrainView) -> None:
        if self._result is None or view.task.rig != self._result.source.rig:
            return
        self.view = view
        fresh = view.task.frame is not self._last
        self._last = view.task.frame
        if view.measured is not None and fresh:
            self._rate.tick()
            self.curve.add(view)
        elif view.measured is not None:
            self.curve.complete(view)
        self.capture.setEnabled(True)
        self._offer_curve()
        self.map.show_view(view, MapOf(self.map_of.currentText()), view.problem or _WAITING)
        self.numbers.show_view(view)
        self._show_status()
        self.shown.emit(view)

    def _show_status(self) -> None:
        view, result = self.view, self._result
        if view is None or result is None:
            return
        parts = [f"Frame {view.task.number} of {result.source.name}"]
        if view.averaged > 1:
            parts.append(f"{view.averaged} frames averaged")
        if result.playback.running and (rate := self._rate.rate()):
            parts.append(f"{rate:.1f} measured per second")
        if view.task.untouched is None and not self.untouched.searching:
            parts.append(_NO_UNTOUCHED)
        if self.untouched.warning and self._captured is None:
            parts.append(self.untouched.warning)
        self.status.setText(" · ".join(parts))

    # Entries and buttons

    def _spacing_changed(self, spacing_mm: float) -> None:
        self._settings.set(_SPACING, spacing_mm)
        self.curve.set_spacing_mm(spacing_mm)
        self._measure()

    def _average_changed(self, frames: int) -> None:
        self._settings.set(_AVERAGE, frames)
        self._measure()

    def _map_changed(self, choice: str) -> None:
        self._settings.set(_MAP, choice)
        if self.view is not None:
            self.map.show_view(self.view, MapOf(choice), self.view.problem)

    def _capture(self) -> None:
        """Use the present frame as the untouched frame, and start a new curve."""
        if self.view is None:
            return
        self._captured = self.view.task.frame
        self._reset()
        self._last = None  # this frame is the first point of the curve
        self._say(f"Displacement is now measured from frame {self.view.task.number}.")
        self._measure()

    def _reset(self) -> None:
        points = self.curve.points
        if not points:
            return
        self.curve.reset()
        self._offer_curve()

        def bring_back() -> None:
            self.curve.merge(points)
            self._offer_curve()

        self.messages.show_message(
            "reset",
            Severity.INFO,
            f"The curve of {counted(len(points), 'point')} was removed.",
            [("Bring it back", bring_back)],
        )

    def _offer_curve(self) -> None:
        for button in (self.reset, self.export):
            button.setEnabled(bool(self.curve.points))

    def _ask_where(self, text: str, _checked: bool = False) -> None:
        """Ask for a file for the present curve and map, or for the CSV text of a former curve."""
        if not text and not self.curve.points:
            return
        name, filters = ("strain.csv", _FILTERS[1:]) if text else ("strain.png", _FILTERS)
        self._dialogs.save_file("export", "Save strain", name, filters, partial(self.save_to, text=text))

    def save_to(self, path: Path, text: str = "") -> None:
        """Write map and curve as a picture with the points as CSV; into a .csv file, only the points."""
        points = text or self.curve.as_csv()
        if text or path.suffix.lower() == ".csv":
            self._write(None, points, path, "The curve was")
        else:
            self._write(self.sheet.grab().toImage(), points, path, "Map and curve were")

    # Untouched frame

    def _show_progress(self, share: float) -> None:
        self.progress.show_share(share)
        self.progress.setVisible(self.untouched.searching)

    def _untouched_changed(self) -> None:
        if not self.untouched.searching:
            self.progress.hide()
            self._measure()
