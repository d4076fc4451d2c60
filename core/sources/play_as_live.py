"""Plays a recording as if it were live: over and over, at its own frame rate."""

from __future__ import annotations

import time
from dataclasses import replace

from ..errors import SourceError
from ..model.frames import SensorFrame
from .base import FrameSource, Health


class PlayAsLive(FrameSource):
    """A recording without a length: each frame comes when it is due, and is stamped with that time.

    The n-th frame is due n periods after the first, by the clock, so nothing drifts. A frame that
    cannot be read in time is skipped and counted as dropped, as with a camera.
    """

    def __init__(self, source: FrameSource) -> None:
        if source.length is None:
            raise SourceError(f"live:{source.name}: {source.name} is live already; leave out live:")
        if source.length == 0:
            raise SourceError(f"live:{source.name}: there are no frames to play; choose another recording")
        self.name = f"live:{source.name}"
        self.rig, self.frame_rate_hz = source.rig, source.frame_rate_hz
        self._source = source
        self._length = source.length
        self._period_s = 1.0 / source.frame_rate_hz
        self._began_s: float | None = None
        self._count = 0
        self._dropped = 0
        self._next: SensorFrame | None = None

    def next_frame(self) -> SensorFrame:
        frame = self._prepare()
        time.sleep(max(0.0, self._due_in_s()))
        self._next = None
        self._count += 1
        return frame

    def wait(self, timeout_s: float) -> bool:
        self._prepare()
        due_in_s = self._due_in_s()
        time.sleep(max(0.0, min(due_in_s, timeout_s)))
        return due_in_s <= timeout_s

    def untouched(self) -> SensorFrame | None:
        return self._source.untouched()

    def health(self) -> Health:
        health = self._source.health()
        return replace(health, dropped=health.dropped + self._dropped)

    def close(self) -> None:
        self._source.close()

    def _due_in_s(self) -> float:
        if self._began_s is None:
            self._began_s = time.monotonic()
        return self._began_s + self._count * self._period_s - time.monotonic()

    def _prepare(self) -> SensorFrame:
        """Read the next frame before it is due; drop frames whose time has passed."""
        if self._next is not None:
            return self._next
        late = max(0, int(-self._due_in_s() / self._period_s)) if self._count else 0
        self._count += late
        self._dropped += late
        index = self._count % self._length
        if self._source.position != index:
            self._source.seek(index)
        frame = self._source.next_frame()
        if frame is None:
            raise SourceError(f"{self.name}: frame {index} is missing; record again")
        due_s = time.time() + self._due_in_s()
        self._next = replace(frame, sequence=self._count, proximity_time_s=due_s, tactile_time_s=due_s + frame.skew_s)
        return self._next
