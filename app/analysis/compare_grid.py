"""The grid of linked 3D views, one for each method, with its numbers below."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QResizeEvent
from PyQt6.QtWidgets import QGridLayout, QLabel, QWidget

from ...widgets.basics.colormaps import Theme
from ...widgets.basics.layouts import vbox
from ...widgets.clouds.cloud_view import CloudView, link_cameras
from .compare_table import caption
from .comparer import Outcome
from .method_looks import agreement_legend, method_color, method_tip

#: Preferred width over height of a view.
_ASPECT = 1.25
#: Views narrower than this show every other row and column.
_FINE_WIDTH = 480
#: Points grow by `step` pixels for each of these pixels of a view's width, so that surfaces have no gaps.
_POINT_EVERY = 320
_CHOOSE = "Tick a method in the table to see its patch here."


class Tile(QWidget):
    """One method's patch."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self.view = CloudView(name)
        self.caption = QLabel("\n")
        self.caption.setTextFormat(Qt.TextFormat.PlainText)
        self.caption.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.caption.setToolTip(method_tip(name))
        self.caption.setAccessibleName(f"Numbers of {name}")
        vbox((self.view, 1), self.caption, within=self, margins=0, spacing=0)

    def show_outcome(self, outcome: Outcome, truth: bool, by_truth: bool, theme: Theme) -> None:
        """Show patch and numbers; with truth, also the agreement with it."""
        self.view.set_cloud(outcome.cloud)
        legend = agreement_legend() if by_truth else [("contact", method_color(self.name, theme))]
        if legend != self.view.legend():
            self.view.set_legend(legend)
        self.view.set_message(outcome.note)
        self.caption.setText(caption(outcome, truth))

    def show_setting_up(self) -> None:
        """Show that the method is being set up."""
        self.caption.setText(f"Setting up {self.name}…")


class TileGrid(QWidget):
    """One tile for each chosen method, as large as possible, with linked cameras.

    Signals
    -------
    stepChanged()
        `step` changed with the size of the views.
    """

    stepChanged = pyqtSignal()

    def __init__(self) -> None:
        super().__init__()
        self._columns = 0
        #: Every ``step``-th row and column is drawn.
        self.step = 1
        self.tiles: dict[str, Tile] = {}
        self._shown: list[Tile] = []
        self._layout = QGridLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self._layout.setSpacing(4)
        self._empty = QLabel(_CHOOSE)
        self._empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._layout.addWidget(self._empty, 0, 0)

    def shown(self) -> list[str]:
        """Return the names of the visible tiles in order."""
        return [tile.name for tile in self._shown]

    def show_tiles(self, names: Sequence[str]) -> None:
        """Show only these tiles; new ones take the camera of those that stay."""
        if list(names) == self.shown():
            return
        stay = [tile for tile in self._shown if tile.name in names]
        for name in names:
            if name not in self.tiles:
                self.tiles[name] = Tile(name)
        for tile in self._shown:
            tile.hide()
            link_cameras([tile.view])
        self._shown = [self.tiles[name] for name in names]
        link_cameras([tile.view for tile in (*stay, *(tile for tile in self._shown if tile not in stay))])
        self._place()

    def clear(self) -> None:
        """Empty all views; they frame the next cloud."""
        for tile in self.tiles.values():
            tile.view.set_cloud(None)
            tile.view.set_message("")
            tile.caption.setText("")

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        """Choose the number of columns that makes the views largest."""
        super().resizeEvent(event)
        if best_columns(len(self._shown), self.width(), self.height()) != self._columns:
            self._place()
        self._choose_step()

    def _place(self) -> None:
        columns = self._columns = best_columns(len(self._shown), self.width(), self.height())
        while self._layout.count():
            self._layout.takeAt(0)
        for line in range(max(self._layout.rowCount(), self._layout.columnCount())):
            self._layout.setRowStretch(line, 0)
            self._layout.setColumnStretch(line, 0)
        self._empty.setVisible(not self._shown)
        if not self._shown:
            self._layout.addWidget(self._empty, 0, 0)
        for place, tile in enumerate(self._shown):
            row, column = divmod(place, columns)
            self._layout.addWidget(tile, row, column)
            self._layout.setRowStretch(row, 1)
            self._layout.setColumnStretch(column, 1)
            tile.show()
        self._choose_step()

    def _choose_step(self) -> None:
        """Draw every other row and column in small views: it looks the same and is much faster."""
        wide = self.width() / max(1, self._columns)
        step = 1 if wide >= _FINE_WIDTH else 2
        for tile in self._shown:
            tile.view.set_point_size(max(2, round(step * wide / _POINT_EVERY)))
        if step != self.step:
            self.step = step
            self.stepChanged.emit()


def best_columns(count: int, width: int, height: int) -> int:
    """Return the number of columns with which ``count`` views are the largest in a room of this size."""

    def size(columns: int) -> float:
        rows = -(-count // columns)
        return min(width / columns, _ASPECT * height / rows)

    return max(range(1, count + 1), key=size, default=1)
