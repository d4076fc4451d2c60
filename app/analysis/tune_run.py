"""Runs ``tactune tune`` as a process of its own, at low priority, so that the window keeps its frame rate."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PyQt6.QtCore import QObject, QProcess, pyqtSignal

from ...core.contact.kernels.threads import available_threads
from ...core.preset import Preset
from ...core.preset.file import save_preset
from ...core.tuning.plan import Axis

#: Exit status after a stop by the person.
_STOPPED = 130
#: Longest wait for the process when the window closes, ms.
_END_MS = 2000


@dataclass(frozen=True)
class Request:
    """What to search: a source, the start, the ranges of the fields, and what is optimised beside the time."""

    source: str
    preset: Preset
    axes: tuple[Axis, ...]
    objective: str
    frames: range
    trials: int


class TuneRun(QObject):
    """One search at a time. One that was stopped continues where it ended, if nothing in the request has changed."""

    #: There are more `trials`, or another `front`.
    changed = pyqtSignal()
    #: The search is over; the sentence says what went wrong, or is empty.
    ended = pyqtSignal(str)

    def __init__(self, folder: Path, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._folder = folder
        self._process: QProcess | None = None
        self.request: Request | None = None
        #: The measured trials by number, with ``values``, ``figures``, ``failure`` and ``present``.
        self.trials: dict[int, dict[str, Any]] = {}
        self.front: tuple[int, ...] = ()
        self.stopping = False

    @property
    def busy(self) -> bool:
        """Whether a search runs."""
        return self._process is not None

    def start(self, request: Request) -> None:
        """Begin or continue a search; forget the former one's trials."""
        self.request, self.trials, self.front, self.stopping = request, {}, (), False
        name = hashlib.sha256(request.source.encode()).hexdigest()[:12]
        preset = self._folder / f"{name}.preset.json"
        save_preset(request.preset, preset)
        frames = request.frames
        words = ["-P", "-m", "tactune.app", "tune", "--json", "--source", request.source, "--preset", str(preset)]
        words += ["--objective", f"{request.objective},ms", "--trials", str(request.trials), "--sampler", "tpe"]
        words += ["--frames", f"{frames.start}:{frames.stop}:{frames.step}"]
        words += ["--study", str(self._folder / f"{name}.study.log")]
        words += ["--jobs", str(max(1, available_threads() - 1))]
        for axis in request.axes:
            words += ["--set", f"{axis.path}={axis.low!r}:{axis.high!r}{':log' if axis.log else ''}"]
        command = [sys.executable, *words]
        if (nice := shutil.which("nice")) is not None:
            command = [nice, "-n", "19", *command]  # with 10 the window loses a quarter of its frames on two cores
        self._process = process = QProcess(self)
        process.readyReadStandardOutput.connect(self._read)
        process.finished.connect(self._finished)
        process.errorOccurred.connect(self._not_started)
        process.start(command[0], command[1:])
        self.changed.emit()

    def stop(self) -> None:
        """Stop the search; its trials are kept. `ended` follows."""
        if self._process is not None:
            self.stopping = True
            self._process.terminate()

    def shut_down(self) -> None:
        """End the process now; emit nothing any more. Its measured trials are kept."""
        self.blockSignals(True)
        if self._process is not None:
            self._process.kill()
            self._process.waitForFinished(_END_MS)
            self._process = None

    def _read(self) -> None:
        if self._process is None:
            return
        while self._process.canReadLine():
            try:
                line = json.loads(self._process.readLine().data())
            except ValueError:
                continue  # printed by a library
            if "number" in line:
                self.trials[line["number"]] = line
            elif "front" in line:
                self.front = tuple(line["front"])
        self.changed.emit()

    def _finished(self, status: int) -> None:
        self._read()
        process, self._process = self._process, None
        assert process is not None
        said = bytes(process.readAllStandardError().data()).decode(errors="replace").strip().splitlines()
        process.deleteLater()
        well = status in (0, _STOPPED) or self.stopping
        unsaid = f"the search was ended (status {status}); its trials are kept, Start continues"
        last = said[-1].removeprefix("tactune: ") if said else unsaid
        self.ended.emit("" if well else f"{last[:1].upper()}{last[1:]}.")

    def _not_started(self, error: QProcess.ProcessError) -> None:
        if error == QProcess.ProcessError.FailedToStart and self._process is not None:
            self._process.deleteLater()
            self._process = None
            self.ended.emit("The search could not be started; use tactune tune on the command line.")


def frames_of(trim: Sequence[int] | None, length: int, count: int, index: int, has_truth: bool) -> range:
    """Return the frames to search on, between the in and out marks ``trim``.

    With truth they are spread evenly; without it they follow each other from the present frame ``index``, because
    stability compares consecutive frames.
    """
    first, end = trim or (0, length)
    count = min(count, end - first)
    if has_truth:
        step = max(1, (end - first) // count)
        return range(first, min(end, first + step * count), step)
    start = min(max(first, index), end - count)
    return range(start, start + count)
