"""What the checks of ``tactune doctor`` share: their lines, and child processes for what could crash or hang."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

#: Time limit of a child process, seconds: the first import of a package from a slow disk takes several.
PATIENCE_S = 20.0


class State(StrEnum):
    """Result of a check; ``WARN`` concerns only some uses."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True)
class Check:
    """One line of the report: what was checked, what was found, and what to do if something is wrong."""

    name: str
    state: State
    found: str
    remedy: str = ""

    def text(self) -> str:
        first = f"{self.state:<5}{self.name:<16}{self.found}"
        return f"{first}\n{'':<21}{self.remedy}" if self.remedy else first


@dataclass(frozen=True)
class Child:
    """Result of a child process: what it printed, or the ``problem`` in a few words."""

    out: str = ""
    problem: str = ""

    def answer(self) -> dict[str, Any]:
        """Return the JSON object on the last printed line; empty if there is none."""
        try:
            return dict(json.loads(self.out.strip().splitlines()[-1]))
        except (IndexError, ValueError, TypeError):
            return {}


RunChild = Callable[[Sequence[str]], Child]


def run_child(command: Sequence[str], patience_s: float = PATIENCE_S) -> Child:
    """Run a command and return its output. Never raises, and never waits longer than the limit."""
    try:
        done = subprocess.run(  # noqa: S603  # commands of this package, no shell
            list(command), check=False, capture_output=True, timeout=patience_s, stdin=subprocess.DEVNULL
        )
    except subprocess.TimeoutExpired:
        return Child(problem=f"no answer within {patience_s:g} s")
    except OSError as error:
        return Child(problem=f"{command[0]} cannot be started: {error.strerror or error}")
    out = done.stdout.decode(errors="replace")
    if done.returncode < 0:
        return Child(out, f"crashed ({signal.Signals(-done.returncode).name})")
    if done.returncode > 0:
        said = done.stderr.decode(errors="replace").strip().splitlines()
        return Child(out, said[-1] if said else f"exit status {done.returncode}")
    return Child(out)


def python_child(code: str, *arguments: str) -> list[str]:
    return [sys.executable, "-P", "-c", code, *arguments]
