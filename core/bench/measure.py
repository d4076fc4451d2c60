"""Measuring engines side by side: in turns, in one run, with medians and quartiles."""

from __future__ import annotations

import ctypes
import random
import sys
import time
import tracemalloc
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

#: Each engine's share of a turn, seconds: a fast one runs often in it, a slow one once.
_TURN_S = 0.02
_MOST_CALLS_A_TURN = 25


@dataclass(frozen=True)
class Timing:
    """Run times of one engine in one run, milliseconds."""

    median_ms: float
    lower_ms: float
    upper_ms: float
    calls: int

    @classmethod
    def of(cls, seconds: list[float]) -> Timing:
        """Sum up single run times: median and quartiles."""
        lower, median, upper = np.percentile(np.array(seconds) * 1e3, (25, 50, 75))
        return cls(float(median), float(lower), float(upper), len(seconds))


def time_in_turns(
    runners: Mapping[str, Callable[[], Any]],
    rounds: int,
    *,
    seed: int = 0,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Timing]:
    """Run all in turns, in another order each round, so that whatever disturbs one disturbs all.

    Parameters
    ----------
    runners : mapping of str to callable
        Called once before the clock starts.
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
    shuffle = random.Random(seed)
    for done in range(rounds):
        shuffle.shuffle(order)
        for name in order:
            seconds[name] += _one_turn(runners[name])
        progress((done + 1) / rounds)
    return {name: Timing.of(taken) for name, taken in seconds.items()}


def _one_turn(run: Callable[[], Any]) -> list[float]:
    taken: list[float] = []
    while len(taken) < _MOST_CALLS_A_TURN and sum(taken) < _TURN_S:
        start = time.perf_counter()
        run()
        taken.append(time.perf_counter() - start)
    return taken


def peak_bytes(run: Callable[[], Any]) -> int | None:
    """Return how far one call raises the process's memory above what it held before, on Linux.

    Counts everything, native libraries as well; None where the system does not tell.
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


def allocated_bytes(run: Callable[[], Any], calls: int = 5) -> int:
    """Return the largest rise of traced Python and NumPy memory during one call, after warming up."""
    for _ in range(calls):
        run()
    tracemalloc.start()
    try:
        run()
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        run()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return peak - before


def bandwidth_bytes_per_s(size_bytes: int = 256 << 20, threads: int | None = None) -> float:
    """Measure memory bandwidth by copying arrays far larger than any cache, read plus written bytes."""
    import os
    from concurrent.futures import ThreadPoolExecutor

    workers = threads or os.cpu_count() or 1
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
    """Give freed memory back to the system, so that the next call has to ask for it again."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
