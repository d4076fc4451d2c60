"""Playback: which frame is next and when it is due. Plain arithmetic without threads or clocks."""

from __future__ import annotations

from dataclasses import dataclass

SPEEDS = (0.25, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class PlaybackState:
    """The state that the playback controls show.

    ``index`` is the last frame shown (-1: none yet); ``length`` is None for a live source.
    """

    index: int = -1
    length: int | None = None
    playing: bool = False
    loop: bool = True

    @property
    def seekable(self) -> bool:
        return self.length is not None


class Playback:
    """Paces a recording at its frame rate times a speed factor.

    No frame is skipped: if processing takes longer than the frame period, the recording plays slower,
    and after a delay it does not catch up. A live source paces itself; only whether it runs is kept here.
    """

    def __init__(self) -> None:
        self.index = -1
        self.length: int | None = None
        self.loop = True
        self.playing = False
        self.held = False
        self.speed = 1.0
        self._frame_rate_hz = 30.0
        self._due_s = 0.0

    @property
    def state(self) -> PlaybackState:
        return PlaybackState(self.index, self.length, self.playing, self.loop)

    @property
    def period_s(self) -> float:
        return 1.0 / (self._frame_rate_hz * self.speed)

    def start_source(self, length: int | None, frame_rate_hz: float) -> None:
        self.index = -1
        self.length = length
        self._frame_rate_hz = max(frame_rate_hz, 1e-3)
        self.playing = length != 1
        self._due_s = 0.0

    def play(self) -> None:
        """Continue; at the end of a recording, start from its beginning."""
        if self.length == 1:
            return
        if self.length is not None and self.following_index() is None:
            self.index = -1
        self.playing = True

    def pause(self) -> None:
        self.playing = False

    def wait_s(self, now_s: float) -> float | None:
        """Seconds until the next frame of a recording is due (0: now); None while nothing plays."""
        if self.length is None or not self.playing or self.held:
            return None
        return max(0.0, self._due_s - now_s)

    def following_index(self) -> int | None:
        """Index of the next frame of a recording; None at the end."""
        following = self.index + 1
        if self.length is not None and following < self.length:
            return following
        return 0 if self.loop else None

    def next_index(self) -> int | None:
        """Index of the frame to play next; None at the end, which also pauses."""
        following = self.following_index()
        self.playing = following is not None
        return following

    def step_index(self, by: int) -> int | None:
        if self.length is None:
            return None
        target = self.index + by
        if self.loop:
            return target % self.length
        return target if 0 <= target < self.length else None

    def shown(self, index: int, now_s: float) -> None:
        """Note that a frame was read at ``now_s``, and when the next one is due."""
        self.index = index
        if now_s - self._due_s > self.period_s:
            self._due_s = now_s
        self._due_s += self.period_s
