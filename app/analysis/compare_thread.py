"""Compares methods beside the window and its worker: always the newest frame, never in their way."""

from __future__ import annotations

import time
from threading import Event

from PyQt6.QtCore import QObject, QThread, pyqtSignal

from ..worker.abandoned_threads import leave_behind
from ..worker.cores import leave_room_for_the_window
from ..worker.explain import explain
from ..worker.mailbox import Mailbox
from .comparer import Comparer, Comparison, Task

_LONGEST_REST_S = 0.5


class CompareThread(QThread):
    """Takes tasks through a one-slot mailbox and gives comparisons back through another.

    While frames run it rests after each comparison for as long as that took, since window and worker
    share the processor with it.

    Signals
    -------
    compared()
        `take` has something new.
    settingUp(name: str)
        A method is made ready, which may take a while.
    failed(sentence: str)
        A frame could not be compared.
    """

    compared = pyqtSignal()
    settingUp = pyqtSignal(str)
    failed = pyqtSignal(str)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._tasks: Mailbox[Task] = Mailbox(lambda old, new: old.result.frame is new.result.frame)
        self._comparisons: Mailbox[Comparison] = Mailbox()
        self._wake = Event()
        self._stopping = Event()

    @property
    def skipped(self) -> int:
        """Frames that were not compared because a newer one came first."""
        return self._tasks.dropped

    def compare(self, task: Task) -> None:
        """Compare this frame next; one that still waits is skipped."""
        self._tasks.put(task)
        self._wake.set()

    def take(self) -> Comparison | None:
        """Take the newest comparison, or None."""
        return self._comparisons.take()

    def shut_down(self) -> None:
        """Stop after the present frame, for good; nobody waits for that, and nothing is emitted any more."""
        self._stopping.set()
        self._wake.set()
        leave_behind(self)

    def run(self) -> None:
        """Compare frame after frame until told to stop."""
        leave_room_for_the_window()
        comparer = Comparer(self.settingUp.emit)
        while not self._stopping.is_set():
            self._wake.wait()
            self._wake.clear()
            task = self._tasks.take()
            if task is None or self._stopping.is_set():
                continue
            started = time.perf_counter()
            self._compare(comparer, task)
            if task.result.playback.running:
                self._stopping.wait(min(time.perf_counter() - started, _LONGEST_REST_S))

    def _compare(self, comparer: Comparer, task: Task) -> None:
        try:
            comparison = comparer.compare(task)
        except Exception as error:
            self.failed.emit(explain(error, f"frame {task.result.frame_number} could not be compared"))
            return
        if self._comparisons.put(comparison):
            self.compared.emit()
