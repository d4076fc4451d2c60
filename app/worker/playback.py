"""When the next frame is due, and which one it is; plain arithmetic without threads or clocks."""

from __future__ import annotations

from dataclasses import dataclass

SPEEDS = (0.25, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class PlaybackState:
    """What the controls show.

    ``index`` is the frame shown last (-1: none yet); ``length`` is None for a live source.
    """

    index: int = -1
    length: int | None = None
    playing: bool = False
    loop: bool = True
    frozen: bool = False
    speed: float = 1.0

    @property
    def running(self) -> bool:
        """Whether another frame will follow by itself."""
        return self.playing and not self.frozen

    @property
    def seekable(self) -> bool:
        """Whether one can step and seek."""
        return self.length is not None

    @property
    def at_end(self) -> bool:
        """Whether the last frame of a recording has been shown."""
        return self.length is not None and self.index >= self.length - 1


class Playback:
    """Paces a source at its own frame rate times a speed factor.

    A recording is never skipped through: where a frame takes longer than its period, the recording
    plays slower, and after a hold-up it does not race to catch up. Live sources pace themselves: of
    them only whether they run is kept here.
    """

    def __init__(self) -> None:
        self.index = -1
        self.length: int | None = None
        self.loop = True
        self.frozen = False
        self.playing = False
        self.held = False
        self.speed = 1.0
        self._frame_rate_hz = 30.0
        self._due_s = 0.0

    @property
    def state(self) -> PlaybackState:
        """A snapshot for the controls."""
        return PlaybackState(self.index, self.length, self.playing, self.loop, self.frozen, self.speed)

    @property
    def period_s(self) -> float:
        """Seconds from one frame to the next."""
        return 1.0 / (self._frame_rate_hz * self.speed)

    def start_source(self, length: int | None, frame_rate_hz: float) -> None:
        """Begin with a source that has just been opened, before its first frame."""
        self.index = -1
        self.length = length
        self._frame_rate_hz = max(frame_rate_hz, 1e-3)
        self.frozen = False
        self.playing = length != 1
        self._due_s = 0.0

    def play(self) -> None:
        """Play on; at the end of a recording, from its beginning."""
        if self.length == 1:
            return
        if not self.loop and self.state.at_end:
            self.index = -1
        self.playing = True
        self.frozen = False

    def pause(self) -> None:
        """Stay at the present frame."""
        self.playing = False

    def wait_s(self, now_s: float) -> float | None:
        """Seconds until the next frame of a recording is due (0: now); None while nothing is to be played."""
        if self.length is None or not self.playing or self.frozen or self.held:
            return None
        return max(0.0, self._due_s - now_s)

    def following_index(self) -> int | None:
        """Index of the frame of a recording that comes next, or None at the end."""
        following = self.index + 1
        if self.length is not None and following < self.length:
            return following
        return 0 if self.loop else None

    def next_index(self) -> int | None:
        """Index of the frame to play next, or None at the end (which also pauses)."""
        following = self.following_index()
        self.playing = following is not None
        return following

    def step_index(self, by: int) -> int | None:
        """Index of the frame ``by`` steps away, or None where there is none."""
        if self.length is None:
            return None
        target = self.index + by
        if self.loop:
            return target % self.length
        return target if 0 <= target < self.length else None

    def shown(self, index: int, now_s: float) -> None:
        """Note that a frame was taken at this moment and when the next one is due."""
        self.index = index
        if now_s - self._due_s > self.period_s:
            self._due_s = now_s
        self._due_s += self.period_s
