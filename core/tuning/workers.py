"""Where batches are measured: here, in local processes, or on a Dask cluster, as executors of `concurrent.futures`."""

from __future__ import annotations

import logging
import multiprocessing
import os
import re
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Final

import cv2

from ..errors import MissingExtraError
from .space import TuneError

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
    """Yield workers on this computer: processes of one thread each, or with one job a thread of this process."""
    threads = cv2.getNumThreads()
    # Processes inherit it. PYTHONSAFEPATH: they import nothing from the working folder.
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PYTHONSAFEPATH"), "1"))
    context = multiprocessing.get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    executor: Executor = (
        ProcessPoolExecutor(jobs, context, _begin_worker, (reader,)) if jobs > 1 else ThreadPoolExecutor(1)
    )
    try:
        yield Workers(executor, lambda: jobs)
    finally:
        writer.close()
        executor.shutdown(cancel_futures=True)
        cv2.setNumThreads(threads)  # the thread's measurements change it for the process


@contextmanager
def cluster_workers(address: str) -> Iterator[Workers]:
    """Yield the workers of a Dask scheduler. A batch whose worker dies is measured by another worker.

    Raises
    ------
    MissingExtraError
        distributed is not installed.
    TuneError
        No scheduler answers at that address, it has no worker, or Dask's configuration lacks its certificates.
    """
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError("--scheduler needs dask: install it with pip install 'tactune[cluster]'") from error
    if not _ADDRESS.fullmatch(address):
        raise TuneError(f"{address!r} is no scheduler's address; write it as tcp://192.168.0.5:8786")
    _check_certificates(address)
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


def _check_certificates(address: str) -> None:
    """Raise a `TuneError` where an address wants encryption and Dask's configuration has no certificates for it."""
    import distributed

    if not address.startswith("tls://"):
        return
    try:
        security: Any = distributed.Security()  # type: ignore[no-untyped-call]
        if security.get_connection_args("client")["ssl_context"] is not None:
            return
        reason = "Dask's configuration has none"
    except OSError as error:  # SSL errors, too
        reason = f"those of Dask's configuration cannot be read ({error.strerror or error})"
    raise TuneError(
        f"{address} needs certificates, but {reason}; set ca-file, client.cert and client.key "
        "under distributed.comm.tls"
    )


def _begin_worker(parent: Connection) -> None:
    """Ignore Ctrl+C, which a terminal sends to all processes, and end when the parent closes the pipe or dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        with suppress(EOFError, OSError):
            parent.recv()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
