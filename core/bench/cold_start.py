"""How long importing takes in a new process."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from statistics import median

#: What a program imports that finds contact patches.
OURS = "import tactune.core; from tactune.core import ContactPipeline"
THEIRS = "import open3d"

_PROGRAM = "import time; start = time.perf_counter(); {}; print(time.perf_counter() - start)"


def import_seconds(statements: Sequence[str], rounds: int) -> list[float]:
    """Return the median time of each statement in processes of their own, in turns, after one without a clock.

    Parameters
    ----------
    statements : sequence of str
        Python statements on one line, such as `OURS`.
    rounds : int
        Processes of each.
    """
    taken: list[list[float]] = [[] for _ in statements]
    for done in range(rounds + 1):
        for times, statement in zip(taken, statements, strict=True):
            seconds = _seconds(statement)
            if done:
                times.append(seconds)
    return [median(times) for times in taken]


def _seconds(statement: str) -> float:
    command = [sys.executable, "-c", _PROGRAM.format(statement)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(done.stdout.splitlines()[-1])
