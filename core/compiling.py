"""How the kernels are compiled: once, kept on disk where that is possible, never holding the GIL."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function at its first call; keep the machine code for the next process.

    numba keeps it beside the source, or else in the user's cache folder, or where the environment's
    ``NUMBA_CACHE_DIR`` says. Where none of them can be written, the kernel is compiled in each process.
    """
    try:
        return njit(nogil=True, cache=True)(function)
    except RuntimeError:  # numba found no place to keep it
        return njit(nogil=True)(function)


def inline(function: Callable[..., Any]) -> Any:
    """Compile a function into each kernel that calls it."""
    return njit(inline="always")(function)
