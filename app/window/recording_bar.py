"""What is being recorded: how long, how much, what was lost, and how much room is left."""

from __future__ import annotations

from PyQt6.QtCore import QEvent, pyqtSignal
from PyQt6.QtGui import QColor, QPalette
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QWidget

from ...core.recording.writer import RecordingStatus
from ...widgets.basics.elided_label import ElidedLabel
from ...widgets.basics.theme import theme_colors

#: Bytes per second; below that the head of the file is most of it.
_WORTH_RATING = 1e5


class RecordingBar(QWidget):
    """A line above the views; hidden while nothing is being recorded.

    Signals
    -------
    stopRequested()
    """

    stopRequested = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._dot = QLabel("●")
        self._dot.setAccessibleName("Recording")
        self._name = ElidedLabel()
        self._time = self._number("0:00:00", "Time since the recording began")
        self._frames = self._number("000000 frames", "Frames in the file")
        self._size = self._number("000.0 GB", "Size of the file")
        self._dropped = self._number(
            "0000 dropped",
            "Frames that are missing in the file: lost by the cameras or this computer, because the disk was too slow, "
            "or because of an error",
        )
        self._room = self._number("000 GB free, 00 h 00 min", "Room on the disk, and how long that lasts")
        self.stop = QPushButton("Stop")
        self.stop.setToolTip("Finish the recording (F9)")
        self.stop.clicked.connect(self.stopRequested)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(8, 2, 4, 2)
        layout.setSpacing(14)
        layout.addWidget(self._dot)
        layout.addWidget(self._name, 1)
        for label in (self._time, self._frames, self._size, self._dropped, self._room):
            layout.addWidget(label)
        layout.addWidget(self.stop)
        self._losses = False
        self._recolor()
        self.hide()

    def show_start(self, name: str) -> None:
        """Show that a recording has begun."""
        self._name.setText(f"Recording {name}")
        self.stop.setEnabled(True)
        for label in (self._time, self._frames, self._size, self._dropped, self._room):
            label.setText("")
        self.show()

    def show_hint(self, name: str, hint: str) -> None:
        """Say beside the name what the recording waits for."""
        self._name.setText(f"Recording {name}{f': {hint}' if hint else ''}")

    def show_progress(self, status: RecordingStatus, elapsed_s: float, free_bytes: int) -> None:
        """Show the numbers of a recording."""
        self._time.setText(clock(elapsed_s))
        self._frames.setText(f"{status.frames} frames")
        self._size.setText(size(status.bytes))
        self._dropped.setText(f"{status.dropped} dropped")
        if self._losses != (status.dropped > 0):
            self._losses = status.dropped > 0
            self._recolor()
        rate = status.bytes / elapsed_s if elapsed_s > 1.0 else 0.0
        lasts = f", {duration(free_bytes / rate)}" if rate > _WORTH_RATING else ""
        self._room.setText(f"{size(free_bytes)} free{lasts}")

    def show_finishing(self, name: str) -> None:
        """Say that what still waits is being written."""
        self._name.setText(f"Finishing {name}…")
        self.stop.setEnabled(False)

    def changeEvent(self, event: QEvent | None) -> None:
        """Follow the theme."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.PaletteChange:
            self._recolor()

    def _recolor(self) -> None:
        red = QPalette()
        red.setColor(QPalette.ColorRole.WindowText, QColor(theme_colors().error))
        self._dot.setPalette(red)
        self._dropped.setPalette(red if self._losses else QPalette())

    def _number(self, widest: str, tip: str) -> QLabel:
        """Make a label wide enough for its widest text, so that nothing moves as numbers change."""
        label = QLabel()
        label.setToolTip(tip)
        label.setMinimumWidth(label.fontMetrics().horizontalAdvance(widest))
        return label


def clock(seconds: float) -> str:
    """Return a time as 0:07, 12:30 or 1:02:03."""
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def duration(seconds: float) -> str:
    """Return roughly how long something lasts, such as 45 s, 12 min or 3 h 20 min."""
    if seconds < 120:
        return f"{int(seconds)} s"
    minutes = int(seconds // 60)
    if minutes < 120:
        return f"{minutes} min"
    hours = minutes // 60
    return f"{hours} h {minutes % 60} min" if hours < 100 else f"{hours} h"


def size(count: float) -> str:
    """Return a number of bytes as people read it, such as 850 kB, 12.3 MB or 54 GB."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6)):
        if count >= factor:
            value = count / factor
            return f"{value:.1f} {unit}" if value < 100 else f"{value:.0f} {unit}"
    return f"{count / 1e3:.0f} kB"
