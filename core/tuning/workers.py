"""Engines that run the batches of a sweep: local processes by joblib, or a Dask cluster."""

from __future__ import annotations

import itertools
import logging
import os
import re
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any, Final

from ..errors import MissingExtraError, TactuneError
from .plan import Batch
from .results import Result
from .run import run_batch
from .values import SweepError

#: Interval at which a worker checks that its parent is alive, seconds.
_WATCH_S: Final = 0.5


def run_locally(batches: Iterable[Batch], jobs: int) -> Iterator[list[Result]]:
    """Run batches in local processes; yield the results of each batch when it is done, in any order.

    To cancel, close the iterator; the processes are then ended.

    Parameters
    ----------
    batches : iterable of Batch
        Consumed as workers become free.
    jobs : int
        Number of processes, each with one thread; 1 uses the calling process.

    Raises
    ------
    MissingExtraError
        joblib is not installed.
    TactuneError
        A batch cannot be done, or a process was killed.
    """
    joblib = check_joblib()
    from joblib.externals.loky.process_executor import BrokenProcessPool

    with joblib.parallel_config(
        backend="loky", inner_max_num_threads=1, initializer=_begin_worker, initargs=(os.getpid(),)
    ):
        parallel = joblib.Parallel(
            n_jobs=jobs, return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs", max_nbytes=None
        )
        results = parallel(joblib.delayed(run_batch)(batch) for batch in batches)
        try:
            yield from results
        except BrokenProcessPool as error:
            raise SweepError(
                "a worker process was killed, perhaps for lack of memory; try fewer --jobs, "
                "and the same command continues"
            ) from error
        finally:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "[0-9]+ tasks which were still being processed", UserWarning)
                results.close()


def check_joblib() -> ModuleType:
    """Return joblib.

    Raises
    ------
    MissingExtraError
        It is not installed.
    """
    try:
        import joblib
    except ImportError as error:
        raise MissingExtraError("sweeps need joblib: install it with pip install 'tactune[sweep]'") from error
    return joblib  # type: ignore[no-any-return]


def _begin_worker(parent: int) -> None:
    """Ignore Ctrl+C, which a terminal sends to all processes, and end this process when its parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_S)
        os._exit(1)

    if sys.platform != "win32":  # on Windows the parent's process number stays the same after it has ended
        threading.Thread(target=watch, daemon=True).start()


#: Longest wait for the scheduler, and interval of checks on the workers while no result arrives, seconds.
_CONNECT_S: Final = 10.0
_LOOK_S: Final = 2.0

_ADDRESS: Final = re.compile(r"([a-z]+://)?[^/\s]+:[0-9]{1,5}")

#: Batches queued on the cluster per thread, so that no thread is idle.
_AHEAD: Final = 2


class Cluster:
    """A connection to a Dask scheduler.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    @property
    def threads(self) -> int:
        """Number of batches that the workers can process at once."""
        return sum(worker["nthreads"] for worker in self._client.scheduler_info(n_workers=-1)["workers"].values())

    def run(self, batches: Iterable[Batch], waiting: Callable[[], None] = lambda: None) -> Iterator[list[Result]]:
        """Run batches on the cluster; yield the results of each batch once, in any order.

        If a worker dies, its batch is repeated on another worker. To cancel, close the iterator.

        Parameters
        ----------
        batches : iterable of Batch
        waiting : callable
            Called repeatedly while there is no worker.

        Raises
        ------
        TactuneError
            A batch cannot be done, the scheduler is gone, or a batch killed one worker after another.
        """
        distributed = _distributed()
        left = iter(batches)
        running: set[Any] = set()
        try:
            while True:
                room = _AHEAD * max(1, self.threads) - len(running)
                running |= {self._submit(batch) for batch in itertools.islice(left, max(0, room))}
                if not running:
                    return
                try:
                    done = distributed.wait(list(running), timeout=_LOOK_S, return_when="FIRST_COMPLETED").done
                except TimeoutError:
                    self._look(waiting)
                    continue
                except distributed.CancelledError as error:
                    raise _gone() from error
                running -= done
                for future in done:
                    yield _result_of(future)
        finally:
            if running and self._client.status == "running":
                self._client.cancel(list(running))

    def _submit(self, batch: Batch) -> Any:
        return self._client.submit(run_batch, batch, key=f"tactune-sweep-{batch.name}", pure=True)

    def _look(self, waiting: Callable[[], None]) -> None:
        if self._client.status != "running":
            raise _gone()
        if not self.threads:
            waiting()


@contextmanager
def connect(address: str) -> Iterator[Cluster]:
    """Connect to a Dask scheduler.

    Raises
    ------
    MissingExtraError
        dask or distributed is not installed.
    SweepError
        No scheduler answers at that address, or it has no worker.
    """
    distributed = _distributed()
    if not _ADDRESS.fullmatch(address):
        raise SweepError(f"{address!r} is no scheduler's address; write it as tcp://192.168.0.5:8786")
    try:
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise SweepError(
            f"no Dask scheduler answers at {address} ({_first_line(error)}); start one with dask scheduler "
            "and give the address that it prints, such as tcp://192.168.0.5:8786"
        ) from error
    with _quiet(), client, client.as_current():
        try:
            client.wait_for_workers(1, timeout=_CONNECT_S)
        except TimeoutError as error:
            raise SweepError(
                f"the scheduler at {address} has no worker; start some with dask worker {address}"
            ) from error
        yield Cluster(client)


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the client's log messages about lost connections; failures are raised as errors."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _result_of(future: Any) -> list[Result]:
    """Return the results of a batch; raise an error with the cause if it failed."""
    if future.status == "finished":
        results: list[Result] = future.result()
        return results
    if future.status != "error":
        raise _gone()
    error = future.exception()
    if isinstance(error, TactuneError):
        raise error
    raise SweepError(
        f"a worker of the cluster failed ({type(error).__name__}: {_first_line(error)}); check that each has "
        "this version of Tactune and enough memory, and give the same command again"
    )


def _gone() -> SweepError:
    return SweepError("the Dask scheduler is gone; start it again, and the same command continues")


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0][:200]


def _distributed() -> ModuleType:
    try:
        import distributed
    except ImportError as error:
        raise MissingExtraError("--scheduler needs dask: install it with pip install 'tactune[cluster]'") from error
    return distributed
