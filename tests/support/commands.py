"""How a command of Tactune ended, and what a program prints while it runs."""

from __future__ import annotations

import queue
import threading
from typing import IO, AnyStr, NamedTuple

#: Longer than any program is silent, also on a busy machine.
SILENCE_S = 300


class Finished(NamedTuple):
    """Exit status, standard output and standard error."""

    status: int
    out: str
    err: str

    @property
    def sentence(self) -> str:
        """The one sentence on standard error of a command that failed as it should."""
        assert self.status == 2, self
        assert self.out == ""
        assert self.err.startswith("tactune: ")
        assert self.err.count("\n") == 1
        assert self.err.rstrip("\n").isprintable()
        assert len(self.err) < 1500
        return self.err


def read_line(stream: IO[AnyStr]) -> AnyStr:
    """Return the next line that a program prints; fail if none comes."""
    lines: queue.Queue[AnyStr] = queue.Queue()
    threading.Thread(target=lambda: lines.put(stream.readline()), daemon=True).start()
    try:
        return lines.get(timeout=SILENCE_S)
    except queue.Empty:
        raise AssertionError(f"a program printed nothing in {SILENCE_S} s") from None
