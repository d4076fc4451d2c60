"""Pairs the images of two cameras by time."""

from __future__ import annotations

from bisect import insort
from dataclasses import dataclass, field
from typing import Generic, TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True)
class Timed(Generic[Item]):
    """An item that was taken at ``time_s`` and arrived at ``arrival_s``."""

    time_s: float
    arrival_s: float
    item: Item


@dataclass
class Pairer(Generic[Item]):
    """Pairs the images of two streams, each in time order, that are nearest in time and at most half a period apart."""

    period_s: float
    patience_s: float
    unmatched: int = 0
    _first: list[Timed[Item]] = field(default_factory=list)
    _second: list[Timed[Item]] = field(default_factory=list)

    def add_first(self, item: Timed[Item]) -> None:
        insort(self._first, item, key=lambda each: each.time_s)

    def add_second(self, item: Timed[Item]) -> None:
        insort(self._second, item, key=lambda each: each.time_s)

    def take(self, now_s: float) -> list[tuple[Timed[Item], Timed[Item]]]:
        """Return the pairs that no later image can change, in time order."""
        half_s = 0.5 * self.period_s * (1 + 1e-6)  # stamps are sums of decimal fractions
        found = []
        # A stream's oldest image goes if the other's oldest is much later, or nearer to this stream's next one.
        while self._first and self._second:
            apart_s = self._second[0].time_s - self._first[0].time_s
            if apart_s > half_s or self._has_nearer_next(self._first, self._second[0].time_s, apart_s):
                self._drop(self._first)
            elif apart_s < -half_s or self._has_nearer_next(self._second, self._first[0].time_s, apart_s):
                self._drop(self._second)
            elif self._may_have_nearer_to_come(apart_s, now_s):
                break
            else:
                found.append((self._first.pop(0), self._second.pop(0)))
        while self._first and now_s - self._first[0].arrival_s > self.patience_s:
            self._drop(self._first)
        while self._second and now_s - self._second[0].arrival_s > self.patience_s:
            self._drop(self._second)
        return found

    @staticmethod
    def _has_nearer_next(stream: list[Timed[Item]], time_s: float, apart_s: float) -> bool:
        return len(stream) > 1 and abs(stream[1].time_s - time_s) < abs(apart_s)

    def _may_have_nearer_to_come(self, apart_s: float, now_s: float) -> bool:
        """Return whether the next image of the earlier stream, not received yet, may be nearer to the later image."""
        if abs(apart_s) <= 0.25 * self.period_s:
            return False
        earlier, later = (self._first, self._second) if apart_s > 0 else (self._second, self._first)
        return len(earlier) == 1 and now_s - later[0].arrival_s <= 1.5 * self.period_s

    def _drop(self, stream: list[Timed[Item]]) -> None:
        stream.pop(0)
        self.unmatched += 1
