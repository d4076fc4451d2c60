"""A source that is opened in a separate process."""

from __future__ import annotations

import weakref

from ...model.frames import Rig, SensorFrame
from ..base import CameraOption, CameraRole, FrameSource, Health, Progress
from .protocol import Opener, Start
from .supervisor import Supervisor


class ProcessSource(FrameSource):
    """A live source in a separate process.

    Frames come through shared memory, copied once. A capture process that dies, hangs or fails is
    restarted. Meanwhile `health` states the cause and marks the last frame as stale, and `wait` returns
    False. Sequence numbers and times keep increasing. Frames that are not fetched in time are dropped,
    the oldest first, and counted in `health`. All methods may be called from any thread.

    Parameters
    ----------
    opener : callable
        Opens the source in the capture process; its argument is a progress callable. It is pickled, so it
        must be a function of a module (not of the main script or a notebook), or `functools.partial` of one.
    progress : callable, optional
        Called in this thread with the fraction done, 0 to 1, and the current step. If it raises an
        exception, opening is cancelled.
    lossless : bool
        If True, no frame is dropped: the capture process waits for the caller, and after a failure
        `next_frame` raises an error instead of continuing with missing frames.

    Raises
    ------
    TactuneError
        The source cannot be opened; class and message are the same as without the process.
    SourceError
        The opener cannot be sent to another process, or the process ends or hangs while opening.
    """

    def __init__(self, opener: Opener, progress: Progress | None = None, *, lossless: bool = False) -> None:
        self._supervisor = Supervisor(Start(opener, lossless))
        # Also called at exit, and when an unclosed source is garbage collected.
        self._close = weakref.finalize(self, self._supervisor.stop)
        try:
            opened = self._supervisor.wait_until_open(progress)
        except BaseException:
            self._close()
            raise
        self.name = opened.name
        self._rig = opened.rig
        self._frame_rate_hz = opened.frame_rate_hz

    @property
    def rig(self) -> Rig:
        """The rig that takes the frames."""
        return self._rig

    @property
    def frame_rate_hz(self) -> float:
        """The rate at which frames are taken, in Hz."""
        return self._frame_rate_hz

    @property
    def capture_pid(self) -> int | None:
        """Process number of the capture process; None while it is not running."""
        return self._supervisor.pid

    def next_frame(self) -> SensorFrame | None:
        """Return the next frame, or None at the end; block until there is one.

        Raises
        ------
        TactuneError
            The source cannot continue: the rig has changed after a restart, the source is closed, or it is lossless
            and has failed.
        """
        return self._supervisor.next_frame()

    def wait(self, timeout_s: float) -> bool:
        """Wait until `next_frame` will not block, at most ``timeout_s``; return whether it will not."""
        return self._supervisor.wait(timeout_s)

    def health(self) -> Health:
        """Return the health of the source and of its process."""
        return self._supervisor.health()

    def options(self) -> tuple[CameraOption, ...]:
        """Return the settings of the cameras.

        Raises
        ------
        SourceError
            The capture process does not answer in time.
        """
        options: tuple[CameraOption, ...] = self._supervisor.call("options")
        return options

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        """Change one setting of a camera; it is kept when the capture process is restarted.

        Raises
        ------
        SourceError
            The source has no such camera or setting, the camera refuses the value, or the capture
            process does not answer in time.
        """
        self._supervisor.call("set_option", camera, name, value)
        self._supervisor.remember_option(camera, name, value)

    def untouched(self) -> SensorFrame | None:
        """Return a frame of the untouched membrane, or None if the source has none.

        Raises
        ------
        SourceError
            The capture process does not answer in time, or the frame cannot be read.
        """
        untouched: SensorFrame | None = self._supervisor.call("untouched")
        return untouched

    def close(self) -> None:
        """End the capture process. Closing twice is harmless."""
        self._close()
