"""Images of both cameras become frames: placed on one clock, paired, and queued until they are read."""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field
from threading import Condition
from typing import Final, Generic, TypeVar

from ...model.arrays import AnyArray
from ..base import CameraRole
from .camera import Image, Kind

First = TypeVar("First")
Second = TypeVar("Second")
Item = TypeVar("Item")

#: A stamp counts as being on the computer's clock if it is at most this much later or earlier than the arrival.
_LATEST_S: Final = 0.05
_EARLIEST_S: Final = 1.0
#: Successive images with other stamps after which images are placed by their arrival. A computer that stops for a
#: second delivers fewer.
ODD_STAMPS: Final = 45


@dataclass(frozen=True)
class Timed(Generic[Item]):
    """An item that was taken at ``time_s`` and arrived at ``arrival_s``."""

    time_s: float
    arrival_s: float
    item: Item


@dataclass
class Pairer(Generic[First, Second]):
    """Pairs the images of two streams that are nearest in time and at most half a period apart.

    Each stream must be in time order, with at least half a period between its images.

    Attributes
    ----------
    period_s : float
        Time between two images of a stream.
    patience_s : float
        Longest wait for a partner.
    unmatched : int
        Images without a partner.
    second_is_optional : bool
        Whether an image of the first stream without a partner is passed on alone.
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
        """Return the pairs that no later image can change, in time order."""
        half_s = 0.5 * self.period_s * (1 + 1e-6)  # stamps are sums of decimal fractions
        # A stream's oldest image goes if the other's oldest is much later, or nearer to this stream's next one.
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
        """Drop the waiting images."""
        self._first.clear()
        self._second.clear()

    @staticmethod
    def _has_nearer_next(stream: list[Timed[First]] | list[Timed[Second]], time_s: float, apart_s: float) -> bool:
        return len(stream) > 1 and abs(stream[1].time_s - time_s) < abs(apart_s)

    def _may_have_nearer_to_come(self, apart_s: float, now_s: float) -> bool:
        """Return whether the next image of the earlier stream, not received yet, may be nearer to the later image."""
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


#: Longest queue of frames: two seconds, because a busy computer can delay the reader.
_MAX_WAITING: Final = 60
#: How long an image waits for the other camera, which may deliver late.
_PATIENCE_S: Final = 1.0
#: How long a tactile depth image waits for its colour image; without one it is used alone.
_COLOR_PATIENCE_S: Final = 0.25


@dataclass(frozen=True, eq=False)
class ImageSet:
    """Depth and colour of one camera; colour may be missing."""

    depth: AnyArray
    color: AnyArray | None


@dataclass(frozen=True, eq=False)
class Pair:
    """Simultaneous images of both cameras, and their times in seconds on the computer's clock."""

    proximity: ImageSet
    tactile: ImageSet
    proximity_time_s: float
    tactile_time_s: float


class Assembler:
    """Pairs depth with colour within each camera, then the cameras; any thread may call it.

    Images are placed by their stamps. Where those of one camera are not on the computer's clock, the images of both are
    placed by their arrival, because what the cameras need to deliver an image must not come between them.

    Parameters
    ----------
    period_s : float
        Time between two images of a stream.
    tactile_delay_s : float
        Subtracted from the tactile camera's stamps.
    without_color : collection of {"proximity", "tactile"}
        Cameras that have no colour stream.
    """

    def __init__(self, period_s: float, tactile_delay_s: float, without_color: Collection[CameraRole] = ()) -> None:
        self._without_color = frozenset(without_color)
        self._delay_s = tactile_delay_s
        self._by_arrival = False
        self._odd_stamps: dict[tuple[CameraRole, Kind], int] = {}
        self._sets: dict[CameraRole, Pairer[AnyArray, AnyArray]] = {
            "proximity": Pairer(period_s, _PATIENCE_S),
            "tactile": Pairer(period_s, _COLOR_PATIENCE_S, second_is_optional=True),
        }
        self._pairs: Pairer[ImageSet, ImageSet] = Pairer(period_s, _PATIENCE_S + abs(tactile_delay_s))
        self._ready: deque[Pair] = deque()
        self._changed = Condition()
        self._closed = False
        self.dropped = 0

    @property
    def unmatched(self) -> int:
        """Depth images of either camera without a partner."""
        return self._pairs.unmatched + self._sets["proximity"].unmatched

    def add(self, role: CameraRole, image: Image, arrival_s: float) -> bool:
        """Add an image; return whether from now on images are placed by their arrival."""
        with self._changed:
            had_stamps = not self._by_arrival
            self._check_stamp(role, image, arrival_s)
            timed = Timed(arrival_s if self._by_arrival else image.stamp_s, arrival_s, image.pixels)
            if role in self._without_color:
                self._add_set(role, timed, None)
            else:
                (self._sets[role].add_first if image.kind == "depth" else self._sets[role].add_second)(timed)
            self._advance(arrival_s)
            return had_stamps and self._by_arrival

    def restart(self, role: CameraRole) -> None:
        """Forget a camera's waiting images, because it was opened again."""
        with self._changed:
            self._sets[role].clear()

    def wait(self, timeout_s: float | None) -> bool:
        """Wait for a pair, at most ``timeout_s``; return whether there is one, or the assembler is closed."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._ready) or self._closed, timeout_s)

    def take(self) -> Pair | None:
        """Return the next pair, if there is one."""
        with self._changed:
            return self._ready.popleft() if self._ready else None

    def close(self) -> None:
        """Drop the pairs and wake whoever waits."""
        with self._changed:
            self._closed = True
            self._ready.clear()
            self._changed.notify_all()

    @property
    def closed(self) -> bool:
        """Whether `close` has been called."""
        return self._closed

    def _check_stamp(self, role: CameraRole, image: Image, arrival_s: float) -> None:
        is_first = (role, image.kind) not in self._odd_stamps
        is_odd = not (image.on_host_clock and -_LATEST_S < arrival_s - image.stamp_s < _EARLIEST_S)
        odd = self._odd_stamps.get((role, image.kind), 0) + 1 if is_odd else 0
        self._odd_stamps[role, image.kind] = odd
        if not self._by_arrival and ((is_odd and is_first) or odd >= ODD_STAMPS):
            self._by_arrival = True
            self._pairs.clear()

    def _advance(self, now_s: float) -> None:
        for role, pairer in self._sets.items():
            for depth, color in pairer.take(now_s):
                self._add_set(role, depth, None if color is None else color.item)
        for proximity, tactile in self._pairs.take(now_s):
            if tactile is not None:
                self._ready.append(Pair(proximity.item, tactile.item, proximity.time_s, tactile.time_s))
                if len(self._ready) > _MAX_WAITING:
                    self._ready.popleft()
                    self.dropped += 1
                self._changed.notify_all()

    def _add_set(self, role: CameraRole, depth: Timed[AnyArray], color: AnyArray | None) -> None:
        time_s = depth.time_s - (self._delay_s if role == "tactile" else 0.0)
        timed = Timed(time_s, depth.arrival_s, ImageSet(depth.item, color))
        (self._pairs.add_first if role == "proximity" else self._pairs.add_second)(timed)
