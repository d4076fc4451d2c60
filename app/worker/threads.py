"""What threads share: the latest-frame mailbox, abandoned threads, and the processor's cores."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from threading import Lock
from typing import Final, Generic, TypeVar

from PyQt6.QtCore import QThread

from ...core.contact.kernels.threads import available_threads, set_threads

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Passes the newest item from one thread to another; older items are dropped and counted.

    A queue between a fast producer and a slow consumer grows and shows the past; one slot shows the present.
    An item that ``improves`` the one before does not count it as dropped.
    """

    def __init__(self, improves: Callable[[T, T], bool] = lambda _old, _new: False) -> None:
        self._improves = improves
        self._lock = Lock()
        self._item: T | None = None
        self.dropped = 0  # items that were replaced before anybody took them

    def put(self, item: T) -> bool:
        """Store an item in place of one that nobody took; return True if the consumer must be woken."""
        with self._lock:
            waiting, self._item = self._item, item
            if waiting is not None and not self._improves(waiting, item):
                self.dropped += 1
        return waiting is None

    def take(self) -> T | None:
        """Return the newest item and empty the slot; None if it is empty."""
        with self._lock:
            item, self._item = self._item, None
        return item


#: Abandoned threads. Qt aborts if the object of a running thread is deleted, so they are kept here.
_abandoned: list[QThread] = []


def abandon(thread: QThread) -> None:
    """Abandon a thread: its signals are blocked, its owner closes without waiting, and it ends by itself."""
    _abandoned[:] = [old for old in _abandoned if not old.isFinished()]
    thread.blockSignals(True)
    thread.setParent(None)
    _abandoned.append(thread)


def wait_for_abandoned(limit_s: float) -> bool:
    """Wait until all abandoned threads have ended, at most ``limit_s`` in total; return whether they have."""
    until = time.monotonic() + limit_s
    return all(thread.wait(max(0, round(1e3 * (until - time.monotonic())))) for thread in _abandoned)


#: With Python's default of 5 ms the window would wait for the Python code of other threads.
_SWITCH_INTERVAL_S: Final = 0.0005


def leave_room_for_the_window() -> None:
    """Let kernels called from this thread use all cores but one, and let Python switch threads more often.

    The window draws on the remaining core. A parallel kernel whose threads compete with the window takes
    several times longer than the same kernel on one core.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    set_threads(available_threads() - 1)
