"""The strain map: colours over the tactile colour image, the grid's dots and lines, and where strain is largest."""

from __future__ import annotations

import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import pyqtSignal

from ...core.model.arrays import Float64Array, IndexArray
from ...core.strain.field import AxisStrain
from ...widgets.images.image_pane import ImagePane
from ...widgets.images.pane_header import ColorBar, Swatch
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
        self.view.setToolTip("Wheel: zoom; drag: move; double click: show all; point at a square to read its strain")
        self.hovered.connect(self._hovered)
        self.doubleClicked.connect(self.show_all)
        self.viewMoved.connect(lambda: setattr(self, "_fitted", True))
        self.resized.connect(self._fit)

    def show_view(self, view: StrainView | None, shown: MapOf, message: str) -> None:
        """Show a measurement, or only its image with what stands in its way."""
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
    """Return both dots between which strain is largest, shape (2, 2), pixels."""
    return np.asarray(pixels[axis.pairs[np.argmax(axis.strain)]])


def _inside(corners: Float64Array, u: float, v: float) -> IndexArray:
    """Return the numbers of the convex quadrilaterals, shape (K, 4, 2), that contain a place."""
    edges = np.roll(corners, -1, axis=1) - corners
    to = np.array([u, v]) - corners
    turn = edges[..., 0] * to[..., 1] - edges[..., 1] * to[..., 0]
    return np.flatnonzero((turn >= 0).all(axis=1) | (turn <= 0).all(axis=1))
