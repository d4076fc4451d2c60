"""Where trials are measured: here, in local processes, or on a Dask cluster, as executors of `concurrent.futures`."""

from __future__ import annotations

import logging
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

from ..errors import MissingExtraError, TactuneError
from .plan import TuneError

#: Longest wait for the scheduler, seconds.
_CONNECT_S: Final = 10.0
_GONE: Final = "the Dask scheduler is gone; start it again, and the same command continues"


@dataclass(frozen=True)
class Workers:
    """An executor, and the number of batches that it measures at once; asking for it raises where they are gone."""

    executor: Executor
    count: Callable[[], int]

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
    def told(self) -> Iterator[None]:
        """Raise a `TuneError` for whatever error a batch that is submitted, or its result, gives."""
        try:
            yield
        except TactuneError:
            raise
        except Exception as error:
            self.count()  # a scheduler that is gone is the reason for whatever error its client gives
            raise TuneError(
                f"a worker failed or was killed ({type(error).__name__}: {_begin_of(error)}); try fewer --jobs "
                "if memory ran out, check that each worker has this version of Tactune, and give the same command again"
            ) from error


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
        yield Workers(executor, lambda: jobs)
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
    for name in ("distributed", "distributed.client"):  # it logs lost connections, which are raised as errors
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    security: Any = distributed.Security()  # type: ignore[no-untyped-call]
    try:
        if address.startswith("tls://") and security.get_connection_args("client")["ssl_context"] is None:
            raise ValueError("Dask's configuration has no certificates")
        comm: Any = distributed.comm
        comm.get_address_host_port(comm.normalize_address(address))  # a client that is never made waits 20 s as it goes
        client: Any = distributed.Client(  # type: ignore[no-untyped-call]
            address, timeout=_CONNECT_S, set_as_default=False
        )
    except (OSError, ValueError, TypeError) as error:
        raise TuneError(
            f"no Dask scheduler answers at {address} ({_begin_of(error)}); start one with dask scheduler and give the "
            "address that it prints, such as tcp://192.168.0.5:8786; tls:// needs ca-file, client.cert and client.key "
            "under distributed.comm.tls in Dask's configuration"
        ) from error

    def threads() -> int:
        try:
            if client.status == "running":
                return sum(client.nthreads().values())
        except Exception as error:  # what the client raises without a scheduler depends on where it lost it
            raise TuneError(_GONE) from error
        raise TuneError(_GONE)

    with client:
        try:
            client.wait_for_workers(1, timeout=_CONNECT_S)
        except TimeoutError as error:
            raise TuneError(
                f"the scheduler at {address} has no worker; start some with dask worker {address}"
            ) from error
        yield Workers(client.get_executor(pure=False), threads)


def _begin_of(error: Exception) -> str:
    return str(error).partition("\n")[0][:200]
