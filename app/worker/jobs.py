"""Jobs: work on another thread, one at a time, with progress and cancelling; and a row that shows them."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event
from typing import Any

from PyQt6.QtCore import QObject, QThread, pyqtSignal
from PyQt6.QtWidgets import QWidget

from ...core.errors import TactuneError
from ...widgets.basics.controls import ProgressBar, keep_place, push_button
from ...widgets.basics.layouts import hbox
from .threads import abandon

Progress = Callable[[float, str], None]
Work = Callable[[Progress], Any]
Slot = Callable[[Any], object]


class _CancelledError(TactuneError):
    """Raised by a job's progress call to end the job."""


class _Thread(QThread):
    """The thread of one job."""

    progress = pyqtSignal(float, str)

    def __init__(self, work: Work, parent: QObject) -> None:
        super().__init__(parent)
        self._work = work
        self.cancelled = Event()
        self.result: Any = None
        self.sentence = ""

    def run(self) -> None:
        try:
            self.result = self._work(self._report)
        except _CancelledError:
            self.sentence = ""
        except TactuneError as error:
            self.sentence = str(error)
        except Exception as error:
            self.sentence = f"Something went wrong ({type(error).__name__}: {error}); nothing was changed."

    def _report(self, share: float, words: str) -> None:
        if self.cancelled.is_set():
            raise _CancelledError("cancelled")
        self.progress.emit(share, words)


class Job(QObject):
    """Does work on its own thread. Work started meanwhile waits; only the newest is kept waiting.

    The slots ``done`` and ``failed`` are connected to the signals of that name.

    Signals
    -------
    progress(share: float, words: str)
    done(result: object)
    failed(sentence: str)
        The sentence is empty if the job was cancelled.
    busyChanged(busy: bool)
    """

    progress = pyqtSignal(float, str)
    done = pyqtSignal(object)
    failed = pyqtSignal(str)
    busyChanged = pyqtSignal(bool)

    def __init__(self, parent: QObject, done: Slot | None = None, failed: Slot | None = None) -> None:
        super().__init__(parent)
        self._thread: _Thread | None = None
        self._next: Work | None = None
        if done is not None:
            self.done.connect(done)
        if failed is not None:
            self.failed.connect(failed)

    @property
    def busy(self) -> bool:
        return self._thread is not None

    def start(self, work: Work) -> None:
        """Do this work now, or after the current work has ended.

        The work gets a function ``progress(share, words)``. It should call it often: that is where cancelling ends it.
        Its result comes with `done`, the message of its `TactuneError` with `failed`.
        """
        if self._thread is not None:
            self._next = work
            return
        self._thread = _Thread(work, self)
        self._thread.progress.connect(self.progress)
        self._thread.finished.connect(self._finished)
        self._thread.start()
        self.busyChanged.emit(True)

    def cancel(self) -> None:
        """Cancel the current work at its next report of progress, and drop the waiting work."""
        self._next = None
        if self._thread is not None:
            self._thread.cancelled.set()

    def stop(self) -> None:
        """Cancel, and emit nothing any more. Work that reports no progress is abandoned and ends by itself."""
        self.cancel()
        if self._thread is not None:
            abandon(self._thread)
            self._thread = None

    def _finished(self) -> None:
        thread = self._thread
        if thread is None or not thread.isFinished():
            return  # from a thread that was stopped
        self._thread = None
        newest, self._next = self._next, None
        if newest is None:
            self.busyChanged.emit(False)
        if thread.sentence or thread.cancelled.is_set():
            self.failed.emit(thread.sentence)
        else:
            self.done.emit(thread.result)
        if newest is not None and self._thread is None:
            self.start(newest)
        thread.deleteLater()


class JobRow(QWidget):
    """Visible while a job reports progress; work that reports none, as on each frame, shows nothing."""

    def __init__(self, job: Job) -> None:
        super().__init__()
        self.bar, self.cancel = ProgressBar(), push_button("Cance&l", "Cancel")
        self.bar.setAccessibleName("Progress")
        hbox((self.bar, 1), self.cancel, within=self, margins=0)
        keep_place(self)
        job.progress.connect(self._show)
        job.busyChanged.connect(self._end)
        self.cancel.clicked.connect(job.cancel)
        self.hide()

    def _show(self, share: float, words: str) -> None:
        self.bar.show_share(share, words)
        self.setVisible(share < 1)

    def _end(self, busy: bool) -> None:
        if not busy:
            self.hide()
