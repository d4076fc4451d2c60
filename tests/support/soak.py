"""Soak test: run the window on a live source for a long time while it records, and check for leaks.

Every few seconds a new recording begins; the finished one is opened, its frames are counted, and it is deleted. Between
two recordings the resident memory of the window and of the capture process is measured. A straight line is fitted to
it, without the first third of the run, where things warm up: its slope minus three standard errors must be below 1 MB
per minute. At exit, no thread, process, file descriptor or shared-memory segment may remain. Example::

    QT_QPA_PLATFORM=offscreen python tests/support/soak.py --minutes 30
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import psutil
from PyQt6.QtCore import QCoreApplication, QEvent, QObject, QTimer

from tactune.app.gui import make_application
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.core.errors import TactuneError
from tactune.core.output.writer import RecordingStatus
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source

LIMIT_MB_PER_MIN = 1.0
#: Shortest run in which the memory is judged, minutes: the allocator keeps what the longest queue so far needed.
JUDGED_FROM_MIN = 10.0
SETTLING_S = 5.0
#: Qt paints large images on threads of its own pool; it starts them when it likes and ends them after 30 s.
QT_POOL = Counter({"thread Thread (pooled)": os.cpu_count() or 1})
WARM_UP_FRAMES = 30


class Soak(QObject):
    """Drives one window: records, measures memory, closes."""

    def __init__(self, window: MainWindow, folder: Path, seconds: float, cycle_s: float) -> None:
        super().__init__(window)
        self.memory: list[tuple[float, float, float]] = []
        self.frames = self.recordings = 0
        self.problems: list[str] = []
        self._window, self._folder = window, folder
        self._seconds, self._cycle_s = seconds, cycle_s
        self._began_s = 0.0
        self._children: list[psutil.Process] = []
        window.worker.recordingEnded.connect(self._recorded)
        window.worker.recordingFailed.connect(self._give_up)
        window.worker.openFailed.connect(lambda name, sentence: self._give_up(sentence))
        window.error_hook.raised.connect(self._give_up)
        window.context.frameShown.connect(self._start)

    def _start(self) -> None:
        """Begin after the warm-up frames, because compiling kernels delays the first frame."""
        result = self._window.result
        if result is None or result.processed < WARM_UP_FRAMES:
            return
        self._window.context.frameShown.disconnect(self._start)
        self._children = psutil.Process().children()
        self._began_s = time.monotonic()
        self._record()

    def _record(self) -> None:
        self._window.worker.start_recording(self._folder / f"soak-{self.recordings}.mcap")
        QTimer.singleShot(int(1000 * self._cycle_s), self._window.worker.stop_recording)

    def _recorded(self, status: RecordingStatus, reason: str) -> None:
        """Check the recording, measure the memory, and go on or end."""
        self.recordings += 1
        self.frames += status.frames
        if reason or status.error:
            self.problems.append(reason or status.error)
        if status.frames:  # an empty recording leaves no file
            try:
                with open_source(str(status.path)) as recording:
                    if recording.length != status.frames:
                        self.problems.append(f"{recording.length} frames were recorded instead of {status.frames}")
            except TactuneError as error:
                self.problems.append(str(error))
            status.path.unlink(missing_ok=True)
        gc.collect()
        seconds = time.monotonic() - self._began_s
        self.memory.append((seconds / 60, resident_mb(psutil.Process()), sum(map(resident_mb, self._children))))
        if seconds < self._seconds:
            self._record()
            return
        if psutil.Process().children() != self._children:
            self.problems.append("the capture process was restarted")
        self._window.close_without_asking()

    def _give_up(self, sentence: str) -> None:
        self.problems.append(sentence)
        self._window.close_without_asking()


def resident_mb(process: psutil.Process) -> float:
    """Return the resident memory of a process in MB; 0 where it has ended."""
    return float(process.memory_info().rss) / 1e6 if process.is_running() else 0.0


def check_memory(samples: list[tuple[float, float, float]]) -> list[str]:
    """Print the slope of the memory of both processes; return a sentence for each that rises."""
    wrong = []
    minutes, *megabytes = np.array(samples).T
    warm = minutes >= minutes[-1] / 3
    for name, values in zip(("the window", "the capture process"), megabytes, strict=True):
        if warm.sum() < 4:
            continue
        (rise, _), covariance = np.polyfit(minutes[warm], values[warm], 1, cov=True)
        error = float(np.sqrt(covariance[0, 0]))
        print(f"memory of {name}: {values[-1]:.0f} MB, rises by {rise:+.2f} +- {error:.2f} MB per minute")
        if minutes[-1] >= JUDGED_FROM_MIN and rise - 3 * error >= LIMIT_MB_PER_MIN:
            wrong.append(f"the memory of {name} rises by {rise:.2f} MB per minute")
    return wrong


def open_things() -> Counter[str]:
    """Count what must be released: threads by name, processes, descriptors, shared-memory segments."""
    me = psutil.Process()
    threads = (Path(f"/proc/self/task/{thread.id}/comm") for thread in me.threads())
    counted = Counter(f"thread {name.read_text().strip()}" for name in threads if name.exists()) - QT_POOL
    counted.update({"process": len(me.children()), "descriptor": me.num_fds()})
    counted.update(f"shared memory {path.name}" for path in Path("/dev/shm").iterdir())  # only listed
    return counted


def settle(before: Counter[str]) -> Counter[str]:
    """Wait until the new resources are released, at most `SETTLING_S`; return what is open then."""
    deadline_s = time.monotonic() + SETTLING_S
    while True:
        gc.collect()
        after = open_things()
        if time.monotonic() > deadline_s or not after - before:
            return after
        time.sleep(0.1)


def run_window(source: str, seconds: float, cycle_s: float) -> Soak:
    """Open a window, run it, close it, and return its measurements."""
    preset = load_preset("simulator")
    application = make_application()
    with tempfile.TemporaryDirectory(prefix="tactune-soak-") as name:
        folder = Path(name)
        window = MainWindow(preset, Settings(folder / "window.json"), folder, native_dialogs=False)
        window.error_hook.install()
        window.resize(1280, 800)
        soak = Soak(window, folder, seconds, cycle_s)
        soak.setParent(None)
        window.show()
        window.open_source(source)
        application.exec()
        window.deleteLater()
        QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
        application.processEvents()
    return soak


def main() -> int:
    """Run the test; the exit status is 1 if there is a problem."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="live:sim")
    parser.add_argument("--minutes", type=float, default=30.0)
    options = parser.parse_args()
    seconds = 60 * options.minutes
    cycle_s = min(10.0, seconds / 20)
    # A first window loads what is kept for the whole process (compiled kernels, thread pools, fonts).
    warm_up = run_window(options.source, 8.0, 4.0)
    if not warm_up.frames:
        print("\n".join(warm_up.problems), file=sys.stderr)
        return 1
    del warm_up
    before = open_things()
    soak = run_window(options.source, seconds, cycle_s)
    wrong = [*soak.problems, *([] if soak.frames else ["nothing was recorded"])]
    print(f"recorded          {soak.frames} frames in {soak.recordings} recordings")
    wrong += check_memory(soak.memory)
    del soak
    left = settle(before) - before
    print(f"left behind       {left.total()}")
    wrong += [f"{name} left behind" for name in left]
    print("\n".join(f"WRONG: {sentence}" for sentence in wrong) or "all is well")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
