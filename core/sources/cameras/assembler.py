"""Images of both cameras become frames: placed on one clock, paired, and queued until they are read.

`StreamClock` places one stream's stamps on the computer's clock, `Pairer` finds images that belong together, and
`Assembler` uses both for all streams of a rig.
"""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field
from threading import Condition
from typing import Final, Generic, TypeVar

from ...errors import minus
from ...model.arrays import AnyArray
from ..base import CameraRole
from .camera import Image, Kind

First = TypeVar("First")
Second = TypeVar("Second")
Item = TypeVar("Item")

#: Images placed by their arrival after a jump, until the new offset is trusted.
SETTLING: Final = 30
#: A stamp counts as being on the computer's clock if it is at most this much later or earlier than the arrival.
_LATEST_S: Final = 0.05
_EARLIEST_S: Final = 1.0
#: Largest growth of the usual delay from image to image.
_RISE_S: Final = 2e-4


class StreamClock:
    """Converts the stamps of one stream to the computer's clock.

    A stamp on the computer's clock is kept. The camera's clock has jumped where the stamps and the image numbers
    advance differently and the arrivals do not confirm the stamps; when a camera pauses, the arrivals pause as
    well. After a jump, stamps are shifted so that the smallest delay from stamp to arrival is the usual one again.

    Parameters
    ----------
    period_s : float
        Time between two images.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._delays_s: deque[float] = deque(maxlen=SETTLING)
        self._shift_s = 0.0
        self._settling = 0
        self._last: tuple[int, float, float] | None = None
        self._usual_delay_s = 0.0
        self.is_shared = True
        self.jumped_by_s = 0.0

    @property
    def settling(self) -> bool:
        """Whether images are being placed by their arrival because the clock has jumped."""
        return self._settling > 0

    @property
    def usual_delay_s(self) -> float:
        """The smallest delay from stamp to arrival before a jump; 0 where only arrivals are known."""
        return self._usual_delay_s

    def place(self, number: int, stamp_s: float, arrival_s: float, *, on_host_clock: bool) -> float:
        """Return when an image was taken, in seconds on the computer's clock.

        Parameters
        ----------
        number : int
            The camera's number of the image; lost images leave gaps.
        stamp_s, arrival_s : float
            The camera's stamp, and when the image reached us, both in seconds.
        on_host_clock : bool
            Whether the driver says that the stamp counts on the computer's clock.
        """
        delay_s = arrival_s - stamp_s
        if self._last is None:
            self._start(delay_s, on_host_clock)
        elif self._has_jumped(number - self._last[0], stamp_s - self._last[1], arrival_s - self._last[2]):
            self.jumped_by_s = self._usual_delay_s - (delay_s - self._shift_s)
            self._delays_s.clear()
            self._settling = SETTLING
        self._last = number, stamp_s, arrival_s
        self._delays_s.append(delay_s)
        self._update_shift()
        return stamp_s + self._shift_s

    def restart(self) -> None:
        """Forget the stamps so far: the camera was opened again, and its clock may have restarted."""
        self._last = None

    def _start(self, delay_s: float, on_host_clock: bool) -> None:
        self.is_shared = on_host_clock and -_LATEST_S < delay_s < _EARLIEST_S
        self._delays_s.clear()
        self._settling = 0
        self._shift_s = 0.0
        self._usual_delay_s = delay_s if self.is_shared else 0.0

    def _has_jumped(self, images: int, step_s: float, arrival_step_s: float) -> bool:
        half_s = 0.5 * self._period_s
        too_far_s = step_s - max(images, 1) * self._period_s
        return too_far_s < -half_s or (too_far_s > half_s and step_s - arrival_step_s > half_s)

    def _update_shift(self) -> None:
        least_s = min(self._delays_s)
        if not self.is_shared:  # two quartz clocks drift apart, so the shift is updated with every image
            self._shift_s = least_s
        elif self._settling:
            self._settling -= 1
            self._shift_s = least_s - self._usual_delay_s
            if not self._settling and abs(self._shift_s) < 0.25 * self._period_s:
                self._shift_s = 0.0  # the clock has jumped back to its former offset
        else:
            # Falls at once but rises slowly, because a series of late images gives no information on the clock.
            self._usual_delay_s = min(self._delays_s[-1] - self._shift_s, self._usual_delay_s + _RISE_S)


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
_STREAMS: Final[tuple[tuple[CameraRole, Kind], ...]] = tuple(
    (role, kind) for role in ("proximity", "tactile") for kind in ("depth", "color")
)


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
        self._clocks = {stream: StreamClock(period_s) for stream in _STREAMS}
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

    def add(self, role: CameraRole, image: Image, arrival_s: float) -> str:
        """Add an image; return a clause about the camera's clock where it has jumped, else an empty string."""
        with self._changed:
            clock = self._clocks[role, image.kind]
            had_settled = not clock.settling
            time_s = clock.place(image.number, image.stamp_s, arrival_s, on_host_clock=image.on_host_clock)
            timed = Timed(time_s, arrival_s, image.pixels)
            if role in self._without_color:
                self._add_set(role, timed, None)
            else:
                (self._sets[role].add_first if image.kind == "depth" else self._sets[role].add_second)(timed)
            self._advance(arrival_s)
            if had_settled and clock.settling and image.kind == "depth":
                return f"clock jumped by {minus(f'{clock.jumped_by_s:+.1f}')} s; its images are timed by their arrival."
            return ""

    def restart(self, role: CameraRole) -> None:
        """Forget a camera's clock and its waiting images, because it was opened again."""
        with self._changed:
            self._sets[role].clear()
            for kind in ("depth", "color"):
                self._clocks[role, kind].restart()

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

    def _advance(self, now_s: float) -> None:
        for role, pairer in self._sets.items():
            for depth, color in pairer.take(now_s):
                self._add_set(role, depth, None if color is None else color.item)
        for proximity, tactile in self._pairs.take(now_s):
            if tactile is not None:
                self._put(Pair(proximity.item, tactile.item, proximity.time_s, tactile.time_s))

    def _add_set(self, role: CameraRole, depth: Timed[AnyArray], color: AnyArray | None) -> None:
        time_s = depth.time_s - (self._delay_s if role == "tactile" else 0.0)
        timed = Timed(time_s + self._transport_s(role), depth.arrival_s, ImageSet(depth.item, color))
        (self._pairs.add_first if role == "proximity" else self._pairs.add_second)(timed)

    def _transport_s(self, role: CameraRole) -> float:
        """Return the delay to add to a camera's times: with arrival times of one camera, both must be arrival times."""
        if all(self._clocks[each, "depth"].is_shared for each in ("proximity", "tactile")):
            return 0.0
        return self._clocks[role, "depth"].usual_delay_s

    def _put(self, pair: Pair) -> None:
        self._ready.append(pair)
        if len(self._ready) > _MAX_WAITING:
            self._ready.popleft()
            self.dropped += 1
        self._changed.notify_all()
