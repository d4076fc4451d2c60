"""Images of both cameras become frames: placed on one clock, paired, kept until they are asked for."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from threading import Condition
from typing import Final

from ...model.arrays import AnyArray
from ..base import CameraRole
from .clock import StreamClock
from .pairing import Pairer, Timed
from .session import Image, Kind

#: Frames that wait for whoever reads them: two seconds, in case that the reader has to wait for the computer.
_WAITING: Final = 60
#: A camera that stutters delivers late; its partner's images wait for it.
_PATIENCE_S: Final = 1.0
#: A tactile image without its colour image is worth having, but not worth a long wait.
_COLOR_PATIENCE_S: Final = 0.25
_STREAMS: Final[tuple[tuple[CameraRole, Kind], ...]] = tuple(
    (role, kind) for role in ("proximity", "tactile") for kind in ("depth", "color")
)


@dataclass(frozen=True, eq=False)
class ImageSet:
    """Depth and colour of one camera; colour may lack."""

    depth: AnyArray
    color: AnyArray | None


@dataclass(frozen=True, eq=False)
class Pair:
    """What both cameras saw at one moment, with when each saw it, in seconds on one clock."""

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
        Taken off the tactile camera's stamps.
    """

    def __init__(self, period_s: float, tactile_delay_s: float) -> None:
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
        """Take an image in; return what is to be told about the camera's clock, if anything."""
        with self._changed:
            clock = self._clocks[role, image.kind]
            had_settled = not clock.settling
            time_s = clock.place(image.number, image.stamp_s, arrival_s, on_host_clock=image.on_host_clock)
            timed = Timed(time_s, arrival_s, image.pixels)
            (self._sets[role].add_first if image.kind == "depth" else self._sets[role].add_second)(timed)
            self._advance(arrival_s)
            if had_settled and clock.settling and image.kind == "depth":
                return f"clock jumped by {clock.jumped_by_s:+.1f} s; its images are placed by their arrival."
            return ""

    def restart(self, role: CameraRole) -> None:
        """A camera has been opened anew: its clock and what waits of it count no more."""
        with self._changed:
            self._sets[role].clear()
            for kind in ("depth", "color"):
                self._clocks[role, kind].restart()

    def wait(self, timeout_s: float | None) -> bool:
        """Wait for a pair, at most so long; also returns True once all is closed."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._ready) or self._closed, timeout_s)

    def take(self) -> Pair | None:
        """Return the next pair, if there is one."""
        with self._changed:
            return self._ready.popleft() if self._ready else None

    def close(self) -> None:
        """Let go of everyone who waits."""
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
                images = ImageSet(depth.item, color.item if color is not None else None)
                time_s = depth.time_s - (self._delay_s if role == "tactile" else 0.0)
                timed = Timed(time_s + self._transport_s(role), depth.arrival_s, images)
                (self._pairs.add_first if role == "proximity" else self._pairs.add_second)(timed)
        for proximity, tactile in self._pairs.take(now_s):
            if tactile is not None:
                self._put(Pair(proximity.item, tactile.item, proximity.time_s, tactile.time_s))

    def _transport_s(self, role: CameraRole) -> float:
        """Return what makes the times of both cameras comparable: where one knows arrivals only, both go by them."""
        if all(self._clocks[each, "depth"].is_shared for each in ("proximity", "tactile")):
            return 0.0
        return self._clocks[role, "depth"].usual_delay_s

    def _put(self, pair: Pair) -> None:
        self._ready.append(pair)
        if len(self._ready) > _WAITING:
            self._ready.popleft()
            self.dropped += 1
        self._changed.notify_all()
