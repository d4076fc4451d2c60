"""Curves over the last seconds, such as the errors of a tracked pose."""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np
import pyqtgraph as pg
from PyQt6.QtWidgets import QWidget

from ..basics.controls import wrapped_label
from ..basics.layouts import vbox
from ..basics.theme import ThemeColors, text_font
from .plot import Plot

#: Frames that are kept, 20 s at 30 frames/s.
_FRAMES: Final = 600
_HEIGHT: Final = 96
#: A gap in the curves: frames farther apart than this, seconds, are not joined.
_GAP_S: Final = 2.0


class PosePlot(QWidget):
    """Residual and error of the position, mm, and error of the rotation, degrees, over time, s."""

    def __init__(self) -> None:
        super().__init__()
        self._rows: deque[tuple[float, float, float, float]] = deque(maxlen=_FRAMES)
        self.setAccessibleName("Errors over time")
        self.setToolTip(
            "Over the last 20 s: the residual, the RMS distance of the patch to the model; where the source knows the "
            "true pose, the errors of position and rotation in the directions that the patch determines"
        )
        self.lengths, self.angles = self._plot("mm"), self._plot("degrees")
        self.residual, self.position, self.angle = (pg.PlotDataItem(connect="finite") for _ in range(3))
        for plot, curve in ((self.lengths, self.residual), (self.lengths, self.position), (self.angles, self.angle)):
            plot.addItem(curve)
        self.angles.setXLink(self.lengths)
        self.about = wrapped_label()
        self.about.setFont(text_font("caption"))
        vbox(self.lengths, self.angles, self.about, within=self, margins=0, spacing=4)
        self.angles.follow_theme()
        self.lengths.follow_theme(self._recolor)
        self._show()

    def _plot(self, unit: str) -> Plot:
        plot = Plot(left=unit)
        plot.setFixedHeight(_HEIGHT)
        item = plot.getPlotItem()
        item.setContentsMargins(0, 8, 8, 0)
        item.getAxis("left").setWidth(44)
        return plot

    @property
    def filled(self) -> bool:
        return any(np.isfinite(residual_mm) for _, residual_mm, _, _ in self._rows)

    def clear(self) -> None:
        self._rows.clear()
        self._show()

    def add(self, time_s: float, residual_mm: float, position_mm: float, angle_deg: float) -> None:
        """Add a frame; nan where a value is not known. A time before the last one begins anew."""
        if self._rows and time_s < self._rows[-1][0]:
            self._rows.clear()
        if self._rows and time_s > self._rows[-1][0] + _GAP_S:
            self._rows.append((time_s, *(float("nan"),) * 3))
        self._rows.append((time_s, residual_mm, position_mm, angle_deg))
        self._show()

    def _show(self) -> None:
        times, residual, position, angle = zip(*self._rows, strict=True) if self._rows else ((), (), (), ())
        for curve, values in ((self.residual, residual), (self.position, position), (self.angle, angle)):
            curve.setData(times, values)
        known = bool(np.isfinite(angle).any())
        for plot, values in ((self.lengths, (*residual, *position)), (self.angles, angle)):
            shown = np.array(values)[np.isfinite(values)]
            plot.setYRange(0.0, float(shown.max()) if len(shown) else 1.0, padding=0.05)
        self.angles.setVisible(known)
        true = (
            "Blue: error in the directions that the patch determines. " if known else "This source knows no true pose. "
        )
        self.about.setText(f"{true}Grey: residual. Over time in seconds.")

    def _recolor(self, colors: ThemeColors) -> None:
        self.residual.setPen(pg.mkPen(colors.outside, width=1))
        for curve in (self.position, self.angle):
            curve.setPen(pg.mkPen(colors.accent, width=2))
