"""The live histogram of what a contact test limits, with the limit as lines to drag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyqtgraph as pg
from PyQt6.QtCore import pyqtSignal
from PyQt6.QtGui import QColor
from PyQt6.QtWidgets import QWidget

from ...core.model.arrays import AnyArray, Float64Array
from ..basics.controls import GestureClock, named
from ..basics.layouts import vbox
from ..basics.theme import ThemeColors
from .plot import Plot


@dataclass(frozen=True)
class Quantity:
    """What is counted, shown times ``factor`` in ``unit``; ``limits`` is where the limit can be dragged."""

    name: str
    caption: str
    tip: str
    factor: float
    unit: str
    limits: tuple[float, float]
    symmetric: bool


RELATIVE_DIFFERENCE: Final = Quantity(
    "Histogram of relative differences",
    "(dp − dt) / dp",
    "Relative differences (dp - dt) / dp of the latest frame in percent. Between the lines a point passes the "
    "tolerance test; drag a line to change t.",
    100.0, "%", (0.001, 1.0), True,
)  # fmt: skip
GAP: Final = Quantity(
    "Histogram of gaps",
    "gap in equilibrium",
    "Gaps between membrane and object in the latest frame in millimetres. Pixels left of the line are in contact; "
    "drag it to change the largest gap. A much taller bar at 0 is cut off.",
    1000.0, "mm", (0.0, 0.005), False,
)  # fmt: skip


class LimitHistogram(QWidget):
    """Counts of a quantity; what lies within the limit is in the accent colour."""

    limitEdited = pyqtSignal(float, int)  # limit, gesture: a line was dragged

    def __init__(self, quantity: Quantity, limit: float) -> None:
        super().__init__()
        self._quantity = quantity
        self._limit = limit
        self._counts: Float64Array = np.zeros(1)
        self._edges: Float64Array = np.array([-limit if quantity.symmetric else 0.0, limit])
        self._known = 0
        self._clock = GestureClock()
        self.plot_widget = Plot(unit=quantity.unit)
        self.plot_widget.setMinimumWidth(200)
        vbox(self.plot_widget, within=self, margins=0)
        self.setFixedHeight(96)
        named(self, quantity.name, quantity.tip)
        plot = self._plot = self.plot_widget.getPlotItem()
        plot.hideAxis("left")
        plot.setContentsMargins(0, 4, 0, 0)
        plot.getAxis("bottom").setHeight(18)
        self._outside = pg.PlotCurveItem([0.0, 1.0], [0.0], stepMode="center", fillLevel=0)
        self._inside = pg.PlotCurveItem([0.0, 1.0], [0.0], stepMode="center", fillLevel=0)
        self.lines = [pg.InfiniteLine(angle=90, movable=True) for _ in range(2 if quantity.symmetric else 1)]
        for item in (self._outside, self._inside, *self.lines):
            plot.addItem(item)
        for line in self.lines:
            line.sigDragged.connect(self._dragged)
            line.sigPositionChangeFinished.connect(self._clock.release)
        self._caption = pg.TextItem(quantity.caption, anchor=(0, 0) if quantity.symmetric else (1, 0))
        box = plot.getViewBox()
        self._caption.setParentItem(box)
        self._caption.setZValue(1e6)  # above the lines, which would strike it out
        # in the corner away from the tallest bars
        box.sigResized.connect(lambda: self._caption.setPos(2 if quantity.symmetric else box.width() - 2, 0))
        self._place_lines()
        self.plot_widget.follow_theme(self._recolor)

    def set_data(self, counts: AnyArray, edges: npt.NDArray[np.floating], known: int = 0) -> None:
        """Show counts, (N,), between increasing edges, (N + 1,); ``known`` counts the values beyond them too."""
        self._known = known
        self._counts = np.asarray(counts, dtype=np.float64)
        self._edges = np.asarray(edges, dtype=np.float64)
        self._draw()

    def clear(self) -> None:
        if self._known or self._counts.any():  # asked for with every frame without a patch: draw once
            self.set_data(np.zeros(1), self._edges[[0, -1]])

    def set_limit(self, limit: float) -> None:
        if limit != self._limit and not self._dragging():
            self._limit = limit
            self._place_lines()
            self._draw()

    def _dragging(self) -> bool:
        return any(line.moving for line in self.lines)

    def _dragged(self, line: Any) -> None:
        if not self._clock.held:
            self._clock.hold()
        smallest, largest = self._quantity.limits
        value = line.value() / self._quantity.factor
        limit = min(max(abs(value) if self._quantity.symmetric else value, smallest), largest)
        self._limit = float(f"{limit:.3g}")
        self._place_lines()
        self._draw()
        self.limitEdited.emit(self._limit, self._clock.number())

    def _place_lines(self) -> None:
        for line, sign in zip(self.lines, (1, -1), strict=False):
            line.setValue(sign * self._limit * self._quantity.factor)

    def _draw(self) -> None:
        symmetric, limit = self._quantity.symmetric, self._limit
        centres = (self._edges[:-1] + self._edges[1:]) / 2
        shown = self._edges * self._quantity.factor
        self._outside.setData(shown, self._counts)
        self._inside.setData(shown, np.where(np.abs(centres) <= limit, self._counts, 0.0))
        reach = max(abs(shown[0]), abs(shown[-1]), 1.1 * limit * self._quantity.factor, 0.1)
        # with one side, the bar at zero is contact itself, which would flatten all others
        tallest = 1.05 * self._counts.max(initial=1.0) if symmetric else 1.3 * self._counts[1:].max(initial=1.0)
        if not self._dragging():  # a scale that moved under the mouse would run away with the line
            self._plot.getViewBox().setXRange(-reach if symmetric else -0.01 * reach, reach, padding=0)
        self._plot.getViewBox().setYRange(0.0, tallest, padding=0)
        self._caption.setText(self.caption())

    def caption(self) -> str:
        """Return the share of all values within both lines, else the quantity."""
        if not (self._quantity.symmetric and self._known):
            return self._quantity.caption
        counted = np.concatenate([[0.0], np.cumsum(self._counts)])
        low, high = np.interp((-self._limit, self._limit), self._edges, counted)
        return f"{100 * (high - low) / self._known:.1f} % within t"

    def _recolor(self, colors: ThemeColors) -> None:
        self._caption.setColor(colors.muted)
        self._caption.fill = pg.mkBrush(colors.base)
        for curve, value in ((self._outside, colors.outside), (self._inside, colors.accent)):
            curve.setPen(None)
            curve.setBrush(QColor(value))
        for line in self.lines:
            line.setPen(pg.mkPen(colors.accent_text, width=2))
            line.setHoverPen(pg.mkPen(colors.text, width=3))
