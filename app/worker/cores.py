"""How the processor's cores are shared between the window and its threads."""

from __future__ import annotations

import sys
from typing import Final

from ...core.contact.kernels.threads import available_threads, set_threads

#: Python's 5 ms between thread switches would make the window wait for the other threads' Python code.
_SWITCH_INTERVAL_S: Final = 0.0005


def leave_room_for_the_window() -> None:
    """Let compiled kernels of the calling thread use all cores but one, and let threads take turns more often.

    The window draws on that one. Kernels that wait for a thread which the window keeps from running
    take several times longer than on one core alone.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    set_threads(available_threads() - 1)
