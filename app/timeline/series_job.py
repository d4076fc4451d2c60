"""Computes the series of a recording in a process of low priority; see `series`."""

from __future__ import annotations

import multiprocessing
import signal
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

from PyQt6.QtCore import QObject, QTimer, pyqtSignal

from ...core.preset import Preset
from .series import Answer, Order, serve_series

#: Interval at which answers are looked for, in ms; longest wait for the process to end, in s.
_LOOK_MS, _ENDING_S = 100, 2.0


class SeriesJob(QObject):
    """At most one series at a time; the process stays for the next preset until `stop`, with its source open."""

    found = pyqtSignal(object)  # list of FrameValues
    ended = pyqtSignal(str)  # empty where the series is complete, else the problem

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        #: The process; None before the first series.
        self.process: BaseProcess | None = None
        self._orders: Connection | None = None
        self._number = 0
        self._timer = QTimer(self)
        self._timer.setInterval(_LOOK_MS)
        self._timer.timeout.connect(self._look)

    def start(self, source: str, length: int, preset: Preset, home: Path | None = None) -> None:
        """Compute the series of ``length`` frames, with the untouched frame beside ``home``; ends the one before."""
        self._number += 1
        if self._orders is None:
            self._start_process()
        assert self._orders is not None
        with suppress(OSError):  # the process has died: `_look` says so
            self._orders.send(Order(self._number, source, length, preset, home))
        self._timer.start()

    def rest(self) -> None:
        """Stop computing; the process stays."""
        if self._timer.isActive() and self._orders is not None:
            self._timer.stop()
            with suppress(OSError):
                self._orders.send(None)

    def stop(self) -> None:
        self._timer.stop()
        if self._orders is not None and self.process is not None:
            self._orders.close()
            self.process.kill()
            self.process.join(_ENDING_S)
        self._orders = self.process = None

    def _start_process(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._orders, other = context.Pipe()
        self.process = context.Process(target=serve_series, args=(other,), name="time strip", daemon=True)
        # A Ctrl+C while it still imports would end it with a traceback; it inherits that they are held back.
        usual = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, usual)
        other.close()

    def _look(self) -> None:
        try:
            while self._timer.isActive() and self._orders is not None and self._orders.poll():
                answer: Answer = self._orders.recv()
                if answer.number != self._number:
                    continue
                if answer.values:
                    self.found.emit(answer.values)
                if answer.problem is not None:
                    self._timer.stop()
                    self.ended.emit(answer.problem)
        except (EOFError, OSError):
            self.stop()
            self.ended.emit("The process that computes the time strip has ended; change the preset to start it again.")
