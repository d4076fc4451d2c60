"""The position in a recording as an entry: ``12.4 s, frame 373 of 900``."""

from __future__ import annotations

import re

import numpy as np
from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QFocusEvent, QKeyEvent
from PyQt6.QtWidgets import QLineEdit, QToolTip

from ...core.model.arrays import Float64Array

_TIME = re.compile(r"(?:([0-9]+):)?([0-9]*[.,]?[0-9]+)\s*s?")
_FRAME = re.compile(r"(?:frame\s*)?([0-9]{1,9})(?:\s*(?:of|/).*)?")
_HELP = "Type a frame number such as 373, or a time in seconds such as 12.4 s or 1:05.2"


class PositionEntry(QLineEdit):
    """Shows time and frame; a person may type either.

    Signals
    -------
    sought(index: int)
    """

    sought = pyqtSignal(int)

    def __init__(self) -> None:
        super().__init__()
        self.setAccessibleName("Time and frame")
        self.setToolTip(f"Seconds since the first frame, and the frame, from 1 (files and commands from 0).\n{_HELP}.")
        self.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._shown = ""
        self._index, self._length = -1, 1
        self._seconds: Float64Array = np.zeros(1)
        self._fit()

    def set_times(self, seconds: Float64Array) -> None:
        """Set the time of each frame since the first one, seconds, increasing."""
        self._seconds = seconds
        if not self.isReadOnly():
            self.show_position(self._index, self._length)

    def show_position(self, index: int, length: int | None) -> None:
        """Show a frame; a length of None is a live source, whose frames cannot be chosen."""
        self.setReadOnly(length is None)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus if length is None else Qt.FocusPolicy.StrongFocus)
        if length is None:
            self._show(f"frame {index + 1}" if index >= 0 else "")
            return
        changed = length != self._length
        self._index, self._length = max(0, index), length
        if changed:
            self._fit()
        self._show(self._position())

    def _position(self) -> str:
        time_s = self._seconds[self._index] if self._index < len(self._seconds) else 0.0
        return f"{time_s:.1f} s, frame {self._index + 1} of {self._length}"

    def _show(self, text: str) -> None:
        if text != self._shown:
            self._shown = text
            if not self.isModified():
                self.setText(text)

    def _fit(self) -> None:
        digits = "0" * len(str(self._length))
        widest = f"{digits}.0 s, frame {digits} of {digits}"
        self.setFixedWidth(self.fontMetrics().horizontalAdvance(widest) + 16)

    def _chosen(self) -> int | None:
        """Return the frame that the text means; None if it means none."""
        text = self.text().strip().lower()
        time_text, _, frame_text = text.rpartition(", ")
        if frame_text.startswith("frame") and time_text:  # the whole text with one of both changed
            old_time = self._shown.split(", ")[0]
            text = frame_text if time_text == old_time else time_text
        if found := _FRAME.fullmatch(text):
            return min(max(int(found[1]), 1), self._length) - 1
        if found := _TIME.fullmatch(text):
            time_s = 60 * int(found[1] or 0) + float(found[2].replace(",", "."))
            return int(np.abs(self._seconds[: self._length] - time_s).argmin())
        return None

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Enter goes there, Esc brings the position back."""
        key = event.key() if event is not None else 0
        if key in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            index = self._chosen()
            if index is None:
                self.selectAll()
                QToolTip.showText(self.mapToGlobal(self.rect().bottomLeft()), _HELP, self)
                return
            self._leave()
            self.sought.emit(index)
        elif key == Qt.Key.Key_Escape:
            self._leave()
        else:
            super().keyPressEvent(event)

    def focusInEvent(self, event: QFocusEvent | None) -> None:
        """Select all, ready to type."""
        super().focusInEvent(event)
        self.selectAll()

    def focusOutEvent(self, event: QFocusEvent | None) -> None:
        """Discard what was not confirmed."""
        super().focusOutEvent(event)
        self.setText(self._shown)

    def _leave(self) -> None:
        self.setText(self._shown)
        self.clearFocus()
