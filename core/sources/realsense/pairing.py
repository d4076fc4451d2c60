"""Which images of two streams belong together, decided while they arrive."""

from __future__ import annotations

from bisect import insort
from collections import deque
from dataclasses import dataclass, field
from typing import Generic, TypeVar

First = TypeVar("First")
Second = TypeVar("Second")
Item = TypeVar("Item")


@dataclass(frozen=True)
class Timed(Generic[Item]):
    """Something that was taken at ``time_s`` and reached us at ``arrival_s``."""

    time_s: float
    arrival_s: float
    item: Item


@dataclass
class Pairer(Generic[First, Second]):
    """Pairs two streams: each with the nearest of the other in time, at most half a period away, once.

    Each stream is taken to be in the order of time and its images to be at least half a period apart.

    Attributes
    ----------
    period_s : float
        Time between two images of a stream.
    patience_s : float
        How long an image waits for a partner that has not arrived.
    unmatched : int
        Images that found none.
    second_is_optional : bool
        Whether an image of the first stream is passed on alone when its patience ends.
    """

    period_s: float
    patience_s: float
    second_is_optional: bool = False
    unmatched: int = 0
    _first: list[Timed[First]] = field(default_factory=list)
    _second: list[Timed[Second]] = field(default_factory=list)
    _found: deque[tuple[Timed[First], Timed[Second] | None]] = field(default_factory=deque)

    def add_first(self, item: Timed[First]) -> None:
        """Add an image of the first stream."""
        insort(self._first, item, key=lambda each: each.time_s)

    def add_second(self, item: Timed[Second]) -> None:
        """Add an image of the second stream."""
        insort(self._second, item, key=lambda each: each.time_s)

    def take(self, now_s: float) -> list[tuple[Timed[First], Timed[Second] | None]]:
        """Return the pairs that are certain now, in the order of time."""
        half_s = 0.5 * self.period_s * (1 + 1e-6)  # stamps are sums of decimal fractions
        while self._first and self._second:
            apart_s = self._second[0].time_s - self._first[0].time_s
            if apart_s > half_s or self._has_nearer_next(self._first, self._second[0].time_s, apart_s):
                self._drop_first()
            elif apart_s < -half_s or self._has_nearer_next(self._second, self._first[0].time_s, apart_s):
                self._drop_second()
            elif self._may_have_nearer_to_come(apart_s, now_s):
                break
            else:
                self._found.append((self._first.pop(0), self._second.pop(0)))
        while self._first and now_s - self._first[0].arrival_s > self.patience_s:
            self._drop_first()
        while self._second and now_s - self._second[0].arrival_s > self.patience_s:
            self._drop_second()
        found = list(self._found)
        self._found.clear()
        return found

    def clear(self) -> None:
        """Forget what waits."""
        self._first.clear()
        self._second.clear()

    @staticmethod
    def _has_nearer_next(stream: list[Timed[First]] | list[Timed[Second]], time_s: float, apart_s: float) -> bool:
        return len(stream) > 1 and abs(stream[1].time_s - time_s) < abs(apart_s)

    def _may_have_nearer_to_come(self, apart_s: float, now_s: float) -> bool:
        """Tell whether the earlier one's successor, not here yet, may be nearer to the later one."""
        if abs(apart_s) <= 0.25 * self.period_s:
            return False
        earlier, later = (self._first, self._second) if apart_s > 0 else (self._second, self._first)
        return len(earlier) == 1 and now_s - later[0].arrival_s <= 1.5 * self.period_s

    def _drop_first(self) -> None:
        alone = self._first.pop(0)
        if self.second_is_optional:
            self._found.append((alone, None))
        else:
            self.unmatched += 1

    def _drop_second(self) -> None:
        self._second.pop(0)
        self.unmatched += 1
