"""How the kernels are compiled: once, kept on disk where that is possible, never holding the GIL."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numba import njit

_kernels: list[Any] = []


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function at its first call; keep the machine code for the next process.

    numba keeps it beside the source, or else in the user's cache folder, or where the environment's
    ``NUMBA_CACHE_DIR`` says. Where none of them can be written, the kernel is compiled in each process.
    """
    try:
        compiled = njit(nogil=True, cache=True)(function)
    except RuntimeError:  # numba found no place to keep it
        compiled = njit(nogil=True)(function)
    _kernels.append(compiled)
    return compiled


def inline(function: Callable[..., Any]) -> Any:
    """Compile a function into each kernel that calls it."""
    return njit(inline="always")(function)


@dataclass(frozen=True)
class Compiled:
    """What has become of the kernels in this process.

    Attributes
    ----------
    loaded, compiled : int
        How many came from the disk and how many were compiled here.
    folders : tuple of Path
        Where they are kept; empty where nowhere.
    """

    loaded: int
    compiled: int
    folders: tuple[Path, ...]


def compiled_so_far() -> Compiled:
    """Return what has been compiled and loaded so far, over all kernels that are imported."""
    stats = [(kernel.stats, kernel) for kernel in _kernels]
    folders = {Path(stat.cache_path) for stat, _ in stats if stat.cache_path}
    loaded = sum(sum(stat.cache_hits.values()) for stat, _ in stats)
    return Compiled(loaded, sum(len(kernel.signatures) for _, kernel in stats) - loaded, tuple(sorted(folders)))


def is_kept(compiled: Any) -> bool:
    """Tell whether a kernel's machine code lies on the disk, younger than its source."""
    folder, source = compiled.stats.cache_path, Path(compiled.py_func.__code__.co_filename)
    if not folder:
        return False
    written = [file.stat().st_mtime for file in Path(folder).glob(f"{source.stem}.{compiled.__name__}-*.nbi")]
    return bool(written) and max(written) >= source.stat().st_mtime
