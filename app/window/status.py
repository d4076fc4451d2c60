"""The status bar: source, rates, stage times and patch area; and the progress of opening a source."""

from __future__ import annotations

import time
from collections.abc import Mapping

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QFrame, QHBoxLayout, QLabel, QProgressBar, QPushButton, QStatusBar, QVBoxLayout, QWidget

from ...widgets.basics.controls import ElidedLabel
from ..worker.results import RateMeter, Result, SourceInfo, SourceState

#: Interval between updates while frames play, in seconds.
INTERVAL_S = 0.2
_MIN_SHOWN_MS = 0.05
#: If the times of all stages need a larger share of the bar's width, only their sum is shown.
_MAX_SHARE = 0.45


class FrameStatus(QStatusBar):
    """Shows the numbers of the newest result, a few times a second."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setSizeGripEnabled(False)
        self.setContentsMargins(0, 0, 8, 0)
        self._shown_rate = RateMeter()
        self._last_s = 0.0
        self._source = ElidedLabel()
        self.addWidget(self._source, 1)
        self.findings = QPushButton()
        self.findings.setFlat(True)
        self.findings.setToolTip("What is wrong with this frame or preset, and what mends it (Ctrl+F)")
        self.findings.hide()
        self.addPermanentWidget(self.findings)
        self._rates = self._number("00 shown / 00 processed fps", "Frames per second drawn, and processed")
        self._dropped = self._number(
            "0000 dropped",
            "Dropped: frames not drawn because a newer one was ready, or lost in transfer\n"
            "Unmatched: images without a partner from the other camera in time",
        )
        self._stages = self._number(
            "fusion 00.0  equilibrium 0.0  edge 0.0  clusters 0.0 ms",
            "Milliseconds per stage; 0 is cached or skipped",
        )
        self._skew = self._number("skew 00.0 ms", "Skew: tactile minus proximity time stamp, in milliseconds")
        self._points = self._number("000,000 points", "Points of the patch")
        self._area = self._number("patch 0000.0 cm²", "Area of the patch, projected along the optical axis")

    @property
    def shown_fps(self) -> float:
        """Frames drawn per second, over the last two seconds."""
        return self._shown_rate.rate()

    def show_source(self, info: SourceInfo) -> None:
        """Show length, name and cameras of the source."""
        rig = info.rig
        cameras = " + ".join(f"{camera.model} {camera.serial}".strip() for camera in (rig.proximity, rig.tactile))
        length = "live" if info.length is None else f"{info.length} frame{'' if info.length == 1 else 's'}"
        self._source.setText(f"{length}, {info.name}, {cameras}")

    def show_findings(self, count: int) -> None:
        """Show the number of findings; the button is hidden while there is none."""
        self.findings.setText(f"⚠ {count} finding{'s' if count > 1 else ''}")
        self.findings.setVisible(count > 0)

    def show_state(self, state: SourceState) -> None:
        """Show that no frame comes."""
        if state.stale:
            self._rates.setText("no frames")

    def _show_losses(self, dropped: int, unmatched: int) -> None:
        self._dropped.setText(f"{dropped} dropped" + (f", {unmatched} unmatched" if unmatched else ""))

    def show_result(self, result: Result) -> None:
        """Count a frame as shown. Points and area are those of the views; the other numbers wait for `INTERVAL_S`."""
        self._shown_rate.tick()
        patch = result.patch
        self._points.setText("" if patch is None else f"{len(patch.points):,} points")
        self._area.setText("" if patch is None else f"patch {result.area_mm2 / 100:.1f} cm²")
        now = time.perf_counter()
        running = result.playback.running
        if running and now - self._last_s < INTERVAL_S:
            return
        self._last_s = now
        rates = f"{self.shown_fps:.0f} shown / {result.processed_fps:.0f} processed fps" if running else "paused"
        self._rates.setText(rates)
        self._show_losses(result.dropped, result.unmatched)
        self._skew.setText(f"skew {1e3 * result.frame.skew_s:.1f} ms")
        if patch is None:
            self._stages.setText("")
            return
        times, averaged = patch.stage_ms, patch.averaged_frames
        mean = f"mean of {averaged} frames  " if averaged > 1 else ""
        self._stages.setText(mean + self._in_words(times))
        self._stages.setToolTip(
            "Milliseconds per stage (0: cached or skipped)\n"
            + "\n".join(f"{stage}: {ms:.2f}" for stage, ms in times.items())
            + f"\nreading: {result.read_ms:.2f}\ndrawing for the window: {result.render_ms:.2f}"
        )

    def _in_words(self, times: Mapping[str, float]) -> str:
        """Return the time of each stage; if that is too long for the bar, the sum and the slowest stage."""
        computed = [f"{stage} {ms:.1f}" for stage, ms in times.items() if ms >= _MIN_SHOWN_MS]
        if not computed:
            return "unchanged"
        each = "  ".join(computed) + " ms"
        if self.fontMetrics().horizontalAdvance(each) <= _MAX_SHARE * self.width():
            return each
        longest = max(times, key=lambda stage: times[stage])
        return f"{sum(times.values()):.1f} ms ({longest} {times[longest]:.1f})"

    def _number(self, widest: str, tip: str) -> QLabel:
        """Make a label wide enough for its widest text, so that nothing moves as numbers change."""
        label = self._label("", tip)
        label.setMinimumWidth(label.fontMetrics().horizontalAdvance(widest))
        self.addPermanentWidget(label)
        return label

    def _label(self, text: str, tip: str) -> QLabel:
        label = QLabel(text)
        label.setToolTip(tip)
        return label


class OpeningBar(QFrame):
    """What is being opened, a progress bar and a Cancel button; hidden while nothing is being opened.

    Signals
    -------
    cancelled()
    """

    cancelled = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._label = QLabel()
        self._label.setWordWrap(True)
        self._bar = QProgressBar()
        self._bar.setRange(0, 1000)
        self._bar.setTextVisible(False)
        self._bar.setFixedHeight(12)
        self._bar.setAccessibleName("Progress of opening")
        self.cancel = QPushButton("Cancel")
        self.cancel.clicked.connect(self.cancelled)
        row = QHBoxLayout()
        row.addWidget(self._bar, 1)
        row.addWidget(self.cancel)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(8, 4, 4, 4)
        layout.setSpacing(4)
        layout.addWidget(self._label)
        layout.addLayout(row)
        self.hide()

    def show_progress(self, name: str, fraction: float, text: str) -> None:
        """Show the progress of opening; a fraction of 0 means unknown."""
        self._label.setText(f"Opening {name}{': ' + text if text else '…'}")
        self._bar.setRange(0, 1000 if fraction > 0 else 0)
        self._bar.setValue(round(1000 * fraction))
        self.show()
