"""The limits that every file is read within, whatever it holds."""

from __future__ import annotations

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: Longest time of one file.
SECONDS = 10


@contextmanager
def bounded(file_bytes: int) -> Iterator[None]:
    """Fail where more memory or time is taken than a file of this size allows."""

    def too_long(*_: object) -> None:
        raise AssertionError(f"it takes more than {SECONDS} s")

    before = _status("VmRSS")
    limit = 10 * file_bytes + 300_000_000
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (_status("VmSize") + 2 * limit + 2**30, hard))  # keeps the machine alive
    Path("/proc/self/clear_refs").write_text("5")
    handler = signal.signal(signal.SIGALRM, too_long)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
    taken = _status("VmHWM") - before
    assert taken < limit, f"{taken / 1e6:.0f} MB for a file of {file_bytes / 1e6:.1f} MB"


def _status(name: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024
    raise AssertionError(name)
