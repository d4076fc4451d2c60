"""Measuring side by side: run times in turns, memory, bandwidth, import times, and facts about the machine."""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import random
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

#: Length of a turn, seconds: a fast engine runs many times in it, a slow one once.
_TURN_S = 0.02
MAX_CALLS_PER_TURN = 25
#: Calls before memory is compared. Until then, traced objects replace objects that are older than the trace.
_TRACED_BEFORE = 300


@dataclass(frozen=True)
class Timing:
    """Median and quartiles of one engine's run times in one run, milliseconds, and the number of calls."""

    median_ms: float
    lower_ms: float
    upper_ms: float
    calls: int

    @classmethod
    def of(cls, seconds: list[float]) -> Timing:
        """Summarise single run times."""
        lower, middle, upper = np.percentile(np.array(seconds) * 1e3, (25, 50, 75))
        return cls(float(middle), float(lower), float(upper), len(seconds))


def time_in_turns(
    runners: Mapping[str, Callable[[], Any]],
    rounds: int,
    *,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Timing]:
    """Run all in turns, in a random order each round, so that a disturbance affects all alike.

    Parameters
    ----------
    runners : mapping of str to callable
        Each is called once before the clock starts.
    rounds : int
        Turns of each.

    Returns
    -------
    dict of str to Timing
    """
    for run in runners.values():
        run()
    seconds: dict[str, list[float]] = {name: [] for name in runners}
    order = list(runners)
    shuffle = random.Random(0)  # noqa: S311  # an order, no secret
    for done in range(rounds):
        shuffle.shuffle(order)
        for name in order:
            seconds[name] += _one_turn(runners[name])
        progress((done + 1) / rounds)
    return {name: Timing.of(taken) for name, taken in seconds.items()}


def _one_turn(run: Callable[[], Any]) -> list[float]:
    taken: list[float] = []
    while len(taken) < MAX_CALLS_PER_TURN and sum(taken) < _TURN_S:
        start = time.perf_counter()
        run()
        taken.append(time.perf_counter() - start)
    return taken


def peak_bytes(run: Callable[[], Any]) -> int | None:
    """Return the peak rise of the process's memory during one call, native libraries included.

    None on systems other than Linux.
    """
    clear = Path("/proc/self/clear_refs")
    if not clear.exists():
        return None
    run()
    _trim()
    clear.write_text("5")
    before = _status_bytes("VmRSS")
    run()
    return max(0, _status_bytes("VmHWM") - before)


@dataclass(frozen=True)
class Allocation:
    """Memory that Python and NumPy allocate in one call, its result included, and what many calls leave, bytes."""

    peak_bytes: int
    left_bytes: int


def allocation(call: Callable[[], object], calls: int = 50) -> Allocation:
    """Return the largest rise of traced memory during a call, and the memory that all calls together leave behind.

    Memory of native libraries is not traced.
    """
    tracemalloc.start()
    try:
        for _ in range(_TRACED_BEFORE):
            result = call()
        gc.collect()
        first, _ = tracemalloc.get_traced_memory()
        rises = []
        for _ in range(calls):
            before, _ = tracemalloc.get_traced_memory()
            tracemalloc.reset_peak()
            result = call()
            rises.append(tracemalloc.get_traced_memory()[1] - before)
        gc.collect()
        last, _ = tracemalloc.get_traced_memory()
        del result
    finally:
        tracemalloc.stop()
    return Allocation(max(rises), last - first)


def bandwidth_bytes_per_s(size_bytes: int = 256 << 20) -> float:
    """Measure memory bandwidth by copying arrays far larger than any cache; counts bytes read plus bytes written."""
    workers = os.cpu_count() or 1
    parts = [np.ones(size_bytes // workers // 8) for _ in range(workers)]
    targets = [np.zeros_like(part) for part in parts]
    best_s = np.inf
    with ThreadPoolExecutor(workers) as pool:
        for _ in range(7):
            start = time.perf_counter()
            list(pool.map(np.copyto, targets, parts))
            best_s = min(best_s, time.perf_counter() - start)
    return 2 * sum(part.nbytes for part in parts) / best_s


def _status_bytes(field: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1]) * 1024
    return 0


def _trim() -> None:
    """Return freed memory to the system, so that the next call has to request it again."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


#: Import statements of a program that finds contact patches, and of the library compared with.
OURS = "import tactune.core; from tactune.core import ContactPipeline"
THEIRS = "import open3d"

_PROGRAM = "import time; start = time.perf_counter(); {}; print(time.perf_counter() - start)"


def import_seconds(statements: Sequence[str], rounds: int) -> list[float]:
    """Return the median run time of each statement, each run in a new process, in turns, after one untimed run.

    Parameters
    ----------
    statements : sequence of str
        Python statements on one line, such as `OURS`.
    rounds : int
        Timed processes per statement.
    """
    taken: list[list[float]] = [[] for _ in statements]
    for done in range(rounds + 1):
        for times, statement in zip(taken, statements, strict=True):
            seconds = _seconds(statement)
            if done:
                times.append(seconds)
    return [median(times) for times in taken]


def _seconds(statement: str) -> float:
    command = [sys.executable, "-P", "-c", _PROGRAM.format(statement)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603  # our own statements
    return float(done.stdout.splitlines()[-1])


_PACKAGES = ("numpy", "numba", "scipy", "opencv-contrib-python-headless", "open3d")


def machine_facts() -> dict[str, Any]:
    """Return processor, cores, memory, system, load and the versions of the compared packages."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
        "memory_gib": _memory_gib(),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "load_1min": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "packages": {name: _version(name) for name in _PACKAGES},
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _memory_gib() -> float | None:
    info = Path("/proc/meminfo")
    if not info.exists():
        return None
    return round(int(info.read_text().split()[1]) / 2**20, 1)
