"""Shares work between threads, without numba's threading layers.

Those abort the process when two Python threads start parallel kernels at once (workqueue) or in a forked child
(OpenMP). Here each kernel call releases the GIL and covers a part of the work; Python threads take one part after
another. The parts do not depend on the number of threads, so neither do the results.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import numpy as np

from ...model.arrays import AnyArray

_local = threading.local()
_lock = threading.Lock()
_pool: ThreadPoolExecutor | None = None

#: Image rows that one thread takes at a time.
ROWS: Final = 96


def available_threads() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def get_threads() -> int:
    """Return the number of threads that the calling thread's kernels use, itself included."""
    count: int = getattr(_local, "threads", 0)
    return count or available_threads()


def set_threads(count: int) -> None:
    """Set the number of threads that the calling thread's kernels use, itself included; at least 1."""
    _local.threads = max(1, count)


def scratch(name: str, count: int, dtype: type[np.generic]) -> AnyArray:
    """Return the calling thread's buffer of this name, uninitialised, with at least ``count`` elements.

    Each call returns the same array until a larger one is needed.
    """
    arrays: dict[str, AnyArray] = _local.__dict__.setdefault("arrays", {})
    found = arrays.get(name)
    if found is None or len(found) < count:
        found = arrays[name] = np.empty(count + count // 2, dtype)
    return found


def in_parallel(task: Callable[[int, int], object], count: int, size: int = ROWS) -> None:
    """Call ``task(first, last)`` for parts of ``range(count)``, on the calling thread and helper threads.

    Parts have ``size`` numbers, the last one may have fewer; ``last`` is exclusive. A helper that has not started when
    all parts are taken is cancelled. The first error of a task is raised.
    """
    parts = iter(range(0, count, size))

    def help_out() -> None:
        for first in parts:
            task(first, min(first + size, count))

    helpers = min(get_threads(), -(-count // size)) - 1
    pool = _helpers() if helpers > 0 else None
    futures = [pool.submit(help_out) for _ in range(helpers)] if pool is not None else []
    try:
        for first in parts:
            task(first, min(first + size, count))
    finally:
        begun = [future for future in futures if not future.cancel()]
        for future in begun:
            future.exception()
    for future in begun:
        future.result()


def _helpers() -> ThreadPoolExecutor:
    global _pool  # noqa: PLW0603  # one pool for the process
    with _lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(max(1, available_threads() - 1), thread_name_prefix="tactune")
        return _pool


def _forget_threads() -> None:
    """Reset the pool in a forked child, which has none of its parent's threads."""
    global _pool, _lock  # noqa: PLW0603  # one pool for the process
    _pool = None
    _lock = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_threads)
