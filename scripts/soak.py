"""Run the window on a live source for long, recording all the while, and see that nothing grows or is left behind.

The source is captured in a process of its own; a new recording begins every few seconds, the finished one is opened,
its frames are counted, and it is deleted. Memory of both processes is taken whenever a recording is complete, since
none of its frames waits any more; a straight line through it must rise by less than 1 MB per minute (less three
standard errors, which matter in a short run only). At exit no thread, process, file descriptor or shared-memory
segment may be left. For example::

    QT_QPA_PLATFORM=offscreen python scripts/soak.py --minutes 30
"""

from __future__ import annotations

import argparse
import gc
import os
import re
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PyQt6.QtCore import QCoreApplication, QEvent, QObject, Qt, QTimer

from tactune.app.gui import make_application, start_with
from tactune.app.main_window import MainWindow
from tactune.app.recorder import RecordingEnd
from tactune.app.results import SourceState
from tactune.app.settings import Settings
from tactune.core.errors import TactuneError
from tactune.core.sources.registry import open_source

LIMIT_MB_PER_MIN = 1.0
HEARTBEAT_MS = 10
SETTLING_S = 5.0
WARM_UP_FRAMES = 30


@dataclass
class Tally:
    """What a run has measured."""

    memory: list[tuple[float, float, float]] = field(default_factory=list)
    frames: int = 0
    dropped: int = 0
    recordings: int = 0
    longest_gap_s: float = 0.0
    processor_s: float = 0.0
    told: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)


class Soak(QObject):
    """Drives one window: opens the source, records, samples, closes."""

    def __init__(self, window: MainWindow, folder: Path, seconds: float, cycle_s: float) -> None:
        super().__init__(window)
        self.tally = Tally()
        self._window = window
        self._folder = folder
        self._cycle_s = cycle_s
        self._began_s = self._beat_s = time.monotonic()
        self._end_s = self._began_s + seconds
        self._children: set[int] = set()
        window.worker.recordingEnded.connect(self._recorded)
        window.worker.recordingFailed.connect(self._fail)
        window.worker.openFailed.connect(lambda name, sentence: self._fail(sentence))
        window.error_hook.raised.connect(self._give_up)
        window.worker.stateChanged.connect(self._hear)
        window.frameShown.connect(self._start)
        self._every(HEARTBEAT_MS, self._beat)

    def _every(self, interval_ms: int, slot: object) -> None:
        timer = QTimer(self)
        timer.setTimerType(Qt.TimerType.PreciseTimer)
        timer.timeout.connect(slot)  # type: ignore[arg-type]
        timer.start(interval_ms)

    def _start(self) -> None:
        """Begin once frames flow: before the first ones kernels are compiled, which takes long."""
        result = self._window.result
        if result is None or result.processed < WARM_UP_FRAMES:
            return
        self._window.frameShown.disconnect(self._start)
        self._children = children()
        self.tally.processor_s = -time.process_time()
        self._record()

    def _record(self) -> None:
        path = self._folder / f"soak-{self.tally.recordings}.mcap"
        self._window.worker.start_recording(path)
        QTimer.singleShot(int(1000 * self._cycle_s), self._window.worker.stop_recording)

    def _recorded(self, end: RecordingEnd) -> None:
        """Check the recording, sum the cycle up and go on or end."""
        status, tally = end.status, self.tally
        tally.recordings += 1
        tally.frames += status.frames
        tally.dropped += status.dropped
        if end.reason or status.error:
            self._fail(end.reason or status.error)
        if status.frames:  # of none no file is kept
            self._check(status.path, status.frames)
        self._sample()
        if time.monotonic() < self._end_s:
            self._record()
            return
        tally.processor_s += time.process_time()
        if children() != self._children:
            self._fail("the capture process was restarted")
        self._window.close_without_asking()

    def _check(self, path: Path, frames: int) -> None:
        try:
            with open_source(str(path)) as recording:
                if recording.length != frames:
                    self._fail(f"{path.name} has {recording.length} frames instead of {frames}")
        except TactuneError as error:
            self._fail(str(error))
        path.unlink(missing_ok=True)

    def _sample(self) -> None:
        if self._children:
            minutes = (time.monotonic() - self._began_s) / 60
            self.tally.memory.append((minutes, memory_mb(os.getpid()), sum(map(memory_mb, self._children))))

    def _hear(self, state: SourceState) -> None:
        """Remember what the source says of itself; nothing, while all is well."""
        if self._children and state.health.message:
            self.tally.told[state.health.message] += 1

    def _beat(self) -> None:
        now_s = time.monotonic()
        if self._children:
            self.tally.longest_gap_s = max(self.tally.longest_gap_s, now_s - self._beat_s)
        self._beat_s = now_s

    def _give_up(self, sentence: str) -> None:
        """End the run after an error in the window or in this script."""
        self.tally.problems.append(sentence)
        self._window.close_without_asking()

    def _fail(self, sentence: str) -> None:
        self.tally.problems.append(sentence)
        if not self._children:
            self._window.close_without_asking()


def children() -> set[int]:
    """Return the numbers of all processes that this one has started."""
    tasks = Path("/proc/self/task").iterdir()
    return {int(number) for task in tasks for number in (task / "children").read_text().split()}


def memory_mb(pid: int) -> float:
    """Return the resident memory of a process in MB; 0 where it has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def open_things() -> dict[str, Counter[str]]:
    """List what must not be left behind: threads, processes, descriptors, segments."""
    return {
        "Python threads": Counter(thread.name for thread in threading.enumerate() if not is_foreign(thread)),
        "all threads": Counter("thread" for _ in Path("/proc/self/task").iterdir()),
        "processes": Counter("process" for _ in children()),
        "descriptors": Counter(target(entry) for entry in Path("/proc/self/fd").iterdir()),
        "shared memory": Counter(path.name for path in Path("/dev/shm").iterdir()),
    }


def is_foreign(thread: threading.Thread) -> bool:
    """Whether Python has only met this thread; Qt made it."""
    return thread.name.startswith("Dummy-")


def target(entry: Path) -> str:
    """Return what a descriptor is open on, without its number."""
    try:
        return re.sub(r"\d+", "N", str(entry.readlink()))
    except OSError:  # the one with which the folder is being read
        return ""


def settle(before: dict[str, Counter[str]]) -> dict[str, Counter[str]]:
    """Wait a little for what is about to end, and list what there is then."""
    deadline_s = time.monotonic() + SETTLING_S
    while True:
        gc.collect()
        after = open_things()
        if time.monotonic() > deadline_s or not any(after[name] - before[name] for name in after):
            return after
        time.sleep(0.1)


def slope(minutes: np.ndarray, megabytes: np.ndarray) -> tuple[float, float]:
    """Fit a straight line; return its slope in MB per minute and that slope's standard error."""
    if len(minutes) < 4:
        return 0.0, float("inf")
    (rise, _), covariance = np.polyfit(minutes, megabytes, 1, cov=True)
    return float(rise), float(np.sqrt(covariance[0, 0]))


def run_window(source: str, seconds: float, cycle_s: float) -> Tally:
    """Open a window, soak it, close it and let everything end."""
    preset, _ = start_with("simulator", source)
    application = make_application()
    with tempfile.TemporaryDirectory(prefix="tactune-soak-") as name:
        folder = Path(name)
        window = MainWindow(preset, Settings(folder / "window.ini"), folder, native_dialogs=False)
        window.error_hook.install()
        window.resize(1280, 800)
        soak = Soak(window, folder, seconds, cycle_s)
        window.show()
        window.open_source(source)
        application.exec()
        tally = soak.tally
        window.deleteLater()
        QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
        application.processEvents()
    return tally


def judge(tally: Tally, seconds: float, before: dict[str, Counter[str]]) -> list[str]:
    """Print what was measured and return what is wrong, in sentences."""
    wrong = list(tally.problems)
    if not tally.frames:
        wrong.append("nothing was recorded")
    warm = [sample for sample in tally.memory if sample[0] >= min(5.0, seconds / 60 / 3)]
    table = np.array(warm or np.zeros((0, 3)))
    print(f"recorded          {tally.frames} frames in {tally.recordings} recordings, {tally.dropped} dropped")
    print(f"processor time    {100 * tally.processor_s / seconds:.0f} % of one core in this process")
    print(f"longest gap of the event loop {1e3 * tally.longest_gap_s:.0f} ms")
    for sentence in tally.told:
        print(f"the source said    {sentence}")
    for column, process in ((1, "window"), (2, "capture process")):
        rise, error = slope(table[:, 0], table[:, column])
        last = table[-1, column] if len(table) else float("nan")
        print(f"{process:<17} {last:.0f} MB, rising by {rise:+.2f} +- {error:.2f} MB per minute, {len(table)} samples")
        if rise - 3 * error >= LIMIT_MB_PER_MIN:
            wrong.append(f"the memory of the {process} rises by {rise:.2f} MB per minute")
    after = settle(before)
    for name, things in after.items():
        left = things - before[name]
        print(f"{name:<17} {before[name].total()} before, {things.total()} after")
        if left:
            wrong.append(f"{name} left behind: {', '.join(left.elements())}")
    return wrong


def main() -> int:
    """Soak and judge; the exit status is 1 where something is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="live:sim")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--recording-seconds", type=float, default=10.0, help="length of each recording")
    options = parser.parse_args()
    seconds = 60 * options.minutes
    cycle_s = min(options.recording_seconds, seconds / 20)
    # What is loaded once and kept (compiled kernels, thread pools, fonts) is no leak: a first window loads it.
    warm_up = run_window(options.source, 8.0, 4.0)
    if not warm_up.frames:
        print("\n".join(warm_up.problems), file=sys.stderr)
        return 1
    before = open_things()
    wrong = judge(run_window(options.source, seconds, cycle_s), seconds, before)
    print("\n".join(f"WRONG: {sentence}" for sentence in wrong) or "all is well")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
