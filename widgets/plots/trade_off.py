"""A plot of trials: run time against another figure, with the front of those that no other beats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pyqtgraph as pg
from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QColor, QKeyEvent
from PyQt6.QtWidgets import QWidget

from ..basics.layouts import vbox
from ..basics.theme import theme_colors
from .plot import Plot

_DOT_PX, _RING_PX = 9, 17


@dataclass(frozen=True)
class Dot:
    """One trial, in the units of the axes; ``words`` are shown while the pointer is over the dot."""

    number: int
    x: float
    y: float
    words: str


class TradeOffPlot(QWidget):
    """Dots to hover over and to click; Left and Right walk along the front."""

    pointed = pyqtSignal(str)  # words: the pointer is over a dot; empty when it leaves
    chosen = pyqtSignal(int)  # number: a dot was clicked or reached by a key
    accepted = pyqtSignal()  # enter was pressed

    def __init__(self) -> None:
        super().__init__()
        self._dots: dict[int, Dot] = {}
        self.front: tuple[int, ...] = ()
        self._present = -1
        self.number = -1
        self.plot_widget = Plot()
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName("Trials: time against error")
        vbox(self.plot_widget, within=self, margins=0)
        plot = self._plot = self.plot_widget.getPlotItem()
        plot.showGrid(x=True, y=True, alpha=0.15)
        self._line = pg.PlotCurveItem()
        self._ring = pg.ScatterPlotItem(size=_RING_PX)
        self.scatter = pg.ScatterPlotItem(size=_DOT_PX, hoverable=True, tip=None, hoverSize=_DOT_PX + 4)
        for item in (self._line, self._ring, self.scatter):
            plot.addItem(item)
        self.scatter.sigHovered.connect(self._hovered)
        self.scatter.sigClicked.connect(self._clicked)
        self.plot_widget.follow_theme(lambda _colors: self._draw())

    def set_axes(self, x: str, y: str) -> None:
        for axis, text in (("bottom", x), ("left", y)):
            self._plot.setLabel(axis, text)

    def set_dots(self, dots: Sequence[Dot], front: Sequence[int], present: int = -1) -> None:
        """Show other dots, the front of those that no other beats, and the present preset, -1 for none."""
        self._dots = {dot.number: dot for dot in dots}
        self.front = tuple(sorted((n for n in front if n in self._dots), key=lambda n: self._dots[n].x))
        self._present = present
        if self.number not in self._dots:
            self.number = -1
        self._draw()

    def choose(self, number: int) -> None:
        self.number = number
        self._draw()

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        assert event is not None
        steps = {Qt.Key.Key_Left: -1, Qt.Key.Key_Right: 1}
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and self.number >= 0:
            self.accepted.emit()
        elif event.key() in steps and self.front:
            step = steps[Qt.Key(event.key())]
            at = self.front.index(self.number) + step if self.number in self.front else min(0, step)
            self._choose(self.front[at % len(self.front)])
        else:
            super().keyPressEvent(event)

    def _draw(self) -> None:
        colors = theme_colors()
        for side in ("left", "bottom"):
            self._plot.getAxis(side).setStyle(showValues=bool(self._dots))  # the numbers of an empty plot mean nothing
        front = set(self.front)
        self.scatter.setData(
            [
                {
                    "pos": (dot.x, dot.y),
                    "data": dot.number,
                    "symbol": "d" if dot.number == self._present else "o",
                    "brush": QColor(colors.accent if dot.number in front else colors.outside),
                    "pen": pg.mkPen(colors.text if dot.number == self._present else colors.base),
                    "size": _DOT_PX + 5 * (dot.number == self._present),
                }
                for dot in sorted(self._dots.values(), key=lambda dot: dot.number in front)
            ]
        )
        line = [self._dots[number] for number in self.front]
        self._line.setData([dot.x for dot in line], [dot.y for dot in line])
        self._line.setPen(pg.mkPen(colors.accent, width=1.5))
        chosen = self._dots.get(self.number)
        self._ring.setData([{"pos": (chosen.x, chosen.y)}] if chosen else [])
        self._ring.setBrush(pg.mkBrush(None))
        self._ring.setPen(pg.mkPen(colors.text, width=2))

    def _hovered(self, _: Any, spots: Any, __: Any) -> None:
        words = self._dots[spots[0].data()].words if len(spots) else ""
        self.setToolTip(words)
        self.pointed.emit(words)

    def _clicked(self, _: Any, spots: Any, __: Any) -> None:
        self.setFocus()
        self._choose(spots[0].data())

    def _choose(self, number: int) -> None:
        self.choose(number)
        self.pointed.emit(self._dots[number].words)
        self.chosen.emit(number)
