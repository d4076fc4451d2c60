"""A one-slot mailbox: the newest item waits, older ones are dropped and counted.

A queue between a fast producer and a slow consumer grows and shows the past; a single slot always
shows the present.
"""

from __future__ import annotations

from threading import Lock
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Hands the newest item from one thread to another."""

    def __init__(self) -> None:
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
            was_empty = self._item is None
            if not was_empty:
                self._dropped += 1
            self._item = item
        return was_empty

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
