"""Soak test: run the window on a live source for a long time while it records, and check for leaks.

A separate process captures the source. Every few seconds a new recording begins; the finished recording is opened, its
frames are counted, and it is deleted. Between two recordings the view is frozen and memory is measured: the memory in
use by the window, and the resident memory of both processes. The allocator keeps memory for the longest queue of frames
so far, which depends on the machine's load. The window's resident memory is therefore checked only in runs of at least
10 minutes.

A leak grows throughout the run, warm-up does not. A straight line is fitted to the memory; the first third of the run
(at most 5 minutes) is excluded. The slope minus three standard errors must be below 1 MB per minute. If it is not at
the planned end, or if the slope plus three standard errors reaches 3 MB per minute, the run is extended by its planned
duration, at most twice. At exit, no thread, process, file descriptor or shared-memory segment may remain. Example::

    QT_QPA_PLATFORM=offscreen python scripts/soak.py --minutes 30
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import os
import re
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import astuple, dataclass, field
from pathlib import Path

import numpy as np
from PyQt6.QtCore import QCoreApplication, QEvent, QObject, Qt, QTimer

from tactune.app.gui import make_application, start_with
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.recorder import RecordingEnd
from tactune.app.worker.results import SourceState
from tactune.core.errors import TactuneError
from tactune.core.sources.registry import open_source

LIMIT_MB_PER_MIN = 1.0
#: The run is extended if the slope plus three standard errors reaches this value.
DOUBT_MB_PER_MIN = 3.0
EXTENSIONS = 2
RESIDENT_FROM_S = 600.0
#: Between two recordings, memory is measured LOOKS times, every LOOK_MS milliseconds. The minimum is used.
LOOK_MS = 20
LOOKS = 30
HEARTBEAT_MS = 10
SETTLING_S = 5.0
#: Qt paints large images on threads of its own pool; it starts them when it likes and ends them after 30 s.
QT_POOL = Counter({"Thread (pooled)": os.cpu_count() or 1})
WARM_UP_FRAMES = 30


@dataclass(frozen=True)
class Memory:
    """Memory at one moment, MB."""

    minute: float
    in_use: float
    resident: float
    captures: float


@dataclass(frozen=True)
class Line:
    """Slope of memory over time and its standard error, MB per minute."""

    rise: float
    error: float

    @property
    def rises(self) -> bool:
        """Whether the slope exceeds the limit by more than three standard errors."""
        return self.rise - 3 * self.error >= LIMIT_MB_PER_MIN

    @property
    def unsure(self) -> bool:
        """Whether the run must be extended."""
        return self.rises or not self.rise + 3 * self.error < DOUBT_MB_PER_MIN


@dataclass
class Tally:
    """The measurements of a run."""

    memory: list[Memory] = field(default_factory=list)
    seconds: float = 0.0
    frames: int = 0
    dropped: int = 0
    recordings: int = 0
    longest_gap_s: float = 0.0
    processor_s: float = 0.0
    told: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)


class Soak(QObject):
    """Drives one window: records, measures memory, closes."""

    def __init__(self, window: MainWindow, folder: Path, seconds: float, cycle_s: float) -> None:
        super().__init__(window)
        self.tally = Tally()
        self._window = window
        self._folder = folder
        self._cycle_s = cycle_s
        self._seconds = seconds
        self._extensions = 0
        self._began_s = self._beat_s = time.monotonic()
        self._looks: list[Memory] = []
        self._look_again = self._timer(LOOK_MS, self._look)
        self._children: set[int] = set()
        window.worker.recordingEnded.connect(self._recorded)
        window.worker.recordingFailed.connect(self._fail)
        window.worker.openFailed.connect(lambda name, sentence: self._fail(sentence))
        window.error_hook.raised.connect(self._give_up)
        window.worker.stateChanged.connect(self._hear)
        window.context.frameShown.connect(self._start)
        self._timer(HEARTBEAT_MS, self._beat).start()

    def _timer(self, interval_ms: int, slot: object) -> QTimer:
        timer = QTimer(self)
        timer.setTimerType(Qt.TimerType.PreciseTimer)
        timer.setInterval(interval_ms)
        timer.timeout.connect(slot)  # type: ignore[arg-type]
        return timer

    def _start(self) -> None:
        """Begin after the warm-up frames, because compiling kernels delays the first frame."""
        result = self._window.result
        if result is None or result.processed < WARM_UP_FRAMES:
            return
        self._window.context.frameShown.disconnect(self._start)
        self._children = children()
        self._began_s = self._beat_s = time.monotonic()
        self.tally.processor_s = -time.process_time()
        self._record()

    def _record(self) -> None:
        path = self._folder / f"soak-{self.tally.recordings}.mcap"
        self._window.worker.start_recording(path)
        QTimer.singleShot(int(1000 * self._cycle_s), self._window.worker.stop_recording)

    def _recorded(self, end: RecordingEnd) -> None:
        """Check the recording, update the tally and start to measure memory."""
        status, tally = end.status, self.tally
        tally.recordings += 1
        tally.frames += status.frames
        tally.dropped += status.dropped
        if end.reason or status.error:
            self._fail(end.reason or status.error)
        if status.frames:  # an empty recording leaves no file
            self._check(status.path, status.frames)
        # Queued frames and uncollected garbage vary, so both are excluded from the measurement.
        self._window.worker.set_frozen(True)
        gc.collect()
        self._beat_s = time.monotonic()
        self._looks.clear()
        self._look_again.start()

    def _look(self) -> None:
        """Measure memory; after the last measurement, continue or end the run."""
        self._looks.append(memory((time.monotonic() - self._began_s) / 60, self._children))
        if len(self._looks) < LOOKS:
            return
        self._look_again.stop()
        self._window.worker.set_frozen(False)
        self.tally.memory.append(least(self._looks))
        self.tally.seconds = time.monotonic() - self._began_s
        if self._goes_on():
            self._record()
        else:
            self._end()

    def _goes_on(self) -> bool:
        """Return whether the run continues; extend it if it is over and the slope is uncertain."""
        if self.tally.seconds >= self._seconds * (1 + self._extensions) and self._extensions < EXTENSIONS:
            self._extensions += any(line.unsure for line in lines(self.tally).values())
        return self.tally.seconds < self._seconds * (1 + self._extensions)

    def _end(self) -> None:
        self.tally.processor_s += time.process_time()
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

    def _hear(self, state: SourceState) -> None:
        """Count the health messages of the source; a healthy source has none."""
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
    """Return the process numbers of all children of this process."""
    tasks = Path("/proc/self/task").iterdir()
    return {int(number) for task in tasks for number in (task / "children").read_text().split()}


class AllocatorState(ctypes.Structure):
    """The result of mallinfo2(3), glibc 2.33 or newer; only the free memory is used."""

    _fields_ = (("before", ctypes.c_size_t * 8), ("free", ctypes.c_size_t), ("after", ctypes.c_size_t))


LIBC = ctypes.CDLL(None)
MALLINFO = getattr(LIBC, "mallinfo2", None)  # older libraries lack it: all resident memory then counts as in use
if MALLINFO is not None:
    MALLINFO.restype = AllocatorState


def memory(minute: float, captures: set[int]) -> Memory:
    """Return the present memory of this process and of the capture processes."""
    resident = resident_mb(os.getpid())
    in_use = resident - (MALLINFO().free / 1e6 if MALLINFO is not None else 0.0)
    return Memory(minute, in_use, resident, sum(map(resident_mb, captures)))


def resident_mb(pid: int) -> float:
    """Return the resident memory of a process in MB; 0 where it has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def least(looks: list[Memory]) -> Memory:
    """Return the minimum of each value."""
    return Memory(*np.min([astuple(look) for look in looks], axis=0))


def lines(tally: Tally) -> dict[str, Line]:
    """Return the fitted line of each memory value that is checked."""
    table = np.array([astuple(sample) for sample in tally.memory]).reshape(-1, 4)
    minutes = table[:, 0]
    warm = minutes >= min(5.0, tally.seconds / 60 / 3)
    columns = {"in use by the window": 1, "resident of the capture process": 3}
    if tally.seconds >= RESIDENT_FROM_S:
        columns["resident of the window"] = 2
    return {name: straight_line(minutes[warm], table[warm, column]) for name, column in columns.items()}


def straight_line(minutes: np.ndarray, megabytes: np.ndarray) -> Line:
    """Fit a straight line; with fewer than four points its error is infinite."""
    if len(minutes) < 4:
        return Line(0.0, float("inf"))
    (rise, _), covariance = np.polyfit(minutes, megabytes, 1, cov=True)
    return Line(float(rise), float(np.sqrt(covariance[0, 0])))


def open_things() -> dict[str, Counter[str]]:
    """Count the resources that must be released: threads, processes, descriptors, shared-memory segments."""
    return {
        "Python threads": Counter(thread.name for thread in threading.enumerate() if not is_foreign(thread)),
        "all threads": Counter(name_of(task) for task in Path("/proc/self/task").iterdir()) - QT_POOL,
        "processes": Counter("process" for _ in children()),
        "descriptors": Counter(target(entry) for entry in Path("/proc/self/fd").iterdir()),
        "shared memory": Counter(path.name for path in Path("/dev/shm").iterdir()),  # noqa: S108  # only listed
    }


def is_foreign(thread: threading.Thread) -> bool:
    """Return whether the thread was not started by Python, but for example by Qt."""
    return thread.name.startswith("Dummy-")


def name_of(task: Path) -> str:
    """Return the name of a thread; a thread without one has that of the process."""
    try:
        return (task / "comm").read_text().strip()
    except OSError:  # it has just ended
        return ""


def target(entry: Path) -> str:
    """Return the target of a file descriptor, with all digits replaced."""
    try:
        return re.sub(r"\d+", "N", str(entry.readlink()))
    except OSError:  # the descriptor with which this folder is read
        return ""


def settle(before: dict[str, Counter[str]]) -> dict[str, Counter[str]]:
    """Wait until the new resources are released, at most `SETTLING_S`; return what is open then."""
    deadline_s = time.monotonic() + SETTLING_S
    while True:
        gc.collect()
        after = open_things()
        if time.monotonic() > deadline_s or not any(after[name] - before[name] for name in after):
            return after
        time.sleep(0.1)


def run_window(source: str, seconds: float, cycle_s: float) -> Tally:
    """Open a window, run it, close it, and return its measurements."""
    preset, _ = start_with("simulator")
    application = make_application()
    with tempfile.TemporaryDirectory(prefix="tactune-soak-") as name:
        folder = Path(name)
        window = MainWindow(preset, Settings(folder / "window.json"), folder, native_dialogs=False)
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


def judge(tally: Tally, before: dict[str, Counter[str]]) -> list[str]:
    """Print the measurements and return the problems as sentences."""
    wrong = list(tally.problems)
    if not tally.frames:
        wrong.append("nothing was recorded")
    print(f"recorded          {tally.frames} frames in {tally.recordings} recordings, {tally.dropped} dropped")
    print(f"lasted            {tally.seconds:.0f} s")
    print(f"processor time    {100 * tally.processor_s / max(tally.seconds, 1.0):.0f} % of one core in this process")
    print(f"longest gap of the event loop {1e3 * tally.longest_gap_s:.0f} ms")
    for sentence in tally.told:
        print(f"the source said    {sentence}")
    for sample in tally.memory[-1:]:
        print(f"memory            window {sample.resident:.0f} MB, of which {sample.in_use:.0f} MB in use; ", end="")
        print(f"capture process {sample.captures:.0f} MB")
    for name, line in lines(tally).items():
        print(f"{name} rises by {line.rise:+.2f} +- {line.error:.2f} MB per minute")
        if line.rises:
            wrong.append(f"memory {name} rises by {line.rise:.2f} MB per minute")
    after = settle(before)
    for name, things in after.items():
        left = things - before[name]
        print(f"{name:<17} {before[name].total()} before, {things.total()} after")
        if left:
            wrong.append(f"{name} left behind: {', '.join(left.elements())}")
    return wrong


def main() -> int:
    """Run the test; the exit status is 1 if there is a problem."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="live:sim")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--recording-seconds", type=float, default=10.0, help="length of each recording")
    options = parser.parse_args()
    seconds = 60 * options.minutes
    cycle_s = min(options.recording_seconds, seconds / 20)
    # A first window loads what is kept for the whole process (compiled kernels, thread pools, fonts).
    warm_up = run_window(options.source, 8.0, 4.0)
    if not warm_up.frames:
        print("\n".join(warm_up.problems), file=sys.stderr)
        return 1
    before = open_things()
    wrong = judge(run_window(options.source, seconds, cycle_s), before)
    print("\n".join(f"WRONG: {sentence}" for sentence in wrong) or "all is well")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
