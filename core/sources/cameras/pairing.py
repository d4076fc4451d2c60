"""Pairs images by time: of live cameras as they come, of recordings all at once."""

from __future__ import annotations

from bisect import insort
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from ...model.arrays import AnyArray, Float64Array, IndexArray

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

    def add(self, item: Timed[Item], *, second: bool) -> None:
        insort(self._second if second else self._first, item, key=lambda each: each.time_s)

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
        for stream in (self._first, self._second):
            while stream and now_s - stream[0].arrival_s > self.patience_s:
                self._drop(stream)
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


def nearest(times: AnyArray, candidates: AnyArray) -> IndexArray:
    """Return for each time the index of the nearest candidate; the earlier of two that are as near."""
    order = np.argsort(candidates, kind="stable")
    ordered = candidates[order]
    after = np.searchsorted(ordered, times).clip(1, max(len(ordered) - 1, 1))
    before = after - 1
    after = after.clip(max=len(ordered) - 1)
    later_is_nearer = ordered[after] - times < times - ordered[before]
    return order[np.where(later_is_nearer, after, before)]


def period_s(times_s: Float64Array, rate_hz: float = 30.0) -> float:
    """Return the median time between two images, seconds; with a single image, that of the nominal rate."""
    usual = float(np.median(np.diff(np.sort(times_s)))) if len(times_s) > 1 else 0.0
    return usual or 1.0 / (rate_hz if rate_hz > 0 else 30.0)


def nearest_within(times_s: Float64Array, candidates_s: Float64Array, farthest_s: float) -> IndexArray:
    """Return for each time the index of the nearest candidate, or -1 where that is farther away."""
    if not len(candidates_s):
        return np.full(len(times_s), -1)
    partner = nearest(times_s, candidates_s)
    # Stamps are sums and products of decimal fractions: exactly half a period must still count.
    return np.where(np.abs(candidates_s[partner] - times_s) <= farthest_s * (1 + 1e-6), partner, -1)


def pairs(first_s: Float64Array, second_s: Float64Array, farthest_s: float) -> tuple[IndexArray, IndexArray]:
    """Return the indices of images that are each other's nearest and at most ``farthest_s`` apart."""
    partner = nearest_within(first_s, second_s, farthest_s)
    chosen = np.flatnonzero((partner >= 0) & (nearest(second_s, first_s)[partner] == np.arange(len(first_s))))
    return chosen, partner[chosen]
