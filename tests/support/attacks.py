"""Random damage to a file, and the limits that every file is read within, whatever it holds."""

from __future__ import annotations

import random
import resource
import signal
import struct
from collections.abc import Callable, Iterator
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


_NUMBERS = (0, 1, 255, 10**6, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1)


def _cut(data: bytearray, at: int, rng: random.Random) -> None:
    del data[max(at, 1) :]


def _flip(data: bytearray, at: int, rng: random.Random) -> None:
    data[at] ^= 1 << rng.randrange(8)


def _number(data: bytearray, at: int, rng: random.Random) -> None:
    number = struct.pack("<Q", rng.choice(_NUMBERS))[: rng.choice([2, 4, 8])]
    data[at : at + len(number)] = number


def _remove(data: bytearray, at: int, rng: random.Random) -> None:
    del data[at : at + rng.randrange(1, 300)]


def _insert(data: bytearray, at: int, rng: random.Random) -> None:
    data[at:at] = rng.randbytes(rng.randrange(1, 300))


_DAMAGES: tuple[Callable[[bytearray, int, random.Random], None], ...] = (_cut, _flip, _number, _remove, _insert)


def damaged(whole: bytes, rng: random.Random) -> bytes:
    data = bytearray(whole)
    damage = rng.choice(_DAMAGES)
    for _ in range(rng.choice([1, 1, 3, 20])):
        # Headers and indices stand at the start and the end.
        low, high = rng.choice([(0, len(data)), (0, 8000), (len(data) - 4000, len(data))])
        damage(data, rng.randrange(max(low, 0), max(min(high, len(data)), 1)), rng)
        if len(data) < 2:
            break
    return bytes(data)
