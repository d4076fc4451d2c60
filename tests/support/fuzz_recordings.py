"""Open randomly damaged recordings; the exit status is an error unless each gives frames or one clear sentence.

    fuzz_recordings.py FOLDER SEED COUNT RECORDING...

Memory is limited, so an allocation of the size that a damaged field states is an error, too.
"""

from __future__ import annotations

import random
import resource
import struct
import sys
from collections.abc import Callable
from pathlib import Path

from tactune.core.errors import SourceError
from tactune.core.sources.realsense_files import BagSource

_LARGEST_MEMORY = 3 * 2**30
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


def open_damaged(path: Path, whole: bytes, seed: int) -> bool:
    """Return whether all frames could be read."""
    path.write_bytes(damaged(whole, random.Random(seed)))
    try:
        with BagSource(path) as source:
            for _ in source:
                pass
    except SourceError as error:
        if "\n" in str(error) or len(str(error)) > 800:
            raise RuntimeError(f"seed {seed}: no sentence: {error}") from error
        return False
    except BaseException as error:
        raise RuntimeError(f"seed {seed}: {error!r}") from error
    return True


def main() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_LARGEST_MEMORY, _LARGEST_MEMORY))
    folder, seed, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    wholes = [Path(path).read_bytes() for path in sys.argv[4:]]
    readable = sum(
        open_damaged(folder / "damaged.bin", wholes[index % len(wholes)], seed + index) for index in range(count)
    )
    sys.stdout.write(f"{readable} {count - readable}\n")


if __name__ == "__main__":
    main()
