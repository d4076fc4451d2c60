"""The tab Tilt: the patch with its plane, roll and pitch with their standard deviations, and both over time."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Final

from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtWidgets import QCheckBox, QComboBox, QHBoxLayout, QLabel, QWidget

from ...core.errors import counted
from ...core.estimation.tilt import MAX_SIGMA_RAD, Tilt, TiltEstimator, TiltMethod
from ...core.estimation.tilt_filter import TiltFilter
from ...widgets.basics.colormaps import CONTACT_COLOR, palette_theme
from ...widgets.basics.controls import caption, copy_text, push_button
from ...widgets.basics.layouts import hbox, splitter, vbox
from ...widgets.basics.messages import Severity
from ...widgets.clouds.cloud_view import CloudView
from ..context import Context
from ..worker.results import Result, SourceInfo
from .measuring_tab import MeasuringTab
from .tilt_views import (
    MAX_ROWS,
    PITCH_RGB,
    PLANE_COLOR,
    PLOTTED,
    ROLL_RGB,
    AngleDial,
    TiltCurve,
    TiltRow,
    degrees_text,
    patch_with_plane,
    rows_as_csv,
)

_METHOD, _FILTERED = "tilt/method", "tilt/filtered"
_METHODS: Final[dict[str, TiltMethod]] = {"Rig's noise": "noise", "Principal components": "pca"}
_WAITING = "Waiting for a frame: open a source in the main window, such as sim:tray."
_NO_CONTACT = "No contact yet: press the object into the membrane, or play to a frame with contact"
_ASSUMED = "usual noise assumed: see Calibration > Measure noise and bias"
_NOT_DETERMINED = f"no tilt, as of a line or a dot (standard deviation above {math.degrees(MAX_SIGMA_RAD):.0f}°)"


class TiltTab(MeasuringTab):
    """Estimates the tilt of each frame that the main window shows."""

    def __init__(self, context: Context) -> None:
        super().__init__(context, _WAITING)
        self._source: SourceInfo | None = None
        self._filter = TiltFilter()
        #: The tilts of the source's frames, by frame number, the oldest first.
        self.rows: dict[int, TiltRow] = {}
        self.tilt: Tilt | None = None
        self.cloud = CloudView("Patch and plane")
        self.roll = AngleDial(
            "Roll",
            "Angle about the proximity camera's x axis (right), degrees: positive where the lower edge of the image is "
            "farther. The wedge is one standard deviation",
            ROLL_RGB,
        )
        self.pitch = AngleDial(
            "Pitch",
            "Angle about the proximity camera's y axis (down), degrees: positive where the right edge of the image is "
            "nearer. The wedge is one standard deviation",
            PITCH_RGB,
        )
        self.axis = QLabel("Long axis –")
        self.curve = TiltCurve()
        self.method, self.filtered = QComboBox(), QCheckBox("&Filtered")
        self.copy = push_button("C&opy", "Copy the angles of this frame with their standard deviations as text")
        self.reset = push_button("&Reset curve", "Start a new curve; the old one can be restored")
        self._set_up_entries()
        self._lay_out()
        self._connect()
        self.cloud.set_message(_WAITING)

    # What the window calls

    def show_result(self, result: Result) -> None:
        """Estimate the tilt of this frame."""
        if result.source is not self._source:
            self._begin(result.source)
        self._result = result
        self._estimate()

    # Building

    def _set_up_entries(self) -> None:
        self.method.addItems(list(_METHODS))
        self.method.setCurrentText(self._settings.text(_METHOD, next(iter(_METHODS))))
        self.method.setToolTip(
            "Rig's noise: plane by least squares, corrected by the difference of both depths. "
            "Principal components: as published, each point alike"
        )
        self.filtered.setChecked(self._settings.number(_FILTERED, 0) > 0)
        self.filtered.setToolTip(
            "Angles after a Kalman filter with a constant rate: less noise, a little later. Off: each frame alone"
        )
        self.export.setToolTip("Save the angles of all frames as CSV, in degrees (Ctrl+E); frames count from 0")
        self.axis.setToolTip(
            "Direction of the patch's long axis in the image, degrees: 0 to the right, 90 down; none for a round patch"
        )
        self.axis.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.copy.setEnabled(False)
        self.reset.setEnabled(False)

    def _lay_out(self) -> None:
        row = QHBoxLayout()
        self.method.setAccessibleName("Method")
        row.addWidget(caption("&Method", self.method))
        row.addWidget(self.method)
        row.addSpacing(8)
        row.addWidget(self.filtered)
        row.addStretch(1)
        dials = hbox(self.roll, self.pitch)
        buttons = hbox((self.axis, 1), self.copy, self.reset, self.export)
        side = QWidget()
        #: The column beside the cloud.
        self.column = vbox(dials, (self.curve, 1), buttons, within=side, margins=0)
        sheet = splitter(Qt.Orientation.Horizontal, self.cloud, side, sizes=(480, 480))
        self._lay_out_around(sheet, vbox(row, self.status))  # the hints need the whole width

    def _connect(self) -> None:
        self.method.currentTextChanged.connect(self._method_changed)
        self.filtered.toggled.connect(self._filtered_changed)
        self.copy.clicked.connect(self._copy)
        self.reset.clicked.connect(self._reset)
        self.export.clicked.connect(partial(self._ask_where, ""))

    # Frames

    def _begin(self, source: SourceInfo) -> None:
        """Discard the former source; its curve can still be saved."""
        former, rows = self._source, self.rows
        self._source, self.rows, self.tilt = source, {}, None
        self._filter.restart()
        self.messages.clear("reset")  # its rows belong to the former source
        if former is not None and rows:
            sentence = (
                f"The tilts of {former.name} ({counted(len(rows), 'frame')}) ended because {source.name} was opened."
            )
            ask = partial(self._ask_where, rows_as_csv(rows.values()))
            self.messages.show_message("former", Severity.INFO, sentence, [("Save them…", ask)])

    def _estimate(self) -> None:
        result = self._result
        if result is None:
            return
        if result.patch is None:
            self.cloud.set_cloud(None)
            self.cloud.set_message(result.problem)
            self.status.setText(result.problem)
            for dial in (self.roll, self.pitch):
                dial.setValue(None, None)
            self._show_curve()
            return
        frame = result.frame
        estimator = TiltEstimator(result.preset, result.source.rig, _METHODS[self.method.currentText()])
        raw = estimator.estimate(result.patch, frame.sequence, frame.proximity_time_s)
        self.rows.pop(frame.sequence, None)  # as in a loop, the newest is the last
        self.rows[frame.sequence] = TiltRow(raw, self._filter.update(raw))
        if len(self.rows) > MAX_ROWS:
            del self.rows[next(iter(self.rows))]
        self._show()

    def _show(self) -> None:
        """Draw the newest frame and the curve."""
        result = self._result
        if result is None or result.patch is None or result.frame.sequence not in self.rows:
            return
        row, filtered = self.rows[result.frame.sequence], self.filtered.isChecked()
        tilt = self.tilt = row.filtered if filtered else row.raw
        points = result.patch.points
        theme = palette_theme(self.palette())
        self.cloud.set_message(_NO_CONTACT)
        self.cloud.set_cloud(patch_with_plane(points, tilt, theme) if len(points) else None)
        plane = tilt.roll_rad is not None and tilt.pitch_rad is not None
        self.cloud.set_legend([("patch", CONTACT_COLOR), *([("fitted plane", PLANE_COLOR)] if plane else [])])
        self.roll.setValue(tilt.roll_rad, tilt.roll_sigma_rad)
        self.pitch.setValue(tilt.pitch_rad, tilt.pitch_sigma_rad)
        self.axis.setText(f"Long axis {degrees_text(tilt.axis_rad, tilt.axis_sigma_rad)}")
        self._show_curve()
        parts = [f"Frame {result.frame_number} of {result.source.name}"]
        if len(points) and not plane:
            parts.append(_NOT_DETERMINED)
        if result.preset.noise is None:
            parts.append(_ASSUMED)
        self.status.setText(" · ".join(parts))
        self.copy.setEnabled(True)

    def _show_curve(self) -> None:
        filtered = self.filtered.isChecked()
        rows = sorted(list(self.rows.values())[-PLOTTED:], key=lambda row: row.raw.time_s)
        self.curve.show_tilts([row.filtered if filtered else row.raw for row in rows])
        self.reset.setEnabled(bool(rows))
        self.export.setEnabled(bool(rows))

    # Entries and buttons

    def _method_changed(self, name: str) -> None:
        self._settings.set(_METHOD, name)
        self._filter.restart()
        self._estimate()

    def _filtered_changed(self, on: bool) -> None:
        self._settings.set(_FILTERED, int(on))
        self._show()

    def _copy(self) -> None:
        if self.tilt is None:
            return
        words = f"{self.roll.text()}, {self.pitch.text()}, {self.axis.text()}"
        copy_text(f"{words} (frame {self.tilt.sequence}, {self.tilt.method})")
        self._say("The angles were copied.")

    def _reset(self) -> None:
        rows = self.rows
        if not rows:
            return
        self.rows = {}
        self._filter.restart()
        self._show_curve()

        def bring_back() -> None:
            self.rows = rows | self.rows
            self._show_curve()

        sentence = f"The curve of {counted(len(rows), 'frame')} was removed."
        self.messages.show_message("reset", Severity.INFO, sentence, [("Bring it back", bring_back)])

    def _ask_where(self, text: str, _checked: bool = False) -> None:
        """Ask for a file for the present tilts, or for the CSV text of a former source's."""
        use = partial(self.save_to, text=text)
        self._dialogs.save_file("export", "Save tilt", "tilt.csv", ["CSV file (*.csv)"], use)

    def save_to(self, path: Path, text: str = "") -> None:
        """Write the angles of all frames as CSV."""
        rows = sorted(self.rows.values(), key=lambda row: row.raw.time_s)
        self._write(None, text or rows_as_csv(rows), path, "The tilts were")

    def changeEvent(self, event: QEvent | None) -> None:
        """Follow the theme."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.PaletteChange and hasattr(self, "column"):
            self._show()
