"""Asks for the connected cameras in a process of its own, so that the window never waits for a driver."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from PyQt6.QtCore import QObject, QProcess, QTimer, pyqtSignal

#: Loading the driver takes a second or two; a hanging one is given up after this time.
PATIENCE_MS = 15_000
_PROGRAM = ("-P", "-m", "tactune.app.cameras.list_devices")
_DOCTOR = "run “tactune doctor” in a terminal, which says what is wrong and how to mend it"


@dataclass(frozen=True)
class FoundCamera:
    """A connected camera, as far as it says what it is."""

    model: str
    serial: str
    firmware: str = ""
    usb: str = ""
    problem: str = ""
    role: str = ""

    @property
    def sees_proximity(self) -> bool:
        """Whether it is a camera of the kind that looks through the membrane (time of flight)."""
        return self.role == "proximity"


class CameraSearch(QObject):
    """Looks for cameras, one search at a time.

    Parameters
    ----------
    arguments : sequence of str
        What the Python interpreter is called with; it writes what `list_devices` writes.

    Signals
    -------
    found(cameras: list[FoundCamera], hint: str)
        The hint says why some cameras cannot be found.
    failed(sentence: str)
    """

    found = pyqtSignal(object, str)
    failed = pyqtSignal(str)

    def __init__(self, parent: QObject | None = None, arguments: Sequence[str] = _PROGRAM) -> None:
        super().__init__(parent)
        self._arguments = list(arguments)
        self._process = QProcess(self)
        self._process.finished.connect(self._finished)
        self._process.errorOccurred.connect(self._error_occurred)
        self._patience = QTimer(self)
        self._patience.setSingleShot(True)
        self._patience.setInterval(PATIENCE_MS)
        self._patience.timeout.connect(self._give_up)
        self._answered = False

    @property
    def running(self) -> bool:
        """Whether an answer is still to come."""
        return self._process.state() != QProcess.ProcessState.NotRunning

    def start(self) -> None:
        """Look for cameras, unless a search is going on."""
        if not self.running:
            self._answered = False
            self._process.start(sys.executable, self._arguments)
            self._patience.start()

    def stop(self) -> None:
        """Forget the search."""
        self._answered = True
        self._patience.stop()
        if self.running:
            self._process.kill()
            self._process.waitForFinished(500)

    def _give_up(self) -> None:
        self._fail(f"The camera driver does not answer: unplug the cameras and plug them in again, or {_DOCTOR}.")
        self._process.kill()

    def _error_occurred(self, error: QProcess.ProcessError) -> None:
        if error == QProcess.ProcessError.FailedToStart:
            self._fail(f"Cameras cannot be looked for: {self._process.errorString()}.")

    def _finished(self, status: int, how: QProcess.ExitStatus) -> None:
        self._patience.stop()
        output = bytes(self._process.readAllStandardOutput().data()).decode(errors="replace")
        complaint = bytes(self._process.readAllStandardError().data()).decode(errors="replace").strip()
        if how == QProcess.ExitStatus.CrashExit or status != 0:
            last = complaint.splitlines()[-1] if complaint else f"status {status}"
            self._fail(f"The camera driver failed while it looked for cameras ({last}): {_DOCTOR}.")
            return
        try:
            answer = json.loads(output.strip().splitlines()[-1])
            problem = answer.get("problem", "")
            hint = str(answer.get("hint", ""))
            cameras = [_camera(device) for device in answer.get("devices", [])]
        except (ValueError, IndexError, AttributeError, TypeError):
            self._fail(f"The search for cameras gave no answer: {_DOCTOR}.")
            return
        if problem:
            self._fail(sentence_of(problem))
        elif not self._answered:
            self._answered = True
            self.found.emit(cameras, hint)

    def _fail(self, sentence: str) -> None:
        if not self._answered:
            self._answered = True
            self._patience.stop()
            self.failed.emit(sentence)


def sentence_of(words: str) -> str:
    """Return words as a sentence, with a capital and a full stop."""
    return f"{words[0].upper()}{words[1:].rstrip('.')}."


def _camera(device: dict[str, Any]) -> FoundCamera:
    texts = {field.name: str(device.get(field.name, "") or "") for field in fields(FoundCamera)}
    return FoundCamera(**texts)
