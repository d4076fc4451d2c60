"""The tab Membrane strain: strain map over the tactile image, largest strains, and strain against displacement."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QColor
from PyQt6.QtWidgets import QDoubleSpinBox, QWidget

from ...core.lab.strain import (
    SPACING_M,
    SPACING_RANGE_M,
    AxisStrain,
    StrainError,
    StrainMeasurement,
    average_still,
    indentation_m,
    measure_strain,
)
from ...core.model.arrays import Float64Array, Uint8Array
from ...core.model.frames import SensorFrame, TrueStrain
from ...widgets.basics.colormaps import depth_lut, ends_legend
from ...widgets.basics.controls import caption, frame_count, wrapped_label
from ...widgets.basics.layouts import splitter, vbox
from ...widgets.images.image_pane import ImagePane
from ...widgets.plots.plot import Plot
from ..calibration.pictures import pack_rgb
from ..context import Context
from ..worker.jobs import Progress, Work
from ..worker.results import Result
from .tab import LiveTab, Row

_SPACING: Final = "strain/spacing_mm"
_MAX_AVERAGED: Final = 30
#: Smallest range of both axes of the curve, in mm and percent.
_MIN_RANGE: Final = 10.0
#: Where strain is largest along the length and along the width; also the colours of the curve.
LENGTH_RGB, WIDTH_RGB = (235, 60, 40), (40, 150, 255)
#: Share of the map's colour over the image, and the bits of a pixel's fraction in which squares are drawn.
_OPACITY, _SHIFT = 0.7, 4
#: The colours end at a multiple of this, 10 %.
_ROUNDED: Final = 0.10


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
        self.map, self.numbers = StrainMap(), wrapped_label(verdict=True)
        self.spacing = QDoubleSpinBox()
        self.average = frame_count(
            _MAX_AVERAGED,
            "Number of recent frames to average while the membrane does not move. "
            "10 is more accurate at steep places; 1 follows a moving press",
            1,
        )
        self.plot = Plot("Displacement, mm", "Largest strain, %", movable=True)
        self.plot.getViewBox().setLimits(minXRange=_MIN_RANGE, minYRange=_MIN_RANGE)
        self.plot.getPlotItem().showGrid(x=True, y=True, alpha=0.2)
        self.plot.setToolTip("Largest strain along length and width against the displacement of the membrane")
        self.plot.setAccessibleName("Strain against displacement")
        self.plot.add_legend(2)
        self._curves = [
            self.plot.plot(name=name, pen=pg.mkPen(rgb, width=1.5), symbol=symbol, symbolSize=6, symbolBrush=rgb)
            for name, symbol, rgb in (("length", "o", LENGTH_RGB), ("width", "s", WIDTH_RGB))
        ]
        self.plot.follow_theme()
        self._lay_out()
        self.map.show_view(None, self.status.text())
        self.spacing.valueChanged.connect(self._entries_changed)
        self.average.valueChanged.connect(self._entries_changed)

    def _lay_out(self) -> None:
        low, high = (1e3 * end for end in SPACING_RANGE_M)
        self.spacing.setRange(low, high)
        self.spacing.setDecimals(2)
        self.spacing.setSuffix(" mm")
        self.spacing.setKeyboardTracking(False)
        self.spacing.setToolTip("Distance of neighbouring dots on the flat sheet, as printed")
        self.spacing.setValue(self.settings.number(_SPACING, 1e3 * SPACING_M))
        self.reset.setText("&Reset curve")
        for words, entry in (("Dots every", self.spacing), ("A&verage", self.average)):
            entry.setAccessibleName(words.replace("&", ""))
            self.top.addWidget(caption(words, entry))
            self.top.addWidget(entry)
        self.top.addStretch(1)
        side = QWidget()
        vbox(self.numbers, (self.plot, 1), within=side, margins=0)
        self.sheet = splitter(Qt.Orientation.Horizontal, (self.map, 3), (side, 2))
        self.column.addWidget(self.sheet, 1)

    # What the base asks

    def begin(self, result: Result) -> None:
        self._frames.clear()
        self.map.show_view(None, "Measuring the first frame…")
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
        self.map.show_view(found, found.problem)
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
        rows = [row for row in sorted(self.rows.values(), key=lambda row: row[0]) if row[1] is not None]
        table = np.array([row[1:4] for row in rows], np.float64).reshape(-1, 3)
        for axis, curve in enumerate(self._curves, start=1):
            curve.setData(table[:, 0], table[:, axis])

    def picture(self) -> QWidget | None:
        return self.sheet

    # Entries

    def _entries_changed(self) -> None:
        self.settings.set(_SPACING, self.spacing.value())
        self.again()


def _axis_words(name: str, axis: AxisStrain, found: StrainView) -> str:
    assert found.measured is not None
    u, v = largest_pair(axis, found.measured.pixels).mean(axis=0)
    words = f"Along the {name}: {100 * axis.largest:.1f} % at ({u:.0f}, {v:.0f}) px"
    if found.truth is not None:
        seen, every = getattr(found.truth, f"{name}_seen"), getattr(found.truth, name)
        words += f"; solver {100 * seen:.1f} % at the dots seen, {100 * every:.1f} % at all"
    return words


@dataclass(frozen=True, eq=False)
class StrainView:
    """One measurement, or the reason why there is none; the displacement is nan without an untouched frame."""

    spacing_m: float
    averaged: int
    color: Uint8Array | None
    displacement_mm: float
    truth: TrueStrain | None
    measured: StrainMeasurement | None = None
    problem: str = ""


def largest_pair(axis: AxisStrain, pixels: Float64Array) -> Float64Array:
    return np.asarray(pixels[axis.pairs[np.argmax(axis.strain)]])


def _color_range(values: Float64Array) -> tuple[float, float]:
    """Return the range of the colours: multiples of `_ROUNDED` that contain all values."""
    if len(values) == 0:
        return 0.0, _ROUNDED
    low = min(float(np.floor(values.min() / _ROUNDED)) * _ROUNDED, 0.0)
    return low, max(float(np.ceil(values.max() / _ROUNDED)) * _ROUNDED, low + _ROUNDED)


def _map_lut() -> Uint8Array:
    return np.ascontiguousarray(depth_lut()[::-1])


class StrainMap(ImagePane):
    """Shows one measurement; the wheel zooms, a drag pans, another size of the window shows all."""

    def __init__(self) -> None:
        super().__init__("Strain map (tactile colour image)")
        shadow = pg.mkPen((0, 0, 0, 170), width=7)
        self._dots = pg.ScatterPlotItem(size=5, pen=None, brush=pg.mkBrush(255, 255, 255, 200))
        self._peaks = [
            pg.PlotCurveItem(connect="pairs", pen=pg.mkPen(rgb, width=4), shadowPen=shadow)
            for rgb in (LENGTH_RGB, WIDTH_RGB)
        ]
        for height, item in enumerate((self._dots, *self._peaks), start=5):
            item.setZValue(height)
            self.box.addItem(item, ignoreBounds=True)
        self.view.setMinimumSize(320, 200)
        self.view.setToolTip("Wheel: zoom; drag: move")
        self.resized.connect(self._show_all)

    def show_view(self, view: StrainView | None, message: str) -> None:
        """Show a measurement; without one, the image and the reason."""
        image = None if view is None or view.color is None else view.color.copy()
        measured = view.measured if view is not None else None
        self.set_legend([])
        if view is not None and view.color is not None and measured is not None and image is not None:
            values = measured.cell_strain.max(axis=1)
            low, high = _color_range(values)
            rows = np.clip((values - low) / (high - low) * 255.0, 0, 255).astype(np.intp)
            corners = np.rint(measured.pixels[measured.cells] * (1 << _SHIFT)).astype(np.int32)
            for places, row in zip(corners, rows, strict=True):
                color = [int(channel) for channel in _map_lut()[row, :3]]
                cv2.fillConvexPoly(image, places, color, cv2.LINE_AA, _SHIFT)
            image = np.asarray(cv2.addWeighted(image, _OPACITY, view.color, 1.0 - _OPACITY, 0.0), dtype=np.uint8)
            scale = ends_legend(f"{100 * low:.0f} %", f"{100 * high:.0f} %", _map_lut())
            peaks = [("largest along length", QColor(*LENGTH_RGB)), ("largest along width", QColor(*WIDTH_RGB))]
            self.set_legend(scale + peaks)
        size = (640, 480) if image is None else (image.shape[1], image.shape[0])
        changed = size != self._size
        self.set_pixels(None if image is None else pack_rgb(image), size, 1)
        self.set_message(message if image is None else "")
        if changed:
            self._show_all()
        for item in (self._dots, *self._peaks):
            item.setVisible(measured is not None)
        if measured is not None:
            self._dots.setData(*measured.pixels.T)
            for peak, axis in zip(self._peaks, (measured.length, measured.width), strict=True):
                peak.setData(*largest_pair(axis, measured.pixels).T)

    def _show_all(self) -> None:
        self.show_rect(self.image_rect())
