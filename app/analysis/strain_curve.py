"""Strain against displacement while the membrane is pressed: the points so far, their plot, and their file."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

import pyqtgraph as pg
from PyQt6.QtCore import QEvent
from PyQt6.QtWidgets import QVBoxLayout, QWidget

from ...widgets.basics.theme import theme_colors
from .strain_map import LENGTH_RGB, WIDTH_RGB
from .strain_work import StrainView

#: As many points as half an hour of measurements; then the oldest go.
MOST_POINTS = 5000
#: A plot is not zoomed further in, mm and percent.
_LEAST_RANGE = 10.0
_COLUMNS = (
    "sequence", "displacement_mm", "strain_length_percent", "strain_width_percent",
    "strain_length_sigma_percent", "strain_width_sigma_percent", "dots", "averaged_frames", "spacing_mm",
    "true_strain_length_percent", "true_strain_width_percent",
    "true_strain_length_seen_percent", "true_strain_width_seen_percent",
)  # fmt: skip


@dataclass(frozen=True)
class CurvePoint:
    """One measurement; strains are percent, for the spacing of then."""

    sequence: int
    displacement_mm: float | None
    strain: tuple[float, float]
    sigma: tuple[float, float]
    dots: int
    averaged: int
    spacing_mm: float
    truth: tuple[float, float, float, float] | None

    @classmethod
    def of(cls, view: StrainView) -> CurvePoint:
        """Return what a curve keeps of a view that has a measurement."""
        measured = view.measured
        assert measured is not None
        known = view.truth
        return cls(
            view.task.frame.sequence,
            view.displacement_mm,
            (100 * measured.length.largest, 100 * measured.width.largest),
            (100 * measured.length.largest_sigma, 100 * measured.width.largest_sigma),
            measured.dots,
            view.averaged,
            1e3 * view.task.spacing_m,
            None
            if known is None
            else (100 * known.length, 100 * known.width, 100 * known.length_seen, 100 * known.width_seen),
        )

    def at_spacing(self, spacing_mm: float) -> tuple[float, float]:
        """Return both strains as they are where the dots were so far apart: lengths stay what they are."""
        ratio = self.spacing_mm / spacing_mm
        length, width = self.strain
        return (100 + length) * ratio - 100, (100 + width) * ratio - 100

    def row(self, spacing_mm: float) -> list[object]:
        """Return the values of a CSV line; None where there is none."""
        ratio = self.spacing_mm / spacing_mm
        truth = self.truth or (None,) * 4
        values = [self.displacement_mm, *self.at_spacing(spacing_mm), *(ratio * sigma for sigma in self.sigma)]
        rounded = [None if value is None else round(value, 3) for value in values]
        known = [None if value is None else round(value, 3) for value in truth]
        return [self.sequence, *rounded, self.dots, self.averaged, round(spacing_mm, 4), *known]


class StrainCurve(QWidget):
    """The plot, and the points that it shows."""

    def __init__(self) -> None:
        super().__init__()
        self.points: list[CurvePoint] = []
        self._spacing_mm = 10.0
        self.plot = pg.PlotWidget()
        self.plot.setMenuEnabled(False)
        self.plot.hideButtons()
        self.plot.getViewBox().setLimits(minXRange=_LEAST_RANGE, minYRange=_LEAST_RANGE)
        self.plot.setLabel("bottom", "Displacement, mm")
        self.plot.setLabel("left", "Largest strain, %")
        self.plot.getPlotItem().showGrid(x=True, y=True, alpha=0.2)
        self.plot.setToolTip("Largest strain along length and width against how far the membrane was pushed in")
        self.plot.setAccessibleName("Strain against displacement")
        self._legend = self.plot.addLegend(offset=(10, 6))
        self._truths = [self.plot.plot(pen=None, symbol="+", symbolSize=11) for _ in range(2)]
        self._curves = [
            self.plot.plot(name=name, symbol=symbol, symbolSize=6) for name, symbol in (("length", "o"), ("width", "s"))
        ]
        self._now = self.plot.plot(pen=None, symbol="o", symbolSize=13)
        self._legend.addItem(self._truths[0], "solver, dots seen")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.plot)
        self._recolor()

    def add(self, view: StrainView) -> None:
        """Add a measurement; one of the same frame, seen again in a loop, goes."""
        added = CurvePoint.of(view)
        others = [point for point in self.points if point.sequence != added.sequence]
        self.points = [*others[-MOST_POINTS + 1 :], added]
        self.redraw()

    def complete(self, view: StrainView) -> None:
        """Take a better measurement of the newest frame, such as with the displacement that was missing."""
        if self.points and self.points[-1].sequence == view.task.frame.sequence:
            self.points = [*self.points[:-1], CurvePoint.of(view)]
            self.redraw()

    def set_spacing_mm(self, spacing_mm: float) -> None:
        """Take the dots for so far apart on the flat sheet; what was measured stays."""
        self._spacing_mm = spacing_mm
        self.redraw()

    def reset(self) -> None:
        """Forget all points."""
        self.points = []
        self.redraw()

    def redraw(self) -> None:
        """Draw the points whose displacement is known, in the order in which they came."""
        known = [point for point in self.points if point.displacement_mm is not None]
        x = [point.displacement_mm for point in known]
        for number, curve in enumerate(self._curves):
            curve.setData(x, [point.at_spacing(self._spacing_mm)[number] for point in known])
        judged = [point for point in known if point.truth is not None]
        for number, marks in enumerate(self._truths):
            values = [point.truth[2 + number] for point in judged if point.truth is not None]
            marks.setData([point.displacement_mm for point in judged], values)
        last = known[-1:]
        self._now.setData(
            [point.displacement_mm for point in last for _ in range(2)],
            [strain for point in last for strain in point.at_spacing(self._spacing_mm)],
        )

    def as_csv(self) -> str:
        """Return all points, a line each."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(_COLUMNS)
        writer.writerows(point.row(self._spacing_mm) for point in self.points)
        return text.getvalue()

    def changeEvent(self, event: QEvent | None) -> None:
        """Follow the theme."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.PaletteChange:
            self._recolor()

    def _recolor(self) -> None:
        colors = theme_colors()
        self.plot.setBackground(colors.base)
        for name in ("bottom", "left"):
            axis = self.plot.getPlotItem().getAxis(name)
            axis.setPen(colors.text)
            axis.setTextPen(colors.text)
        self._legend.setLabelTextColor(colors.text)
        for curve, marks, rgb in zip(self._curves, self._truths, (LENGTH_RGB, WIDTH_RGB), strict=True):
            curve.setPen(pg.mkPen(rgb, width=1.5))
            curve.setSymbolBrush(pg.mkBrush(rgb))
            curve.setSymbolPen(None)
            marks.setSymbolPen(pg.mkPen(colors.text))
        self._now.setSymbolBrush(None)
        self._now.setSymbolPen(pg.mkPen(colors.text, width=1.5))
        for sample, label in self._legend.items:
            label.setText(label.text)
            sample.update()
