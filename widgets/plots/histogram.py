"""The live histogram of relative differences, with the tolerance as two lines to drag."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pyqtgraph as pg
from PyQt6.QtCore import QEvent, Qt, pyqtSignal
from PyQt6.QtGui import QColor
from PyQt6.QtWidgets import QVBoxLayout, QWidget

from ...core.model.arrays import AnyArray, Float64Array
from ..basics.fields import format_number
from ..basics.gestures import GestureClock
from ..basics.theme import theme_colors

_SMALLEST_T = 0.001
_LARGEST_T = 1.0


class _PercentAxis(pg.AxisItem):  # type: ignore[misc]  # pyqtgraph has no types
    def tickStrings(self, values: list[float], scale: float, spacing: float) -> list[str]:
        return [f"{format_number(value, 3)} %" for value in values]


class DifferenceHistogram(QWidget):
    """Counts of (dp - dt) / dp in percent; inside +-t in the accent colour.

    Signals
    -------
    toleranceEdited(t: float, gesture: int)
        A line was dragged; the other one mirrors it.
    """

    toleranceEdited = pyqtSignal(float, int)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._t = 0.03
        self._counts: Float64Array = np.zeros(1)
        self._edges: Float64Array = np.array([-0.1, 0.1])
        self._stale = False
        self._clock = GestureClock()
        self.plot_widget = pg.PlotWidget(axisItems={"bottom": _PercentAxis("bottom")})
        self.plot_widget.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.plot_widget.setMinimumWidth(200)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.plot_widget)
        self.setFixedHeight(120)
        self.setAccessibleName("Histogram of relative differences")
        self.setToolTip(
            "Relative differences (dp - dt) / dp of the latest frame in percent. "
            "Points between the lines pass the tolerance test; drag a line to change t."
        )
        plot = self._plot = self.plot_widget.getPlotItem()
        plot.setMenuEnabled(False)
        plot.hideButtons()
        plot.hideAxis("left")
        plot.setMouseEnabled(x=False, y=False)
        plot.setContentsMargins(0, 2, 0, 0)
        plot.getAxis("bottom").setHeight(18)
        self._outside = pg.PlotCurveItem([0.0, 1.0], [0.0], stepMode="center", fillLevel=0)
        self._inside = pg.PlotCurveItem([0.0, 1.0], [0.0], stepMode="center", fillLevel=0)
        self.lines = [pg.InfiniteLine(angle=90, movable=True) for _ in range(2)]
        for item in (self._outside, self._inside, *self.lines):
            plot.addItem(item)
        for line in self.lines:
            line.sigDragged.connect(self._dragged)
            line.sigPositionChangeFinished.connect(self._clock.release)
        self._caption = pg.TextItem("(dp − dt) / dp", anchor=(0, 0))
        self._caption.setParentItem(plot.getViewBox())
        self._caption.setPos(2, 0)
        self._place_lines()
        self._recolor()

    def set_data(self, counts: AnyArray, edges: npt.NDArray[np.floating], t: float | None = None) -> None:
        """Show other counts.

        Parameters
        ----------
        counts : array, shape (N,)
        edges : array, shape (N + 1,)
            Relative differences, increasing.
        t : float, optional
            Moves the lines too, unless one is being dragged.
        """
        self._counts = np.asarray(counts, dtype=np.float64)
        self._edges = np.asarray(edges, dtype=np.float64)
        if t is not None and not self._dragging():
            self._t = t
            self._place_lines()
        self._draw()

    def set_tolerance(self, t: float) -> None:
        """Move the lines; never emits."""
        if t != self._t:
            self._t = t
            self._place_lines()
            self._draw()

    def tolerance(self) -> float:
        """Return the tolerance that the lines show."""
        return self._t

    def changeEvent(self, event: QEvent | None) -> None:
        """Follow the theme."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.PaletteChange:
            self._recolor()

    def showEvent(self, event: Any) -> None:
        """Draw the counts that arrived while hidden."""
        super().showEvent(event)
        if self._stale:
            self._draw()

    def _dragging(self) -> bool:
        return any(line.moving for line in self.lines)

    def _dragged(self, line: Any) -> None:
        if not self._clock.held:
            self._clock.hold()
        t = min(max(abs(line.value()) / 100.0, _SMALLEST_T), _LARGEST_T)
        self._t = float(f"{t:.3g}")
        self._place_lines()
        self._draw()
        self.toleranceEdited.emit(self._t, self._clock.number())

    def _place_lines(self) -> None:
        for line, sign in zip(self.lines, (-1, 1), strict=True):
            line.setValue(sign * self._t * 100.0)

    def _draw(self) -> None:
        self._stale = not self.isVisible()
        if self._stale:
            return
        edges, counts = split_at(self._edges, self._counts, (-self._t, self._t))
        centres = (edges[:-1] + edges[1:]) / 2
        inside = np.where(np.abs(centres) <= self._t, counts, 0.0)
        percent = edges * 100.0
        self._outside.setData(percent, counts)
        self._inside.setData(percent, inside)
        reach = max(abs(percent[0]), abs(percent[-1]), self._t * 110.0, 0.1)
        top = float(counts.max(initial=1.0))
        if not self._dragging():  # a scale that moved under the mouse would run away with the line
            self._plot.getViewBox().setXRange(-reach, reach, padding=0)
        self._plot.getViewBox().setYRange(0.0, top * 1.05, padding=0)

    def _recolor(self) -> None:
        colors = theme_colors()
        self.plot_widget.setBackground(colors.base)
        axis = self._plot.getAxis("bottom")
        axis.setPen(colors.border)
        axis.setTextPen(colors.text)
        self._caption.setColor(colors.muted)
        for curve, value in ((self._outside, colors.outside), (self._inside, colors.accent)):
            curve.setPen(None)
            curve.setBrush(QColor(value))
        for line in self.lines:
            line.setPen(pg.mkPen(colors.accent_text, width=2))
            line.setHoverPen(pg.mkPen(colors.text, width=3))


def split_at(edges: Float64Array, counts: Float64Array, cuts: tuple[float, ...]) -> tuple[Float64Array, Float64Array]:
    """Split the bars of a histogram at given positions, so that each part can have its own colour.

    Returns
    -------
    edges, counts
        With one bar more per cut inside the range; both parts of a bar keep its height.
    """
    for cut in cuts:
        index = int(np.searchsorted(edges, cut))
        if 0 < index < len(edges) and edges[index] != cut:
            edges = np.insert(edges, index, cut)
            counts = np.insert(counts, index, counts[index - 1])
    return edges, counts
