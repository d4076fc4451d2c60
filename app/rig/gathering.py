"""A measurement on frames of the main window: they are gathered, measured on another thread, and told in a sentence."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

from PyQt6.QtCore import QTimer, pyqtSignal
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QWidget

from ...core.errors import as_sentence
from ...core.model.frames import SensorFrame
from ...widgets.basics.controls import ProgressBar
from ...widgets.basics.layouts import hbox
from ..document.document import Document
from ..worker.jobs import Job
from ..worker.results import Result, SourceInfo
from ..worker.worker import Worker

#: Seconds without a frame after which a source counts as stopped.
PATIENCE_S: Final = 5.0
_TICK_MS: Final = 100
NO_FRAME: Final = "There is no frame yet: open a source in the main window first."
NO_MORE_FRAMES: Final = "No more frames arrive: play the source, in a loop if it is a recording, and measure again."
OTHER_SOURCE: Final = "Another source was opened meanwhile: measure again."


class GatheringTab(QWidget):
    """Base of tabs that measure on frames. A paused recording plays meanwhile and is paused again.

    Parameters
    ----------
    worker : Worker
    document : Document
    start, cancel : QPushButton
    entry : QWidget
        How much is gathered.
    gathered_share : float
        Share of the progress at which all frames have arrived.
    """

    _watchingFailed = pyqtSignal(str)

    def __init__(
        self,
        worker: Worker,
        document: Document,
        start: QPushButton,
        cancel: QPushButton,
        entry: QWidget,
        gathered_share: float,
    ) -> None:
        super().__init__()
        self._worker, self._document = worker, document
        self.start, self.cancel, self._entry, self._gathered_share = start, cancel, entry, gathered_share
        self._result: Result | None = None
        self._info: SourceInfo | None = None
        self._gathering = self._pause_after = False
        self._counted, self._last_frame_s = 0, 0.0
        self.sentence = QLabel()
        self.progress = ProgressBar()
        policy = self.progress.sizePolicy()
        policy.setRetainSizeWhenHidden(True)  # so that the layout does not jump
        self.progress.setSizePolicy(policy)
        self._timer = QTimer(self)
        self._timer.setInterval(_TICK_MS)
        self._timer.timeout.connect(self._look)
        self._job = Job(self)
        self._job.progress.connect(
            lambda share, words: self.progress.show_share(gathered_share + (1 - gathered_share) * share, words)
        )
        self._job.done.connect(self._done)
        self._job.failed.connect(self._fail)
        self._watchingFailed.connect(self._give_up)
        start.clicked.connect(self.begin)
        cancel.clicked.connect(self.stop)

    @property
    def busy(self) -> bool:
        """Whether a measurement is running."""
        return self._gathering or self._job.busy

    def begin(self) -> None:
        """Start gathering frames."""
        raise NotImplementedError

    def stop(self) -> None:
        """Cancel the measurement."""
        self._stop_gathering()
        self._job.cancel()
        if not self._job.busy:
            self._show_busy(False)

    def give_way(self) -> None:
        """Cancel for the measurement of the other tab, and say so."""
        if self.busy:
            self.stop()
            self.sentence.setText("Cancelled by the measurement in the other tab: measure again when that has ended.")

    def close_down(self) -> None:
        """Cancel permanently and wait for the thread."""
        self._stop_gathering()
        self._job.stop()
        self._show_busy(False)

    def _done(self, found: Any) -> None:
        """Show what the job has found."""
        raise NotImplementedError

    def _gathered(self) -> tuple[int, float, str]:
        """Return how many frames have arrived, which share of those that are needed, 0 to 1, and what to do now."""
        raise NotImplementedError

    def _measure(self) -> None:
        """Measure the gathered frames."""
        raise NotImplementedError

    def _are_enough(self) -> bool:
        """Return whether the gathered frames can be measured although no more arrive."""
        return False

    def _gather(self, take: Callable[[SensorFrame], object]) -> None:
        """Pass each frame to ``take``, on the worker's thread, also those that the window drops."""
        assert self._result is not None
        self._counted, self._last_frame_s = 0, time.monotonic()
        self._show_busy(True)
        self._worker.recorder.watch(take, self._watchingFailed.emit)
        self._gathering = True
        self._timer.start()
        self._pause_after = not self._result.playback.running
        if self._pause_after:
            self._worker.play()

    def _stop_gathering(self) -> None:
        if self._gathering:
            self._gathering = False
            self._timer.stop()
            self._worker.recorder.unwatch()
            if self._pause_after:
                self._worker.pause()

    def _give_up(self, sentence: str) -> None:
        if self._gathering:
            self.stop()
            self._fail(sentence)

    def _look(self) -> None:
        """Check whether enough frames have arrived."""
        now = time.monotonic()
        count, share, words = self._gathered()
        if count > self._counted:
            self._counted, self._last_frame_s = count, now
        self.progress.show_share(self._gathered_share * min(share, 1.0), words)
        stopped = now - self._last_frame_s > PATIENCE_S
        if share >= 1.0 or (stopped and self._are_enough()):
            self._stop_gathering()
            self._measure()
        elif stopped:
            self._give_up(NO_MORE_FRAMES)

    def _fail(self, sentence: str) -> None:
        self._show_busy(False)
        if sentence:
            self.sentence.setText(as_sentence(sentence))

    def _row(self, *before: QWidget) -> QHBoxLayout:
        """Return the row of the entry, the buttons and the progress."""
        return hbox(*before, self._entry, self.start, self.cancel, (self.progress, 1))

    def _show_busy(self, busy: bool) -> None:
        self.start.setEnabled(not busy)
        self._entry.setEnabled(not busy)
        self.cancel.setEnabled(busy)
        self.progress.setVisible(busy)
