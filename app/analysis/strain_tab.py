"""The tab Membrane strain: strain map, largest strains, and strain against displacement."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QComboBox, QDoubleSpinBox, QLabel, QWidget

from ...core.lab.strain import (
    SPACING_M,
    SPACING_RANGE_M,
    AxisStrain,
    StrainError,
    average_still,
    indentation_m,
    measure_strain,
)
from ...core.model.frames import SensorFrame
from ...widgets.basics.controls import caption, frame_count, wrapped_label
from ...widgets.basics.layouts import splitter, vbox
from ...widgets.basics.theme import ThemeColors
from ...widgets.plots.plot import Plot
from ..context import Context
from ..worker.jobs import Progress, Work
from ..worker.results import Result
from .live_tab import LiveTab, Row
from .strain_views import LENGTH_RGB, WIDTH_RGB, StrainMap, StrainView, largest_pair

_SPACING, _AVERAGE, _MAP = "strain/spacing_mm", "strain/average", "strain/map"
_MAPS: Final = ("Largest", "Along length", "Along width")
_MAX_AVERAGED: Final = 30
#: Smallest range of both axes of the curve, in mm and percent.
_MIN_RANGE: Final = 10.0


class StrainTab(LiveTab):
    """Measures the newest frame as often as possible."""

    COLUMNS = (
        *("sequence", "displacement_mm", "strain_length_percent", "strain_width_percent", "dots", "averaged_frames"),
        *("spacing_mm", "true_strain_length_percent", "true_strain_width_percent"),
        *("true_strain_length_seen_percent", "true_strain_width_seen_percent"),
    )
    EXPORT = "strain"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._frames: deque[SensorFrame] = deque(maxlen=_MAX_AVERAGED)
        self.map, self.numbers, self.pointed = StrainMap(), wrapped_label(verdict=True), QLabel(" ")
        self.spacing, self.map_of = QDoubleSpinBox(), QComboBox()
        self.average = frame_count(
            _MAX_AVERAGED,
            "Number of recent frames to average while the membrane does not move. "
            "10 is more accurate at steep places; 1 follows a moving press",
            round(self.settings.number(_AVERAGE, 1)),
        )
        self.plot = Plot("Displacement, mm", "Largest strain, %", movable=True)
        self.plot.getViewBox().setLimits(minXRange=_MIN_RANGE, minYRange=_MIN_RANGE)
        self.plot.getPlotItem().showGrid(x=True, y=True, alpha=0.2)
        self.plot.setToolTip("Largest strain along length and width against the displacement of the membrane")
        self.plot.setAccessibleName("Strain against displacement")
        legend = self.plot.add_legend(3)
        self._truths = [self.plot.plot(pen=None, symbol="+", symbolSize=11) for _ in range(2)]
        self._curves = [
            self.plot.plot(name=name, symbol=symbol, symbolSize=6) for name, symbol in (("length", "o"), ("width", "s"))
        ]
        legend.addItem(self._truths[0], "solver, dots seen")
        self.plot.follow_theme(self._recolor)
        self._lay_out()
        self.map.show_view(None, _MAPS[0], self.status.text())
        self.spacing.valueChanged.connect(self._entries_changed)
        self.average.valueChanged.connect(self._entries_changed)
        self.map_of.currentTextChanged.connect(self._map_changed)
        self.map.pointed.connect(lambda text: self.pointed.setText(text or " "))

    def _lay_out(self) -> None:
        low, high = (1e3 * end for end in SPACING_RANGE_M)
        self.spacing.setRange(low, high)
        self.spacing.setDecimals(2)
        self.spacing.setSuffix(" mm")
        self.spacing.setKeyboardTracking(False)
        self.spacing.setToolTip("Distance of neighbouring dots on the flat sheet, as printed")
        self.spacing.setValue(self.settings.number(_SPACING, 1e3 * SPACING_M))
        self.map_of.addItems(_MAPS)
        self.map_of.setCurrentText(self.settings.text(_MAP, _MAPS[0]))
        self.map_of.setToolTip("Strain that colours each square of the grid")
        self.reset.setText("&Reset curve")
        for words, entry in (
            ("Dots every", self.spacing), ("A&verage", self.average), ("&Map", self.map_of),
        ):  # fmt: skip
            entry.setAccessibleName(words.replace("&", ""))
            self.top.addWidget(caption(words, entry))
            self.top.addWidget(entry)
        self.top.addStretch(1)
        side = QWidget()
        vbox(self.numbers, (self.plot, 1), within=side, margins=0)
        left = QWidget()
        vbox((self.map, 1), self.pointed, within=left, margins=0)
        self.sheet = splitter(Qt.Orientation.Horizontal, (left, 3), (side, 2))
        self.column.addWidget(self.sheet, 1)

    # What the base asks

    def begin(self, result: Result) -> None:
        """Forget the frames of the former source."""
        self._frames.clear()
        self.map.show_view(None, self.map_of.currentText(), "Measuring the first frame…")
        self.numbers.setText("")

    def work(self, result: Result) -> Work:
        """Return the measurement of the newest frame, averaged with those before it."""
        if not self._frames or result.frame is not self._frames[-1]:
            self._frames.append(result.frame)
        frames, rig = list(self._frames)[-self.average.value() :], result.source.rig
        spacing_m, home = self.spacing.value() / 1e3, self.context.document.untouched_home

        def measure(progress: Progress) -> StrainView:
            untouched = self.untouched(result, home, progress).frame
            frame, averaged = average_still(frames)
            truth = frame.truth.strain if frame.truth is not None else None
            displacement_mm = math.nan
            try:
                if untouched is not None:
                    displacement_mm = 1e3 * indentation_m(frame, untouched, rig)
                measured = measure_strain(frame, rig, spacing_m)
            except StrainError as error:
                words = str(error)
                return StrainView(spacing_m, averaged, frame.tactile_color, displacement_mm, truth, problem=words)
            return StrainView(spacing_m, averaged, frame.tactile_color, displacement_mm, truth, measured)

        return measure

    def show_found(self, result: Result, found: StrainView) -> Row | None:
        """Show the map and the numbers."""
        self.map.show_view(found, self.map_of.currentText(), found.problem)
        measured = found.measured
        if measured is None:
            self.numbers.setText(f"{found.problem[:1].upper()}{found.problem[1:]}.")
            return None
        lines = [f"{len(measured.pixels)} dots, {found.averaged} frames averaged"]
        if math.isfinite(found.displacement_mm):
            lines[0] += f", {found.displacement_mm:.1f} mm displacement"
        else:
            lines.append("No displacement: the untouched membrane is not known.")
        for name, axis in (("length", measured.length), ("width", measured.width)):
            lines.append(_axis_words(name, axis, found))
        self.numbers.setText("\n".join(lines))
        known = found.truth
        truths = (known.length, known.width, known.length_seen, known.width_seen) if known is not None else (None,) * 4
        strains = (found.displacement_mm, 100 * measured.length.largest, 100 * measured.width.largest)
        return (
            result.frame.sequence,
            *(round(value, 3) if math.isfinite(value) else None for value in strains),
            *(len(measured.pixels), found.averaged, round(1e3 * found.spacing_m, 4)),
            *(None if value is None else round(100 * value, 3) for value in truths),
        )

    def rows_changed(self) -> None:
        """Draw the frames whose displacement is known, in their order."""
        rows = [row for row in sorted(self.rows.values(), key=lambda row: row[0]) if row[1] is not None]
        table = np.array([row[1:4] for row in rows], np.float64).reshape(-1, 3)
        seen = np.array([[row[1], *row[9:11]] for row in rows if row[9] is not None], np.float64).reshape(-1, 3)
        for axis, (curve, truth) in enumerate(zip(self._curves, self._truths, strict=True), start=1):
            curve.setData(table[:, 0], table[:, axis])
            truth.setData(seen[:, 0], seen[:, axis])

    def picture(self) -> QWidget | None:
        """Return map, numbers and curve."""
        return self.sheet

    # Entries

    def _entries_changed(self) -> None:
        self.settings.set(_SPACING, self.spacing.value())
        self.settings.set(_AVERAGE, self.average.value())
        self.again()

    def _map_changed(self, shown: str) -> None:
        self.settings.set(_MAP, shown)
        if self.found is not None:
            self.map.show_view(self.found, shown, self.found.problem)

    def _recolor(self, colors: ThemeColors) -> None:
        for curve, marks, rgb in zip(self._curves, self._truths, (LENGTH_RGB, WIDTH_RGB), strict=True):
            curve.setPen(pg.mkPen(rgb, width=1.5))
            curve.setSymbolBrush(pg.mkBrush(rgb))
            curve.setSymbolPen(None)
            marks.setSymbolPen(pg.mkPen(colors.text))


def _axis_words(name: str, axis: AxisStrain, found: StrainView) -> str:
    assert found.measured is not None
    u, v = largest_pair(axis, found.measured.pixels).mean(axis=0)
    words = f"Along the {name}: {100 * axis.largest:.1f} % at ({u:.0f}, {v:.0f}) px"
    if found.truth is not None:
        seen, every = getattr(found.truth, f"{name}_seen"), getattr(found.truth, name)
        words += f"; solver {100 * seen:.1f} % at the dots seen, {100 * every:.1f} % at all"
    return words
