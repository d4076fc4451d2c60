"""Where batches are measured: here, in local processes, or on a Dask cluster, as executors of `concurrent.futures`."""

from __future__ import annotations

import logging
import multiprocessing
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Final

import cv2

from ..errors import MissingExtraError
from .space import TuneError

#: Interval at which a worker checks that its parent is alive, seconds.
_WATCH_S: Final = 0.2
#: Longest wait for the scheduler, seconds.
_CONNECT_S: Final = 10.0
SCHEDULER_GONE: Final = "the Dask scheduler is gone; start it again, and the same command continues"
_ADDRESS: Final = re.compile(r"([a-z]+://)?[^/\s]+:[0-9]{1,5}")


@dataclass(frozen=True)
class Workers:
    """Workers that measure batches.

    Attributes
    ----------
    executor : concurrent.futures.Executor
    count : callable
        Returns the number of batches that are measured at once.
    check : callable
        Raises a `TuneError` if the workers are gone.
    """

    executor: Executor
    count: Callable[[], int]
    check: Callable[[], None] = lambda: None


@contextmanager
def local_workers(jobs: int) -> Iterator[Workers]:
    """Yield workers on this computer: processes of one thread each, or with one job the calling process."""
    if jobs == 1:
        threads = cv2.getNumThreads()
        yield Workers(_Here(), lambda: 1)
        cv2.setNumThreads(threads)
        return
    # Processes inherit it. PYTHONSAFEPATH: they import nothing from the working folder.
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PYTHONSAFEPATH"), "1"))
    context = multiprocessing.get_context("spawn")
    ended = context.Event()
    executor = ProcessPoolExecutor(jobs, context, _begin_worker, (os.getpid(), ended))
    try:
        yield Workers(executor, lambda: jobs)
    finally:
        ended.set()
        executor.shutdown(cancel_futures=True)


@contextmanager
def cluster_workers(address: str) -> Iterator[Workers]:
    """Yield the workers of a Dask scheduler. A batch whose worker dies is measured by another worker.

    Raises
    ------
    MissingExtraError
        distributed is not installed.
    TuneError
        No scheduler answers at that address, or it has no worker.
    """
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError("--scheduler needs dask: install it with pip install 'tactune[cluster]'") from error
    if not _ADDRESS.fullmatch(address):
        raise TuneError(f"{address!r} is no scheduler's address; write it as tcp://192.168.0.5:8786")
    for name in ("distributed", "distributed.client"):  # it logs lost connections, which are raised as errors
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        client: Any = distributed.Client(  # type: ignore[no-untyped-call]
            address, timeout=_CONNECT_S, set_as_default=False
        )
    except (OSError, ValueError, TypeError) as error:
        raise TuneError(
            f"no Dask scheduler answers at {address} ({str(error).partition(chr(10))[0][:200]}); start one with "
            "dask scheduler and give the address that it prints, such as tcp://192.168.0.5:8786"
        ) from error

    closed = distributed.client.ClosedClientError

    def check() -> None:
        if client.status != "running":
            raise TuneError(SCHEDULER_GONE)

    def threads() -> int:
        try:
            workers = client.scheduler_info(n_workers=-1)["workers"].values()
        except Exception as error:  # what the client raises without a scheduler depends on where it lost it
            raise TuneError(SCHEDULER_GONE) from error
        return sum(worker["nthreads"] for worker in workers)

    with client:
        try:
            client.wait_for_workers(1, timeout=_CONNECT_S)
        except TimeoutError as error:
            raise TuneError(
                f"the scheduler at {address} has no worker; start some with dask worker {address}"
            ) from error
        executor = client.get_executor(pure=False)
        try:
            yield Workers(executor, threads, check)
        except closed as error:
            raise TuneError(SCHEDULER_GONE) from error
        finally:
            with suppress(closed):
                executor.shutdown(wait=False)


class _Here(Executor):
    """Runs each call at once, in the calling thread."""

    def submit(self, function: Callable[..., Any], /, *words: Any, **named: Any) -> Future[Any]:
        """Run the function and return its finished future."""
        future: Future[Any] = Future()
        try:
            future.set_result(function(*words, **named))
        except Exception as error:
            future.set_exception(error)
        return future


def _begin_worker(parent: int, ended: Any) -> None:
    """Ignore Ctrl+C, which a terminal sends to all processes, and end this process with its parent's work."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        # on Windows the parent's process number stays the same after it has ended
        while not ended.is_set() and (sys.platform == "win32" or os.getppid() == parent):
            time.sleep(_WATCH_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
