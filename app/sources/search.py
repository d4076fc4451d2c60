"""The search for connected cameras, in a process of its own because a driver may hang or crash."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from PyQt6.QtCore import QObject, QProcess, QTimer, pyqtSignal

from ...core.errors import as_sentence
from .list_devices import PROGRAM

#: Time limit of the search, ms. Loading the driver takes a second or two; it may hang.
PATIENCE_MS = 15_000
#: Wait for a killed process, ms.
_KILL_MS = 200
_hanging: list[QProcess] = []
_DOCTOR = "see Help > Check this computer for the cause and its remedy"


@dataclass(frozen=True)
class FoundCamera:
    """A connected camera; fields that it does not report are empty."""

    model: str
    serial: str
    firmware: str = ""
    usb: str = ""
    problem: str = ""
    role: str = ""


class CameraSearch(QObject):
    """Searches for cameras, one search at a time.

    Signals
    -------
    found(cameras: list[FoundCamera], hint: str)
        The hint says why a camera may be missing.
    failed(sentence: str)
    """

    found = pyqtSignal(object, str)
    failed = pyqtSignal(str)

    def __init__(self, parent: QObject | None = None, arguments: Sequence[str] = PROGRAM) -> None:
        super().__init__(parent)
        self._arguments = list(arguments)
        self._process = self._new_process()
        self._patience = QTimer(self)
        self._patience.setSingleShot(True)
        self._patience.setInterval(PATIENCE_MS)
        self._patience.timeout.connect(self._give_up)
        self._answered = False

    @property
    def running(self) -> bool:
        """Whether a search is running."""
        return self._process.state() != QProcess.ProcessState.NotRunning

    def start(self) -> None:
        """Search for cameras, unless a search is running."""
        if not self.running:
            self._answered = False
            self._process.start(sys.executable, self._arguments)
            self._patience.start()

    def stop(self) -> None:
        """Cancel the search."""
        self._answered = True
        self._patience.stop()
        self._abandon()

    def _new_process(self) -> QProcess:
        process = QProcess(self)
        process.finished.connect(self._finished)
        process.errorOccurred.connect(self._error_occurred)
        return process

    def _give_up(self) -> None:
        self._fail(f"The camera driver does not answer: unplug the cameras and plug them in again, or {_DOCTOR}.")
        self._abandon()

    def _abandon(self) -> None:
        """Kill the process. One that hangs in the kernel ends later; its object stays, as deleting it would wait."""
        if self.running:
            self._process.blockSignals(True)
            self._process.kill()
            if not self._process.waitForFinished(_KILL_MS):
                self._process.setParent(None)
                _hanging.append(self._process)
            self._process = self._new_process()

    def _error_occurred(self, error: QProcess.ProcessError) -> None:
        if error == QProcess.ProcessError.FailedToStart:
            self._fail(f"The search for cameras cannot be started: {self._process.errorString()}.")

    def _finished(self, status: int, how: QProcess.ExitStatus) -> None:
        self._patience.stop()
        output = bytes(self._process.readAllStandardOutput().data()).decode(errors="replace")
        complaint = bytes(self._process.readAllStandardError().data()).decode(errors="replace").strip()
        if how == QProcess.ExitStatus.CrashExit or status != 0:
            last = complaint.splitlines()[-1] if complaint else f"status {status}"
            self._fail(f"The camera driver failed while searching for cameras ({last}): {_DOCTOR}.")
            return
        try:
            answer = json.loads(output.strip().splitlines()[-1])
            problem = answer.get("problem", "")
            hint = "; ".join(filter(None, [str(answer.get("hint", "")), *answer.get("problems", [])]))
            cameras = [_camera(device) for device in answer.get("devices", [])]
        except (ValueError, LookupError, AttributeError, TypeError):
            self._fail(f"The search for cameras gave no answer: {_DOCTOR}.")
            return
        if problem:
            self._fail(as_sentence(problem))
        elif not self._answered:
            self._answered = True
            self.found.emit(cameras, hint)

    def _fail(self, sentence: str) -> None:
        if not self._answered:
            self._answered = True
            self._patience.stop()
            self.failed.emit(sentence)


def _camera(device: dict[str, Any]) -> FoundCamera:
    return FoundCamera(**{field.name: str(device.get(field.name, "") or "") for field in fields(FoundCamera)})
