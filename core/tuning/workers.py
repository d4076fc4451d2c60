"""Where trials are measured: here, in local processes, or on a Dask cluster, as executors of `concurrent.futures`."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Final

from ..errors import MissingExtraError
from .plan import TuneError


@dataclass(frozen=True)
class Workers:
    """An executor, and the number of batches that it measures at once."""

    executor: Executor
    count: int

    def submit(self, work: Callable[..., Any], *arguments: object) -> Future[Any]:
        """Submit a batch.

        The executor may start a process for it, which inherits that Ctrl+C is held back. Otherwise a Ctrl+C would end
        it with a traceback while it still imports.
        """
        if not hasattr(signal, "pthread_sigmask"):  # Windows
            return self.executor.submit(work, *arguments)
        usual = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            return self.executor.submit(work, *arguments)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, usual)


@contextmanager
def local_workers(jobs: int) -> Iterator[Workers]:
    """Yield workers on this computer: processes of one thread each, or with one job a thread of this process."""
    # Processes inherit it. PYTHONSAFEPATH: they import nothing from the working folder.
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PYTHONSAFEPATH"), "1"))
    context = multiprocessing.get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    executor: Executor = (
        ProcessPoolExecutor(jobs, context, _begin_worker, (reader,)) if jobs > 1 else ThreadPoolExecutor(1)
    )
    try:
        yield Workers(executor, jobs)
    finally:
        writer.close()
        executor.shutdown(cancel_futures=True)


def _begin_worker(parent: Connection) -> None:
    """Ignore Ctrl+C, which a terminal sends to all processes, and end when the parent closes the pipe or dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        with suppress(EOFError, OSError):
            parent.recv()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


#: Longest wait for a Dask scheduler, seconds.
_CONNECT_S: Final = 10.0


@contextmanager
def cluster_workers(address: str) -> Iterator[Workers]:
    """Yield the workers of a Dask scheduler, one thread each. A batch whose worker dies is measured by another one.

    Raises a `MissingExtraError` without distributed, a `TuneError` if no scheduler with workers answers.
    """
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError("--scheduler needs dask: install it with pip install 'tactune[cluster]'") from error
    try:
        client: Any = distributed.Client(  # type: ignore[no-untyped-call]
            address, timeout=_CONNECT_S, set_as_default=False
        )
    except (OSError, ValueError, TypeError) as error:
        raise TuneError(
            f"no Dask scheduler answers at {address} ({str(error).partition(chr(10))[0][:200]}); start one with dask "
            "scheduler and give the address that it prints, such as tcp://192.168.0.5:8786"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_CONNECT_S)
        except TimeoutError as error:
            raise TuneError(
                f"the scheduler at {address} has no worker; start some with dask worker {address} --nthreads 1"
            ) from error
        yield Workers(client.get_executor(pure=False), sum(client.nthreads().values()))
