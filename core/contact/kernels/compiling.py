"""How kernels are compiled: once, cached on disk if possible, and without holding the GIL."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import event

_kernels: list[Any] = []


def kernel(function: Callable[..., Any], *, allocates: bool = False, **options: Any) -> Any:
    """Compile a function at its first call, with numba's options; cache the machine code for the next process.

    Unless it ``allocates``, a kernel cannot create arrays; numba refuses to compile one that tries. In return, numba
    does not count references to its arguments. Counting would take longer than the work in inner loops, especially if
    several threads count the same references.

    numba caches beside the source, or else in the user's cache folder, or in ``NUMBA_CACHE_DIR``. If none of them is
    writable, the kernel is compiled in each process.
    """
    options["_nrt"] = allocates
    try:
        compiled = njit(nogil=True, cache=True, **options)(function)
        # numba checks the kernel's own file only, but code of other files is compiled into it; and it compares versions
        # before it reads anything else, which may name types that another version of this package had
        compiled._cache._cache_file._version += f" {_stamp(function.__code__.co_filename)}"
    except RuntimeError:  # numba found no writable cache folder
        compiled = njit(nogil=True, **options)(function)
    _kernels.append(compiled)
    return compiled


def inline(function: Callable[..., Any]) -> Any:
    """Compile a function into each kernel that calls it."""
    return njit(inline="always")(function)


@cache
def _stamp(file: str) -> tuple[tuple[str, int, int], ...]:
    """Return name, time and size of every file whose code may be part of a kernel: those beside it, and those here."""
    files = sorted({path for folder in {Path(file).parent, Path(__file__).parent} for path in folder.glob("*.py")})
    return tuple((path.name, path.stat().st_mtime_ns, path.stat().st_size) for path in files)


@dataclass(frozen=True)
class Compiled:
    """State of the kernels in this process."""

    #: Number of kernels loaded from the cache, and compiled in this process.
    loaded: int
    compiled: int
    folders: tuple[Path, ...]  # cache folders; empty if none is writable


def compiled_so_far() -> Compiled:
    """Return the state of all imported kernels."""
    stats = [(kernel.stats, kernel) for kernel in _kernels]
    folders = {Path(stat.cache_path) for stat, _ in stats if stat.cache_path}
    loaded = sum(sum(stat.cache_hits.values()) for stat, _ in stats)
    return Compiled(loaded, sum(len(kernel.signatures) for _, kernel in stats) - loaded, tuple(sorted(folders)))


@contextmanager
def counting_compiled(told: Callable[[int], object]) -> Iterator[None]:
    """Call ``told`` after each kernel that any thread compiles inside the block, with their number."""
    nested, count = 0, 0  # numba compiles one at a time

    def listen(happened: Any) -> None:
        nonlocal nested, count
        nested += 1 if happened.is_start else -1
        if nested == 0:  # what a kernel calls is compiled as a part of it
            count += 1
            told(count)

    class Listener(event.Listener):
        on_start = on_end = staticmethod(listen)

    with event.install_listener("numba:compile", Listener()):
        yield


def is_kept(compiled: Any) -> bool:
    """Return whether the machine code of a kernel is cached and newer than its sources."""
    folder, source = compiled.stats.cache_path, compiled.py_func.__code__.co_filename
    if not folder:
        return False
    written = [file.stat().st_mtime_ns for file in Path(folder).glob(f"{Path(source).stem}.{compiled.__name__}-*.nbi")]
    return bool(written) and max(written) >= max(time_ns for _, time_ns, _ in _stamp(source))
