"""What the tab Membrane strain shows: the strain map over the tactile colour image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import pyqtSignal

from ...core.lab.strain import AxisStrain, StrainMeasurement
from ...core.model.arrays import Float64Array, Uint8Array
from ...core.model.frames import TrueStrain
from ...widgets.basics.colormaps import depth_lut
from ...widgets.images.image_pane import ColorBar, ImagePane, Swatch
from ..calibration.pictures import pack_rgb

#: Where strain is largest along the length and along the width; also the colours of the curve.
LENGTH_RGB, WIDTH_RGB = (235, 60, 40), (40, 150, 255)
#: Share of the map's colour over the image, and the bits of a pixel's fraction in which squares are drawn.
_OPACITY, _SHIFT = 0.7, 4
#: The colours end at a multiple of this, 10 %.
_ROUNDED: Final = 0.10


@dataclass(frozen=True, eq=False)
class StrainView:
    """One measurement, or the reason why there is none (``problem``).

    ``averaged`` counts the averaged frames; the displacement is from the untouched frame, nan without one.
    """

    spacing_m: float
    averaged: int
    color: Uint8Array | None
    displacement_mm: float
    truth: TrueStrain | None
    measured: StrainMeasurement | None = None
    problem: str = ""

    def values(self, shown: str) -> Float64Array:
        """Return the strain that colours each grid cell."""
        assert self.measured is not None
        length, width = self.measured.cell_strain.T
        return np.asarray({"Largest": np.maximum(length, width), "Along length": length}.get(shown, width))


def largest_pair(axis: AxisStrain, pixels: Float64Array) -> Float64Array:
    """Return the two dots with the largest strain between them, pixels (2, 2)."""
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
    """Shows one measurement; the wheel zooms, a drag pans, a double click shows all.

    Signals
    -------
    pointed(text: str)
        The strain of the grid cell under the mouse; empty outside of the grid.
    """

    pointed = pyqtSignal(str)

    def __init__(self) -> None:
        super().__init__("Strain map (tactile colour image)")
        self._view: StrainView | None = None
        self._fitted = False
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
        self.view.setToolTip("Wheel: zoom; drag: move; double click: show all; hover over a square to read its strain")
        self.hovered.connect(self._hovered)
        self.doubleClicked.connect(self.show_all)
        self.viewMoved.connect(lambda: setattr(self, "_fitted", True))
        self.resized.connect(self._fit)

    def show_view(self, view: StrainView | None, shown: str, message: str) -> None:
        """Show a measurement; without one, the image and the reason."""
        self._view = view
        image = None if view is None or view.color is None else view.color.copy()
        measured = view.measured if view is not None else None
        self.header.set_legend(None)
        if view is not None and view.color is not None and measured is not None and image is not None:
            values = view.values(shown)
            low, high = _color_range(values)
            rows = np.clip((values - low) / (high - low) * 255.0, 0, 255).astype(np.intp)
            corners = np.rint(measured.pixels[measured.cells] * (1 << _SHIFT)).astype(np.int32)
            for places, row in zip(corners, rows, strict=True):
                color = [int(channel) for channel in _map_lut()[row, :3]]
                cv2.fillConvexPoly(image, places, color, cv2.LINE_AA, _SHIFT)
            image = np.asarray(cv2.addWeighted(image, _OPACITY, view.color, 1.0 - _OPACITY, 0.0), dtype=np.uint8)
            bar = ColorBar(f"{100 * low:.0f} %", f"{100 * high:.0f} %", _map_lut())
            marks = (Swatch("largest along length", LENGTH_RGB), Swatch("largest along width", WIDTH_RGB))
            self.header.set_legend(bar, marks)
        size = (640, 480) if image is None else (image.shape[1], image.shape[0])
        changed = size != self._size
        self.set_pixels(None if image is None else pack_rgb(image), size, 1)
        self.set_message(message if image is None else "")
        if changed:
            self.show_all()
        for item in (self._dots, *self._peaks):
            item.setVisible(measured is not None)
        if measured is not None:
            self._dots.setData(*measured.pixels.T)
            for peak, axis in zip(self._peaks, (measured.length, measured.width), strict=True):
                peak.setData(*largest_pair(axis, measured.pixels).T)

    def show_all(self) -> None:
        """Show the whole image."""
        self._fitted = False
        self._fit()

    def _fit(self) -> None:
        if not self._fitted:
            self.show_rect(self.image_rect())

    def _hovered(self, u: int, v: int) -> None:
        measured = self._view.measured if self._view is not None else None
        text = ""
        if measured is not None and u >= 0 and len(measured.cells):
            corners = measured.pixels[measured.cells]
            edges, to = np.roll(corners, -1, axis=1) - corners, np.array([u, v]) - corners
            turn = edges[..., 0] * to[..., 1] - edges[..., 1] * to[..., 0]
            for cell in np.flatnonzero((turn >= 0).all(axis=1) | (turn <= 0).all(axis=1))[:1]:
                length, width = 100 * measured.cell_strain[cell]
                text = f"Square at ({u}, {v}): {length:.1f} % along length, {width:.1f} % along width"
        self.pointed.emit(text)
