"""How the processor's cores are shared between the window and its threads."""

from __future__ import annotations

from ..core.threads import available_threads, set_threads


def leave_room_for_the_window() -> None:
    """Let compiled kernels of the calling thread use all cores but one.

    The window draws on that one. Kernels that wait for a thread which the window keeps from running
    take several times longer than on one core alone.
    """
    set_threads(available_threads() - 1)
