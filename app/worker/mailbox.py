"""A one-slot mailbox: the newest item waits, older ones are dropped and counted.

A queue between a fast producer and a slow consumer grows and shows the past; a single slot always
shows the present.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

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
