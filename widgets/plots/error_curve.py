"""The curve of missed against false contact area over the values of one parameter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import QEvent, QObject, QPointF, Qt, pyqtSignal
from PyQt6.QtGui import QKeyEvent, QMouseEvent, QPaintEvent
from PyQt6.QtWidgets import QWidget

from ...core.model.arrays import Float64Array
from ..basics.controls import paint_focus, wrapped_label
from ..basics.layouts import vbox
from ..basics.theme import ThemeColors
from .plot import Plot

_CM2: Final = 0.01  # square centimetres per square millimetre


class ErrorCurvePlot(QWidget):
    """Missed against false area, with a ring at the present value and a dot at the suggested one.

    A press or drag on the plot chooses the nearest point of the curve; so do the arrow keys.
    """

    chosen = pyqtSignal(float)  # value: a person chose another value on the curve

    def __init__(self, shown: Callable[[float], str]) -> None:
        super().__init__()
        self._shown = shown
        self._values = self._missed = self._false = np.zeros(0)
        self._present = self._proposed = float("nan")
        self.plot = Plot("False area (cm²)", "Missed area (cm²)")
        self.plot.setFixedHeight(170)
        item = self.plot.getPlotItem()
        item.setContentsMargins(0, 8, 8, 0)
        self._line = pg.PlotDataItem(symbol="o", symbolSize=4, symbolPen=None)
        self._ring = pg.ScatterPlotItem(size=14)
        self._dot = pg.ScatterPlotItem(size=12)
        for curve in (self._line, self._ring, self._dot):
            item.addItem(curve)
        self.readout = wrapped_label()
        vbox(self.plot, self.readout, within=self, margins=4, spacing=4)  # room for the frame of the keyboard's focus
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName("Missed and false area")
        self.setToolTip(
            "Area of the examples' contact that is missed, against area that is wrongly taken for contact, for values "
            "of this parameter. Press or drag on the curve, or use the left and right arrow keys, to choose a value."
        )
        self.plot.viewport().installEventFilter(self)
        self.plot.follow_theme(self._recolor)

    def set_curve(self, values: Float64Array, missed_mm2: Float64Array, false_mm2: Float64Array) -> None:
        """Show another curve.

        Parameters
        ----------
        values : float64 (N,)
            The parameter, increasing.
        missed_mm2, false_mm2 : float64 (N,)
            Areas at each value.
        """
        self._values, self._missed, self._false = values, _CM2 * missed_mm2, _CM2 * false_mm2
        self._line.setData(self._false, self._missed)
        for axis, areas in (("setXRange", self._false), ("setYRange", self._missed)):
            getattr(self.plot, axis)(0.0, max(1.0, float(areas.max())), padding=0.08)
        self._show_points()

    def set_values(self, present: float, proposed: float) -> None:
        """Mark the present value and the suggested one."""
        self._present, self._proposed = present, proposed
        self._show_points()

    def point_at(self, value: float) -> QPointF:
        """Return where a value lies, in coordinates of ``plot.viewport()``."""
        false, missed = self._areas(value)
        return QPointF(self.plot.mapFromScene(self.plot.getPlotItem().vb.mapViewToScene(QPointF(false, missed))))

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Choose the point of the curve under the mouse."""
        if (
            isinstance(event, QMouseEvent)
            and event.type() in (QEvent.Type.MouseButtonPress, QEvent.Type.MouseMove)
            and event.buttons() & Qt.MouseButton.LeftButton
            and len(self._values)
        ):
            self.setFocus(Qt.FocusReason.MouseFocusReason)
            offsets = [(self.point_at(value) - event.position()) for value in self._values]
            self._choose(int(np.argmin([QPointF.dotProduct(offset, offset) for offset in offsets])))
            return True
        return super().eventFilter(watched, event)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        steps = {Qt.Key.Key_Left: -1, Qt.Key.Key_Right: 1}
        if event is None or event.key() not in steps or not len(self._values):
            super().keyPressEvent(event)
            return
        nearest = int(np.argmin(np.abs(self._values - self._proposed)))
        self._choose(min(max(nearest + steps[Qt.Key(event.key())], 0), len(self._values) - 1))

    def paintEvent(self, event: QPaintEvent | None) -> None:
        super().paintEvent(event)
        paint_focus(self)

    def _choose(self, index: int) -> None:
        value = float(self._values[index])
        if value != self._proposed:
            self.chosen.emit(value)

    def _areas(self, value: float) -> tuple[float, float]:
        """Return false and missed area at a value, interpolated, cm2."""
        return tuple(float(np.interp(value, self._values, areas)) for areas in (self._false, self._missed))  # type: ignore[return-value]

    def _show_points(self) -> None:
        if not len(self._values):
            return
        lines = []
        for mark, curve, word, value in (
            ("●", self._dot, "Suggested", self._proposed),
            ("○", self._ring, "Present", self._present),
        ):
            known = bool(np.isfinite(value))
            false, missed = self._areas(value) if known else (0.0, 0.0)
            curve.setData([false] if known else [], [missed] if known else [])
            if known:
                lines.append(f"{mark} {word} {self._shown(value)}: missed {missed:.2f} cm², false {false:.2f} cm²")
        self.readout.setText("\n".join(lines))

    def _recolor(self, colors: ThemeColors) -> None:
        self._line.setPen(pg.mkPen(colors.outside, width=2))
        self._line.setSymbolBrush(colors.outside)
        self._ring.setPen(pg.mkPen(colors.text, width=2))
        self._ring.setBrush(None)
        self._dot.setPen(None)
        self._dot.setBrush(colors.accent)
