"""The views above the strip; the strip gets as much height as its images can use, until somebody decides."""

from __future__ import annotations

from PyQt6.QtCore import QByteArray, Qt
from PyQt6.QtGui import QResizeEvent
from PyQt6.QtWidgets import QSplitter, QWidget

_PANES = 4
#: Height of the strip beyond its images: titles, legends and the readout.
_AROUND = 64
_LARGEST_SHARE = 0.42


class StripSplitter(QSplitter):
    """Splits height between the views and the strip."""

    def __init__(self, views: QWidget, strip: QWidget, parent: QWidget | None = None) -> None:
        super().__init__(Qt.Orientation.Vertical, parent)
        self._decided = False
        self._aspect = 3 / 4
        self.addWidget(views)
        self.addWidget(strip)
        self.setStretchFactor(0, 1)
        self.setStretchFactor(1, 0)
        self.setChildrenCollapsible(False)
        self.splitterMoved.connect(self._moved)

    def restoreState(self, state: QByteArray | bytes | bytearray | memoryview) -> bool:
        """Take up a division that somebody once chose."""
        self._decided = super().restoreState(state)
        return self._decided

    def saved_state(self) -> QByteArray:
        """Return the division if somebody chose it, else nothing."""
        return self.saveState() if self._decided else QByteArray()

    def resizeEvent(self, event: QResizeEvent | None) -> None:
        """Give the strip what its images need at this width."""
        super().resizeEvent(event)
        self._divide()

    def set_aspect(self, height_per_width: float) -> None:
        """Say what shape the images have."""
        self._aspect = height_per_width
        self._divide()

    def _divide(self) -> None:
        if not self._decided:
            wanted = round(self.width() / _PANES * self._aspect) + _AROUND
            strip = min(wanted, round(self.height() * _LARGEST_SHARE))
            self.setSizes([self.height() - strip, strip])

    def _moved(self, _position: int, _index: int) -> None:
        self._decided = True
