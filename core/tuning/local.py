"""Batches of a sweep in processes on this computer, through joblib."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterable, Iterator
from types import ModuleType
from typing import Final

from ..errors import MissingExtraError
from .plan import Batch
from .results import Result
from .run import run_batch
from .values import SweepError

#: Seconds between a worker's looks at its parent.
_WATCH_S: Final = 0.5


def run_locally(batches: Iterable[Batch], jobs: int) -> Iterator[list[Result]]:
    """Yield the results of each batch as it is done, in any order.

    To cancel, close the iterator: processes that are at work are ended.

    Parameters
    ----------
    batches : iterable of Batch
        Taken as they are needed.
    jobs : int
        Processes, each with one thread; 1 works in this one.

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
                "a worker process was killed, perhaps for want of memory; try fewer --jobs, "
                "and the same command goes on"
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
    """Leave Ctrl-C, which a terminal sends to all processes, to the parent, and end when that has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_S)
        os._exit(1)

    if sys.platform != "win32":  # there a parent keeps its number when it has ended
        threading.Thread(target=watch, daemon=True).start()
