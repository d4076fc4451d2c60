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
    """Hands the newest item from one thread to another.

    Parameters
    ----------
    improves : callable, optional
        Tells whether the second item is only a better version of the first, which is then not
        counted as dropped.
    """

    def __init__(self, improves: Callable[[T, T], bool] = lambda _old, _new: False) -> None:
        self._improves = improves
        self._lock = Lock()
        self._item: T | None = None
        self._dropped = 0

    def put(self, item: T) -> bool:
        """Leave an item, replacing one that nobody took.

        Returns
        -------
        bool
            True where the slot was empty, so that the consumer needs waking; one wake-up is
            enough for any number of items.
        """
        with self._lock:
            waiting, self._item = self._item, item
            if waiting is not None and not self._improves(waiting, item):
                self._dropped += 1
        return waiting is None

    def take(self) -> T | None:
        """Take the newest item, or None where there is none."""
        with self._lock:
            item, self._item = self._item, None
        return item

    @property
    def dropped(self) -> int:
        """How many items were replaced before anybody took them."""
        with self._lock:
            return self._dropped


#: Qt aborts where a thread's object is deleted while it runs, so these are kept.
_left: list[QThread] = []


def leave_behind(thread: QThread) -> None:
    """Let a thread end by itself, silently, while its owner closes without waiting for it."""
    _left[:] = [old for old in _left if not old.isFinished()]
    thread.blockSignals(True)
    thread.setParent(None)
    _left.append(thread)


def wait_for_left(limit_s: float) -> bool:
    """Wait until those threads have ended, but no longer than a limit in all; return whether they have."""
    until = time.monotonic() + limit_s
    return all(thread.wait(max(0, round(1e3 * (until - time.monotonic())))) for thread in _left)


#: Python's 5 ms between thread switches would make the window wait for the other threads' Python code.
_SWITCH_INTERVAL_S: Final = 0.0005


def leave_room_for_the_window() -> None:
    """Let compiled kernels of the calling thread use all cores but one, and let threads take turns more often.

    The window draws on that one. Kernels that wait for a thread which the window keeps from running
    take several times longer than on one core alone.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    set_threads(available_threads() - 1)
