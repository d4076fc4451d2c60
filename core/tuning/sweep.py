"""A sweep from its plan to its last run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from .journal import Journal
from .plan import Batch, Plan
from .results import Result

#: Does batches in whatever order and place, and yields the results of each once it is done.
Engine = Callable[[Iterable[Batch]], Iterator[list[Result]]]


def measure_sweep(plan: Plan, journal: Journal, engine: Engine, workers: int) -> Iterator[int]:
    """Do the runs that the journal does not hold, and yield how many are done, first those found there.

    To cancel, close the iterator or let an error through: every run that was counted is kept.

    Parameters
    ----------
    plan : Plan
    journal : Journal
        Open; each run is kept in it at once.
    engine : callable
        Such as `local.run_locally` with a number of processes, or `cluster.Cluster.run`.
    workers : int
        How many batches the engine does at once.

    Raises
    ------
    TactuneError
        The engine cannot go on, or a run cannot be kept.
    """
    done = sum(run.key in journal for run in plan.runs)
    yield done
    finished = engine(plan.batches(journal.__contains__, workers))
    try:
        for results in finished:
            journal.add(results)
            done += len(results)
            yield done
    finally:
        close = getattr(finished, "close", None)
        if close is not None:
            close()
