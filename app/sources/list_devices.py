"""Child processes for what may hang or crash, and the list of the connected cameras, for which one is asked."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from ...core.errors import SourceError, TactuneError

#: What a Python interpreter runs to list the cameras.
PROGRAM: Final = ("-P", "-m", "tactune.app.sources.list_devices")
#: Longest wait for it, seconds. Loading the driver takes a second or two.
PATIENCE_S = 15.0
#: Longest wait for another child process: the first import of a package from a slow disk takes several seconds.
_CHILD_S = 20.0


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


def run_child(command: Sequence[str], patience_s: float = _CHILD_S) -> Child:
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


def python_child(code: str) -> list[str]:
    return [sys.executable, "-P", "-c", code]


def ask_driver() -> dict[str, Any]:
    """Return ``{"devices": [...], "hint": clause, "problems": [clause, ...]}``; `SourceError` if there is no answer."""
    child = run_child([sys.executable, *PROGRAM], PATIENCE_S)
    answer = child.answer()
    if "problem" in answer:
        raise SourceError(str(answer["problem"]))
    if child.problem or "devices" not in answer:
        raise SourceError(
            f"the camera driver does not list its cameras ({child.problem or 'no answer'}); unplug the cameras and "
            "plug them in again, or run tactune doctor, which finds other causes"
        )
    return answer


def main() -> int:
    """Write the answer, or ``{"problem": clause}``, to standard output."""
    from ...core.sources.cameras.drivers import list_devices

    try:
        devices, hint, problems = list_devices()
        answer = {"devices": [asdict(device) for device in devices], "hint": hint, "problems": problems}
    except TactuneError as error:
        answer = {"problem": str(error)}
    sys.stdout.write(json.dumps(answer) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
