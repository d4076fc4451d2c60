"""Computes time series in a process of low priority, so that playback keeps its rate."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

from PyQt6.QtCore import QObject, QProcess, pyqtSignal

from ...core.evaluation.series_process import PROGRAM
from ...core.evaluation.time_series import FrameValues
from ...core.preset import Preset
from ...core.preset.file import preset_json

#: Longest wait for the process to end, in ms.
_ENDING_MS = 2000


class SeriesJob(QObject):
    """At most one series at a time; the process stays for the next preset, with its source open.

    Call `stop` before the series of another source.

    Signals
    -------
    found(list of FrameValues)
    ended(problem: str)
        The series is complete, or the problem as a sentence.
    """

    found = pyqtSignal(object)
    ended = pyqtSignal(str)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._process: QProcess | None = None
        self._id = 0
        self._running = False

    @property
    def running(self) -> bool:
        """Whether a series is being computed."""
        return self._running

    def start(self, source: str, length: int, preset: Preset, skip: list[int]) -> None:
        """Compute the series of a source's ``length`` frames except ``skip``; ends the one before."""
        self._running = True
        self._order(source=source, length=length, preset=preset_json(preset), skip=skip)

    def rest(self) -> None:
        """Stop computing; the process stays."""
        if self._running:
            self._running = False
            self._order(source=None)

    def stop(self) -> None:
        """End the process."""
        self._running = False
        process, self._process = self._process, None
        if process is not None:
            process.blockSignals(True)
            process.kill()
            process.waitForFinished(_ENDING_MS)
            process.deleteLater()

    def _order(self, **order: Any) -> None:
        self._id += 1
        if self._process is None:
            self._process = self._started()
        self._process.write((json.dumps({"id": self._id, **order}) + "\n").encode())

    def _started(self) -> QProcess:
        process = QProcess(self)
        process.setProcessChannelMode(QProcess.ProcessChannelMode.ForwardedErrorChannel)
        process.readyReadStandardOutput.connect(self._read)
        process.finished.connect(self._gone)
        process.errorOccurred.connect(lambda error: self._gone() if error == QProcess.ProcessError.FailedToStart else 0)
        path = json.dumps([str(entry) or str(Path.cwd()) for entry in sys.path])  # empty: the working folder
        process.start(sys.executable, ["-P", "-c", PROGRAM, path])
        return process

    def _read(self) -> None:
        while self._process is not None and self._process.canReadLine():
            try:
                answer = json.loads(self._process.readLine().data())
            except ValueError:
                continue  # printed by a library
            if not self._running or not isinstance(answer, dict) or answer.get("id") != self._id:
                continue
            if "rows" in answer:
                self.found.emit([_values(row) for row in answer["rows"]])
            else:
                self._running = False
                self.ended.emit(answer.get("problem", ""))

    def _gone(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.deleteLater()
        if self._running:
            self._running = False
            self.ended.emit("The process that computes the time strip has ended; change the preset to start it again.")


def _values(row: list[Any]) -> FrameValues:
    index, *values = row
    return FrameValues(index, *(math.nan if value is None else value for value in values))
