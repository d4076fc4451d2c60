"""What the tab Strain shows: the strain map, the curve of strain against displacement, and the numbers."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtWidgets import QGridLayout, QLabel, QSizePolicy, QWidget

from ...core.evaluation.strain.series import spikes
from ...core.evaluation.strain.strain import AxisStrain
from ...core.model.arrays import BoolArray, Float64Array, IndexArray
from ...widgets.basics.controls import wrapped_label
from ...widgets.basics.layouts import vbox
from ...widgets.basics.theme import ThemeColors
from ...widgets.images.image_pane import ColorBar, ImagePane, Swatch
from ...widgets.plots.plot import Plot
from .strain_work import MapOf, StrainView, color_range, map_lut, paint, values_of

#: Where strain is largest along the length and along the width; also the colours of the curve.
LENGTH_RGB, WIDTH_RGB = (235, 60, 40), (40, 150, 255)


class StrainMap(ImagePane):
    """Shows one measurement; the wheel zooms, a drag pans, a double click shows all.

    Signals
    -------
    pointed(text: str)
        The strain of the square under the mouse; empty outside of the grid.
    """

    pointed = pyqtSignal(str)

    def __init__(self) -> None:
        super().__init__("Strain map (tactile colour image)")
        self._view: StrainView | None = None
        self._shown = MapOf.LARGEST
        self._fitted = False
        shadow = pg.mkPen((0, 0, 0, 170), width=7)
        self._lines = pg.PlotCurveItem(connect="pairs", pen=pg.mkPen((255, 255, 255, 110)))
        self._dots = pg.ScatterPlotItem(size=5, pen=None, brush=pg.mkBrush(255, 255, 255, 200))
        self._peaks = {
            "length": pg.PlotCurveItem(connect="pairs", pen=pg.mkPen(LENGTH_RGB, width=4), shadowPen=shadow),
            "width": pg.PlotCurveItem(connect="pairs", pen=pg.mkPen(WIDTH_RGB, width=4), shadowPen=shadow),
        }
        for height, item in enumerate((self._lines, self._dots, *self._peaks.values()), start=5):
            item.setZValue(height)
            self.box.addItem(item, ignoreBounds=True)
        self.view.setMinimumSize(320, 200)
        self.view.setToolTip("Wheel: zoom; drag: move; double click: show all; hover over a square to read its strain")
        self.hovered.connect(self._hovered)
        self.doubleClicked.connect(self.show_all)
        self.viewMoved.connect(lambda: setattr(self, "_fitted", True))
        self.resized.connect(self._fit)

    def show_view(self, view: StrainView | None, shown: MapOf, message: str) -> None:
        """Show a measurement; without one, the image and the reason."""
        self._view, self._shown = view, shown
        pixels = paint(view, shown) if view is not None else None
        size = (640, 480) if pixels is None else (pixels.shape[1], pixels.shape[0])
        changed = size != self._size
        self.set_pixels(pixels, size, 1)
        self.set_message(message if pixels is None else "")
        if changed:
            self.show_all()
        self._draw_grid()
        self._draw_legend()

    def show_all(self) -> None:
        """Show the whole image."""
        self._fitted = False
        self._fit()

    def _fit(self) -> None:
        if not self._fitted:
            self.show_rect(self.image_rect())

    def _draw_grid(self) -> None:
        measured = self._view.measured if self._view is not None else None
        items = (self._lines, self._dots, *self._peaks.values())
        for item in items:
            item.setVisible(measured is not None)
        if measured is None:
            return
        pairs = np.concatenate([measured.length.pairs, measured.width.pairs]).ravel()
        self._lines.setData(*measured.pixels[pairs].T)
        self._dots.setData(*measured.pixels.T)
        for name, axis in (("length", measured.length), ("width", measured.width)):
            self._peaks[name].setData(*largest_pair(axis, measured.pixels).T)

    def _draw_legend(self) -> None:
        view = self._view
        if view is None or view.cells is None:
            self.header.set_legend(None)
            return
        low, high = color_range(values_of(view.cells, self._shown))
        bar = ColorBar(f"{100 * low:.0f} %", f"{100 * high:.0f} %", map_lut())
        self.header.set_legend(
            bar, (Swatch("largest along length", LENGTH_RGB), Swatch("largest along width", WIDTH_RGB))
        )

    def _hovered(self, u: int, v: int) -> None:
        view = self._view
        if view is None or view.cells is None or view.measured is None or u < 0 or len(view.cells.corners) == 0:
            self.pointed.emit("")
            return
        inside = _inside(view.measured.pixels[view.cells.corners], u, v)
        if len(inside) == 0:
            self.pointed.emit("")
            return
        cell = inside[0]
        length, width = 100 * view.cells.length[cell], 100 * view.cells.width[cell]
        self.pointed.emit(f"Square at ({u}, {v}): {length:.1f} % along length, {width:.1f} % along width")


def largest_pair(axis: AxisStrain, pixels: Float64Array) -> Float64Array:
    """Return the two dots with the largest strain between them, pixels (2, 2)."""
    return np.asarray(pixels[axis.pairs[np.argmax(axis.strain)]])


def _inside(corners: Float64Array, u: float, v: float) -> IndexArray:
    """Return the indices of the convex quadrilaterals (K, 4, 2) that contain a pixel."""
    edges = np.roll(corners, -1, axis=1) - corners
    to = np.array([u, v]) - corners
    turn = edges[..., 0] * to[..., 1] - edges[..., 1] * to[..., 0]
    return np.flatnonzero((turn >= 0).all(axis=1) | (turn <= 0).all(axis=1))


#: Maximum number of points, about half an hour of measurements; older ones are dropped.
MAX_POINTS = 5000
#: Smallest range of both axes, in mm and percent.
_MIN_RANGE = 10.0
_NO_CURVE = "No curve yet: play while the membrane is pressed. It starts when the untouched frame is known."
_COLUMNS = (
    "sequence", "displacement_mm", "strain_length_percent", "strain_width_percent",
    "strain_length_sigma_percent", "strain_width_sigma_percent", "dots", "averaged_frames", "spacing_mm",
    "true_strain_length_percent", "true_strain_width_percent",
    "true_strain_length_seen_percent", "true_strain_width_seen_percent",
    "strain_length_unlikely", "strain_width_unlikely",
)  # fmt: skip


@dataclass(frozen=True)
class CurvePoint:
    """One measurement; strains in percent, for the dot spacing at that time."""

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
        """Return the point of a view that has a measurement."""
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
        """Return both strains for another dot spacing; the measured lengths stay the same."""
        ratio = self.spacing_mm / spacing_mm
        length, width = self.strain
        return (100 + length) * ratio - 100, (100 + width) * ratio - 100

    def row(self, spacing_mm: float) -> list[object]:
        """Return the values of a CSV line up to the judgement; None for missing ones."""
        ratio = self.spacing_mm / spacing_mm
        truth = self.truth or (None,) * 4
        values = [self.displacement_mm, *self.at_spacing(spacing_mm), *(ratio * sigma for sigma in self.sigma)]
        rounded = [None if value is None else round(value, 3) for value in values]
        known = [None if value is None else round(value, 3) for value in truth]
        return [self.sequence, *rounded, self.dots, self.averaged, round(spacing_mm, 4), *known]


class StrainCurve(QWidget):
    """The plot of strain against displacement, and its points in the order of their frames.

    Strains that do not fit those of the frames before and after are marked, and no line is drawn to them.
    """

    def __init__(self) -> None:
        super().__init__()
        self.points: list[CurvePoint] = []
        self._newest = -1
        self._spacing_mm = 10.0
        self.plot = Plot("Displacement, mm", "Largest strain, %", movable=True)
        self.plot.getViewBox().setLimits(minXRange=_MIN_RANGE, minYRange=_MIN_RANGE)
        self.plot.getPlotItem().showGrid(x=True, y=True, alpha=0.2)
        self.plot.setToolTip(
            "Largest strain along length and width against the displacement of the membrane, in the order of the "
            "frames. A cross marks a strain that is unlike those of the frames before and after"
        )
        self.plot.setAccessibleName("Strain against displacement")
        legend = self.plot.add_legend(4)
        self._truths = [self.plot.plot(pen=None, symbol="+", symbolSize=11) for _ in range(2)]
        self._curves = [
            self.plot.plot(name=name, symbol=symbol, symbolSize=6) for name, symbol in (("length", "o"), ("width", "s"))
        ]
        self._unlikely = self.plot.plot(pen=None, symbol="x", symbolSize=9)
        self._now = self.plot.plot(pen=None, symbol="o", symbolSize=13)
        legend.addItem(self._truths[0], "solver, dots seen")
        legend.addItem(self._unlikely, "unlikely")
        #: Shown instead of axes without a curve.
        self.empty = wrapped_label(_NO_CURVE)
        self.empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        vbox((self.empty, 1), (self.plot, 1), within=self, margins=0)
        self.plot.follow_theme(self._recolor)
        self.redraw()

    def add(self, view: StrainView) -> None:
        """Add a measurement; it replaces an earlier one of the same frame, as in a loop."""
        added = CurvePoint.of(view)
        self._newest = added.sequence
        self.merge([added])

    def merge(self, points: list[CurvePoint]) -> None:
        """Add points; they replace those of the same frames. Above `MAX_POINTS` the oldest frames are dropped."""
        by_frame = {point.sequence: point for point in (*self.points, *points)}
        self.points = [by_frame[sequence] for sequence in sorted(by_frame)][-MAX_POINTS:]
        self.redraw()

    def complete(self, view: StrainView) -> None:
        """Replace the newest point by a more complete measurement of the same frame."""
        if self.points and self._newest == view.task.frame.sequence:
            self.merge([CurvePoint.of(view)])

    def set_spacing_mm(self, spacing_mm: float) -> None:
        """Set the dot spacing on the flat sheet; measured lengths stay the same."""
        self._spacing_mm = spacing_mm
        self.redraw()

    def reset(self) -> None:
        """Delete all points."""
        self.points = []
        self.redraw()

    def redraw(self) -> None:
        """Draw the points whose displacement is known, in the order of their frames."""
        known = [point for point in self.points if point.displacement_mm is not None]
        self.plot.setVisible(bool(known))
        self.empty.setVisible(not known)
        x = np.array([point.displacement_mm for point in known], np.float64)
        strains = np.array([point.at_spacing(self._spacing_mm) for point in known]).reshape(-1, 2)
        unlikely = self._judged(known)
        for number, curve in enumerate(self._curves):
            curve.setData(x, np.where(unlikely[:, number], np.nan, strains[:, number]), connect="finite")
        places, axes = np.nonzero(unlikely)
        self._unlikely.setData(x[places], strains[places, axes])
        judged = [point for point in known if point.truth is not None]
        for number, marks in enumerate(self._truths):
            values = [point.truth[2 + number] for point in judged if point.truth is not None]
            marks.setData([point.displacement_mm for point in judged], values)
        last = [point for point in known if point.sequence == self._newest]
        self._now.setData(
            [point.displacement_mm for point in last for _ in range(2)],
            [strain for point in last for strain in point.at_spacing(self._spacing_mm)],
        )

    def _judged(self, known: list[CurvePoint]) -> BoolArray:
        """Tell which strains along length and width are unlikely, shape (N, 2); the displacement must be known."""
        moved = np.array([point.displacement_mm for point in known], np.float64)
        return np.column_stack(
            [
                spikes(moved, [point.strain[axis] for point in known], [point.sigma[axis] for point in known])
                for axis in range(2)
            ]
        )

    def as_csv(self) -> str:
        """Return all points as CSV, one per line, in the order of their frames."""
        known = [point for point in self.points if point.displacement_mm is not None]
        unlikely = {point.sequence: marks for point, marks in zip(known, self._judged(known), strict=True)}
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(_COLUMNS)
        for point in self.points:
            marks = unlikely.get(point.sequence, (False, False))
            writer.writerow([*point.row(self._spacing_mm), *(int(mark) for mark in marks)])
        return text.getvalue()

    def _recolor(self, colors: ThemeColors) -> None:
        for curve, marks, rgb in zip(self._curves, self._truths, (LENGTH_RGB, WIDTH_RGB), strict=True):
            curve.setPen(pg.mkPen(rgb, width=1.5))
            curve.setSymbolBrush(pg.mkBrush(rgb))
            curve.setSymbolPen(None)
            marks.setSymbolPen(pg.mkPen(colors.text))
        self._unlikely.setSymbolPen(pg.mkPen(colors.text, width=1.5))
        self._now.setSymbolBrush(None)
        self._now.setSymbolPen(pg.mkPen(colors.text, width=1.5))


_TITLES = ("", "Largest", "Where", "Solver, seen", "Solver, all")
_TIPS = (
    "",
    "Largest strain between neighbouring dots, with its standard deviation",
    "Midpoint between both dots, in pixels of the tactile colour image; marked in the map",
    "The simulator's largest strain between neighbouring dots that the tactile camera sees completely",
    "The simulator's largest strain between all neighbouring dots; hidden dots cannot be measured",
)
_NOTHING = "–"


class StrainNumbers(QWidget):
    """The result as a sentence, and one line each for length and width."""

    def __init__(self) -> None:
        super().__init__()
        self.verdict = wrapped_label(verdict=True)
        self.cells = [[QLabel(_NOTHING) for _ in _TITLES] for _ in range(2)]
        layout = QGridLayout(self)
        layout.setContentsMargins(8, 4, 4, 4)
        layout.setHorizontalSpacing(12)
        layout.addWidget(self.verdict, 0, 0, 1, len(_TITLES) + 1)
        for column, (title, tip) in enumerate(zip(_TITLES, _TIPS, strict=True)):
            head = QLabel(title)
            head.setForegroundRole(head.palette().ColorRole.PlaceholderText)
            head.setToolTip(tip)
            layout.addWidget(head, 1, column)
            for row, name, rgb in ((0, "length", LENGTH_RGB), (1, "width", WIDTH_RGB)):
                label = self.cells[row][column]
                label.setToolTip(tip)
                label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
                if column == 0:
                    label.setTextFormat(Qt.TextFormat.RichText)
                    label.setText(f'<span style="color: rgb{rgb}">■</span> along the {name}')
                layout.addWidget(label, 2 + row, column)
        layout.setColumnStretch(len(_TITLES), 1)
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)

    def show_view(self, view: StrainView) -> None:
        """Show a measurement, or the reason why there is none."""
        measured = view.measured
        self.verdict.setText(_verdict(view))
        for row, name in enumerate(("length", "width")):
            texts = [_NOTHING] * 4
            if measured is not None:
                axis: AxisStrain = getattr(measured, name)
                texts[:2] = [
                    f"{100 * axis.largest:.1f} ± {100 * axis.largest_sigma:.1f} %",
                    _where(axis, measured.pixels),
                ]
            if view.truth is not None:
                seen, every = getattr(view.truth, f"{name}_seen"), getattr(view.truth, name)
                texts[2:] = [f"{100 * seen:.1f} %", f"{100 * every:.1f} %"]
            for label, text in zip(self.cells[row][1:], texts, strict=True):
                label.setText(text)


def _verdict(view: StrainView) -> str:
    measured = view.measured
    if measured is None:
        return view.problem[:1].upper() + view.problem[1:] + "."
    largest = 100 * max(measured.length.largest, measured.width.largest)
    words = f"Largest in-plane strain {largest:.1f} %"
    if view.displacement_mm is not None:
        words += f" at {view.displacement_mm:.1f} mm displacement"
    return f"{words} ({measured.dots} dots)"


def _where(axis: AxisStrain, pixels: Float64Array) -> str:
    u, v = largest_pair(axis, pixels).mean(axis=0)
    return f"({u:.0f}, {v:.0f}) px"
