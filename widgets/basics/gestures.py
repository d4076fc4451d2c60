"""Numbers of gestures: all edits of one drag, or of one burst of keys, share a number."""

from __future__ import annotations

import itertools
import time

_numbers = itertools.count(1)

#: Key presses or wheel steps within this time of each other belong to one gesture, seconds.
BURST_S = 0.8


def new_gesture() -> int:
    """Return a number that is unique in this process; never 0."""
    return next(_numbers)


class GestureClock:
    """Assigns edits of a widget to gestures."""

    def __init__(self) -> None:
        self.held = False  # a mouse button is down
        self._number = 0
        self._last_s = 0.0

    def hold(self) -> None:
        self._number = new_gesture()
        self.held = True

    def release(self) -> None:
        """End the drag, or the burst of keys; the next edit is another gesture."""
        self.held = False
        self._number = 0

    def number(self) -> int:
        now_s = time.monotonic()
        if not self.held and (self._number == 0 or now_s - self._last_s > BURST_S):
            self._number = new_gesture()
        self._last_s = now_s
        return self._number
