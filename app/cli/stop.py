"""Ctrl+C and SIGTERM as the ordinary end of a command that would go on for ever."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

#: How long a live source may keep a person waiting who pressed Ctrl+C, in seconds.
WAIT_S = 0.2


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Yield what is set at the first Ctrl+C or SIGTERM; the second ends the program as usual."""
    stopped = threading.Event()
    usual = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, handler in usual.items():
            signal.signal(number, handler)

    def press(*_: object) -> None:
        stopped.set()
        restore()

    for number in usual:
        signal.signal(number, press)
    try:
        yield stopped
    finally:
        restore()
