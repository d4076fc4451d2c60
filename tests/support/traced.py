"""Memory that Python and NumPy allocate in a call; that of native libraries is not traced."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass

#: Calls before memory is compared. Until then, traced objects replace objects that are older than the trace.
_BEFORE = 300


@dataclass(frozen=True)
class Allocation:
    """Largest rise during a call, its result included, and what all calls leave, bytes."""

    peak_bytes: int
    left_bytes: int


def allocation(call: Callable[[], object], calls: int = 50) -> Allocation:
    tracemalloc.start()
    try:
        for _ in range(_BEFORE):
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
