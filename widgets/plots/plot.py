"""The plot that all others are made of: plain, and in the colours of the theme."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pyqtgraph as pg
from PyQt6.QtCore import Qt

from ...core.errors import minus
from ..basics.theme import THEME, ThemeColors, theme_colors


class _Axis(pg.AxisItem):  # type: ignore[misc]
    """An axis whose numbers have a unit; the wheel over it is the page's where the mouse does not scale the plot."""

    def __init__(self, side: str, unit: str) -> None:
        super().__init__(side)
        self._after = f" {unit}" if unit else ""

    def tickStrings(self, values: list[float], scale: float, spacing: float) -> list[str]:
        return [minus(text) + self._after for text in super().tickStrings(values, scale, spacing)]

    def wheelEvent(self, event: Any) -> None:
        if any(self.linkedView().mouseEnabled()):
            super().wheelEvent(event)
        else:
            event.ignore()


class Plot(pg.PlotWidget):  # type: ignore[misc]  # pyqtgraph has no types
    """A plot without menu and buttons that follows the theme; only if ``movable`` the mouse moves and scales it."""

    def __init__(self, bottom: str = "", left: str = "", *, movable: bool = False, unit: str = "") -> None:
        super().__init__(axisItems={"left": _Axis("left", ""), "bottom": _Axis("bottom", unit)})
        item = self.getPlotItem()
        item.setMenuEnabled(False)
        item.hideButtons()
        item.setMouseEnabled(x=movable, y=movable)
        if not movable:
            self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        for name, title in (("bottom", bottom), ("left", left)):
            item.getAxis(name).enableAutoSIPrefix(False)
            if title:
                item.setLabel(name, title)

    def add_legend(self, columns: int) -> None:
        """Add a legend above the axes, where it covers no point; curves with a name enter it."""
        item = self.getPlotItem()
        item.layout.setContentsMargins(0, 24, 0, 0)
        item.legend = pg.LegendItem(offset=(48, 1), colCount=columns)
        item.legend.setParentItem(item)

    def follow_theme(self, recolor: Callable[[ThemeColors], object] | None = None) -> None:
        """Colour the plot now and when the theme changes; then ``recolor`` colours its curves."""
        self._recolor: Callable[[ThemeColors], object] = recolor or (lambda _colors: None)
        THEME.changed.connect(self._apply_theme)
        self._apply_theme()

    def _apply_theme(self) -> None:
        colors, item = theme_colors(), self.getPlotItem()
        self.setBackground(colors.base)
        for name in ("bottom", "left"):
            axis: Any = item.getAxis(name)
            axis.setPen(colors.border)
            axis.setTextPen(colors.text)
        self._recolor(colors)
        if item.legend is not None:
            item.legend.setLabelTextColor(colors.text)
            for sample, label in item.legend.items:
                label.setText(label.text)
                sample.update()
