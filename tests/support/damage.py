"""Random damage to a file."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable

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
