"""A value of each frame over time, with a cursor to seek, and in and out marks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyqtgraph as pg
from PyQt6.QtCore import QEvent, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QKeyEvent, QMouseEvent
from PyQt6.QtWidgets import QWidget

from ...core.errors import minus
from ...core.model.arrays import BoolArray, Float64Array
from ..basics.controls import ChoiceBox, named
from ..basics.fields import format_number
from ..basics.layouts import vbox
from ..basics.theme import ThemeColors, text_font
from .plot import Plot


@dataclass(frozen=True)
class Curve:
    """One value over time: its key in the series, title, unit, tooltip, and why no frame has one."""

    key: str
    title: str
    unit: str
    tip: str
    missing: str = ""


CURVES: Final = (
    Curve("area_mm2", "Area", "mm²", "Area of the patch in mm², projected along the optical axis"),
    Curve("points", "Points", "points", "Number of points of the patch"),
    Curve("ms", "Time", "ms", "Time of the contact test in milliseconds, computed in the background on one core"),
    Curve(
        "force_n",
        "Force",
        "N",
        "Magnitude of the force in newtons, by the contact test pressure with a known inflation",
        "Needs the contact test pressure and its inflation",
    ),
    Curve(
        "force_mm2",
        "Force over inflation",
        "mm²",
        "Magnitude of the force over the inflation in mm², by the contact test pressure",
        "Needs the contact test pressure",
    ),
    Curve(
        "iou",
        "IoU",
        "",
        "Overlap of patch and true contact, 0 to 1; only for sources that know the truth",
        "No true contact: nothing touches, or this source does not know it",
    ),
)
#: Time that a live source shows, seconds.
LIVE_S: Final = 60.0
_HEIGHT = 72
#: Width of the axis, and height of the line over the plot with the curve's name and the value under the mouse, pixels.
_AXIS_PX, _TOP_PX = 44, 18
#: Frames that a key goes on, as in a slider.
_STEPS: Final[dict[int, int]] = {
    Qt.Key.Key_Left: -1,
    Qt.Key.Key_Right: 1,
    Qt.Key.Key_PageUp: -10,
    Qt.Key.Key_PageDown: 10,
    Qt.Key.Key_Home: -(10**9),
    Qt.Key.Key_End: 10**9,
}
#: The smallest part of a recording that zooming shows, frames.
_MIN_FRAMES = 10
#: A curve is interrupted where no frame is for longer than this, seconds, and than the usual interval times this.
STALL_S, STALL_FACTOR = 1.0, 3.0


class _StripPlot(Plot):
    """The left button seeks, wheel and middle button zoom and pan along the time."""

    def __init__(self, strip: TimeStrip) -> None:
        super().__init__(unit="s")
        self._strip = strip

    def time_at(self, event: QMouseEvent) -> float:
        place = self.mapToScene(event.position().toPoint())
        return float(self.getPlotItem().getViewBox().mapSceneToView(place).x())

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self._strip.hold(True)
            self._strip.seek(self.time_at(event))
        else:
            super().mousePressEvent(event)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        self._strip.hover(self.time_at(event))
        if event.buttons() & Qt.MouseButton.LeftButton:
            self._strip.seek(self.time_at(event))
        else:
            super().mouseMoveEvent(event)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self._strip.hold(False)
        else:
            super().mouseReleaseEvent(event)

    def mouseDoubleClickEvent(self, _: QMouseEvent) -> None:
        self._strip.show_all()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in _STEPS and event.modifiers() == Qt.KeyboardModifier.NoModifier:
            self._strip.step(_STEPS[event.key()])
        else:
            event.ignore()

    def leaveEvent(self, event: QEvent) -> None:
        super().leaveEvent(event)
        self._strip.show_words()


class TimeStrip(QWidget):
    """One curve over the time of a recording, or over the last minute of a live source."""

    seekRequested = pyqtSignal(int)  # index: a person clicked or dragged
    held = pyqtSignal(bool)  # the mouse button is down; playback should wait
    curveChosen = pyqtSignal(str)  # key

    def __init__(self) -> None:
        super().__init__()
        self.setFixedHeight(_HEIGHT)
        self.seconds: Float64Array = np.zeros(0)
        self._values: Mapping[str, Float64Array] = {}
        self._computed: BoolArray = np.zeros(0, np.bool_)
        self._live = False
        self._index = -1
        self._trim: tuple[int, int] | None = None
        self._words = ""
        self._dragging = False
        self.curve_box = self._make_curve_box()
        self.plot_widget = _StripPlot(self)
        self._make_plot()
        vbox(self.plot_widget, within=self, margins=0)
        self.curve_box.setParent(self.plot_widget)
        self.curve_box.move(_AXIS_PX, 0)
        self._fit_curve_box()
        self.plot_widget.follow_theme(self._recolor)
        self._place_marks()

    def _make_curve_box(self) -> ChoiceBox:
        box = named(ChoiceBox(), "Curve of the time strip", "What the time strip shows")
        box.setProperty("plain", True)
        box.setFont(text_font("caption"))
        for number, curve in enumerate(CURVES):
            box.addItem(f"{curve.title}, {curve.unit}" if curve.unit else curve.title, curve.key)
            box.setItemData(number, curve.tip, Qt.ItemDataRole.ToolTipRole)
        if (view := box.view()) is not None:  # else the list is as narrow as the name chosen, and cuts longer ones
            longest = max((box.itemText(number) for number in range(len(CURVES))), key=len)
            view.setMinimumWidth(self.fontMetrics().horizontalAdvance(longest) + 16)
        box.currentIndexChanged.connect(lambda _: self._choose())
        return box

    def _make_plot(self) -> None:
        view = self.plot_widget
        view.setMouseTracking(True)
        view.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        tip = "Click or drag to seek, wheel to zoom, middle button to pan, double click to see everything. "
        named(view, "Time strip", f"{tip}Keys: arrows, page up and down, home and end.")
        plot = self._plot = view.getPlotItem()
        plot.setMouseEnabled(x=True, y=False)
        plot.setContentsMargins(0, _TOP_PX, 8, 0)
        plot.getAxis("left").setWidth(_AXIS_PX)
        plot.getAxis("bottom").setHeight(17)
        self._box = plot.getViewBox()
        self._outside = [pg.LinearRegionItem(movable=False) for _ in range(2)]
        self._line = pg.PlotCurveItem(connect="finite")
        self._cursor = pg.InfiniteLine(angle=90)
        self._text = pg.TextItem(anchor=(1, 0))
        self._text.setParentItem(plot)  # the box would clip what stands above it
        for item in (*self._outside, self._line, self._cursor):
            plot.addItem(item, ignoreBounds=True)
        self._box.sigResized.connect(self.show_words)

    @property
    def curve(self) -> Curve:
        return CURVES[self.curve_box.currentIndex()]

    def choose_curve(self, key: str) -> None:
        """Show another curve; an unknown key changes nothing."""
        self.curve_box.setCurrentIndex(max(0, self.curve_box.findData(key)))

    def set_series(self, seconds: Float64Array, values: Mapping[str, Float64Array], computed: BoolArray) -> None:
        """Show a recording: ``seconds`` since the first frame, and ``values`` by the keys of `CURVES`, or nan."""
        whole = self._live or len(seconds) != len(self.seconds) or self._box.viewRange()[0] == [0.0, self._end_s()]
        self._live = False
        self.seconds, self._values, self._computed = seconds, values, computed
        self._draw()
        self._limit()
        if whole:
            self.show_all()
        self._place_marks()

    def set_live(self, seconds: Float64Array, values: Mapping[str, Float64Array]) -> None:
        """Show the last minute of a live source; ``seconds`` are at most 0, which is now."""
        if not self._live:
            self._live, self._trim = True, None
            self._place_marks()
            self._box.setLimits(xMin=-LIVE_S, xMax=0.0, minXRange=1.0, maxXRange=LIVE_S)
            self._box.setXRange(-LIVE_S, 0.0, padding=0)
        self.seconds, self._values, self._computed = seconds, values, np.ones(len(seconds), np.bool_)
        self._draw()

    def set_cursor(self, index: int) -> None:
        """Show which frame is on the screen; if the strip is zoomed in, it follows. While dragged it stays."""
        if index != self._index and not self._dragging:
            self._index = index
            self._place_cursor()

    def set_trim(self, trim: tuple[int, int] | None) -> None:
        """Shade what lies outside the in and out marks (first frame, the one behind the last)."""
        self._trim = trim
        self._place_marks()

    def set_words(self, words: str) -> None:
        """Show progress or a problem while nothing is hovered."""
        self._words = words
        self.show_words()

    @property
    def words(self) -> str:
        return str(self._text.toPlainText())

    def show_all(self) -> None:
        if len(self.seconds) and not self._live:
            self._box.setXRange(0.0, self._end_s(), padding=0)

    def _end_s(self) -> float:
        return max(float(self.seconds[-1]), 1e-3)

    def _limit(self) -> None:
        end_s = self._end_s()
        shortest_s = end_s * min(1.0, _MIN_FRAMES / len(self.seconds))
        self._box.setLimits(xMin=0.0, xMax=end_s, minXRange=shortest_s, maxXRange=end_s)

    def _choose(self) -> None:
        self._fit_curve_box()
        self._draw()
        self.show_words()
        self.curveChosen.emit(self.curve.key)

    def _fit_curve_box(self) -> None:
        self.curve_box.setFixedWidth(self.curve_box.fontMetrics().horizontalAdvance(self.curve_box.currentText()) + 28)

    def _draw(self) -> None:
        curve = self.curve
        shown = self._values.get(curve.key, np.full(len(self.seconds), math.nan))
        known = np.flatnonzero(self._computed)
        joined: Any = "finite"
        if not self._live and len(known) > 1:  # single lost frames leave no gap
            steps_s = np.diff(self.seconds)
            lost = np.append(0, np.cumsum(steps_s > max(STALL_S, STALL_FACTOR * np.median(steps_s))))[known]
            joined = np.append((lost[1:] == lost[:-1]) & np.isfinite(shown[known][1:] + shown[known][:-1]), False)
        self._line.setData(self.seconds[known], shown[known], connect=joined)
        top = float(shown[np.isfinite(shown)].max(initial=0.0)) or 1.0
        height = 1.0 if curve.key == "iou" or top == 1.0 else 1.08 * top
        # three numbers at most: pyqtgraph's own would stand over each other
        power = 10.0 ** math.floor(math.log10(height / 3))
        spacing = next(each for factor in (1, 2, 5, 10) if (each := factor * power) >= height / 3)
        self._plot.getAxis("left").setTickSpacing(spacing, spacing)
        self._box.setYRange(0.0, height, padding=0)

    def _place_cursor(self) -> None:
        there = 0 <= self._index < len(self.seconds) and not self._live
        self._cursor.setVisible(there)
        if not there:
            return
        now_s = float(self.seconds[self._index])
        self._cursor.setValue(now_s)
        (first_s, last_s), _ = self._box.viewRange()
        if not first_s <= now_s <= last_s:
            self._box.setXRange(now_s, now_s + last_s - first_s, padding=0)

    def _place_marks(self) -> None:
        length = len(self.seconds)
        marked = self._trim is not None and length > 0 and not self._live
        for part in self._outside:
            part.setVisible(marked)
        if self._trim is not None and marked:
            first, last = (min(max(index, 0), length - 1) for index in (self._trim[0], self._trim[1] - 1))
            self._outside[0].setRegion((0.0, float(self.seconds[first])))
            self._outside[1].setRegion((float(self.seconds[last]), self._end_s()))
        self._place_cursor()

    def _frame_at(self, time_s: float) -> int:
        return int(np.abs(self.seconds - time_s).argmin())

    def hold(self, held: bool) -> None:
        if not self._live:
            self._dragging = held
            self.held.emit(held)

    def seek(self, time_s: float) -> None:
        if len(self.seconds):
            self._go_to(self._frame_at(time_s))

    def step(self, frames: int) -> None:
        """Go some frames on, or back, at most to an end."""
        self._go_to(min(max(self._index + frames, 0), len(self.seconds) - 1))

    def _go_to(self, index: int) -> None:
        if index != self._index and not self._live and len(self.seconds):
            self._index = index
            self._place_cursor()
            self.seekRequested.emit(index)

    def hover(self, time_s: float) -> None:
        if not len(self.seconds):
            return
        index, curve = self._frame_at(time_s), self.curve
        value = float(self._values[curve.key][index]) if curve.key in self._values else math.nan
        known = f"{minus(format_number(value, 3))} {curve.unit}".rstrip() if math.isfinite(value) else "not known"
        place = f"{self.seconds[index]:.1f} s" + ("" if self._live else f", frame {index}")
        self._write(f"{place}: {known}")

    def show_words(self) -> None:
        values = self._values.get(self.curve.key)
        empty = values is not None and bool(self._computed.any()) and not np.isfinite(values).any()
        self._write(self._words or (self.curve.missing if empty else ""))

    def _write(self, text: str) -> None:
        room, metrics = int(max(100, self._box.width() - 16)), self.fontMetrics()
        beside = metrics.horizontalAdvance(text) <= room - self.curve_box.width()
        self._text.setPos(self._box.geometry().right() - 2, -3 if beside else _TOP_PX - 3)
        self._text.setText(metrics.elidedText(text, Qt.TextElideMode.ElideRight, room))
        self._text.setVisible(bool(text))  # an empty one would still have its background

    def _recolor(self, colors: ThemeColors) -> None:
        self._line.setPen(pg.mkPen(colors.accent_text))
        self._cursor.setPen(pg.mkPen(colors.text, width=2))
        self._text.setColor(colors.text)
        self._text.fill = pg.mkBrush(colors.base)
        veil = QColor(colors.outside)
        veil.setAlpha(110)
        for part, edge in zip(self._outside, (1, 0), strict=True):
            part.setBrush(veil)
            part.lines[edge].setPen(pg.mkPen(colors.error, width=2))
            part.lines[1 - edge].setPen(None)
        self._draw()
