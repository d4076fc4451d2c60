"""What the supervisor of a capture process knows about time: how long to wait, and how frames go on."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Final

from ...errors import SourceError
from ...model.frames import DepthCamera, Rig
from ..base import Health
from .messages import FrameReady, Heartbeat, Opened

#: The supervisor looks after its process so often, seconds.
POLL_S: Final = 0.1
#: So long without a sign of life, and the process hangs, seconds: while it opens the source, when a driver may hold
#: the interpreter; while a camera comes and goes; and else.
_SILENT_OPENING_S: Final = 20.0
_SILENT_TROUBLE_S: Final = 5.0
_SILENT_S: Final = 1.0
#: So long at one call of the source, and it hangs, seconds: opening without progress, the first frame, and later.
_BUSY_OPENING_S: Final = 120.0
_BUSY_FIRST_FRAME_S: Final = 20.0
_BUSY_S: Final = 1.5
#: A wait of `POLL_S` that takes so long tells that the machine is too busy to judge, seconds.
_LATE_S: Final = 0.25
#: The pauses before the first, second and further attempts to start a process again, seconds.
_PAUSES_S: Final = (0.0, 0.2, 0.5, 1.0, 2.0)
#: What is to be said of each camera meanwhile.
_RESTARTING: Final = "The capture process is being restarted."
#: A process that has captured so long has recovered, seconds.
_RECOVERED_S: Final = 5.0


class Patience:
    """Tells when a process hangs.

    Silence is counted in waits that brought nothing, not by the clock: a parent that was stopped
    itself finds the signs of life that have queued up meanwhile. Waits that took far too long count
    for nothing either: a machine that is so busy stops both processes.
    """

    def __init__(self) -> None:
        self._silent = 0
        self._busy_s = 0.0
        self._silent_limit_s = _SILENT_OPENING_S
        self._busy_limit_s = _BUSY_OPENING_S

    def heard(self, message: object) -> None:
        """Note a message from the process."""
        self._silent = 0
        if isinstance(message, Opened | FrameReady):
            self._busy_s = 0.0  # it took long, but it has come back
        if isinstance(message, Opened):
            self._silent_limit_s, self._busy_limit_s = _SILENT_S, _BUSY_FIRST_FRAME_S
        elif isinstance(message, FrameReady):
            self._busy_limit_s = min(self._busy_limit_s, _BUSY_S)
        elif isinstance(message, Heartbeat):
            self._busy_s = message.busy_s
            if message.health.cameras:  # so the source is open
                well = all(camera.state == "streaming" for camera in message.health.cameras)
                self._silent_limit_s = _SILENT_S if well else _SILENT_TROUBLE_S

    def silent(self, waited_s: float) -> None:
        """Note a wait of `POLL_S` that brought nothing, and how long it really took."""
        if waited_s < _LATE_S:
            self._silent += 1

    @property
    def problem(self) -> str:
        """Why the process counts as hanging, in words; empty while it does not."""
        silent_s = self._silent * POLL_S
        if silent_s >= self._silent_limit_s:
            return f"has given no sign of life for {silent_s:.0f} s"
        if self._busy_s >= self._busy_limit_s:
            return f"has waited {self._busy_s:.1f} s for its source"
        return ""


class Pauses:
    """How long to wait before the next attempt; each in vain makes the next wait longer."""

    def __init__(self) -> None:
        self._failures = 0

    def next_s(self, captured_s: float) -> float:
        """Return the pause after a process that captured for so long."""
        self._failures = 0 if captured_s >= _RECOVERED_S else self._failures
        pause_s = _PAUSES_S[min(self._failures, len(_PAUSES_S) - 1)]
        self._failures += 1
        return pause_s


@dataclass
class Numbering:
    """Makes sequence numbers and times go on rising where a new process would start over."""

    _sequence_shift: int = 0
    _time_shift_s: float = 0.0
    _last_sequence: int | None = None
    _last_time_s: float = 0.0
    _last_clock_s: float = 0.0
    _restarted: bool = False

    def restart(self) -> None:
        """The next frame comes from another process."""
        self._restarted = self._last_sequence is not None

    def apply(self, ready: FrameReady) -> FrameReady:
        """Return the frame with the numbers and times that it goes out with."""
        clock_s = time.monotonic()
        if self._restarted and self._last_sequence is not None:
            self._restarted = False
            self._sequence_shift = self._last_sequence + 1 - ready.sequence
            going_on_s = self._last_time_s + clock_s - self._last_clock_s
            starts_over = ready.proximity_time_s <= self._last_time_s
            self._time_shift_s = going_on_s - ready.proximity_time_s if starts_over else 0.0
        shifted = replace(
            ready,
            sequence=ready.sequence + self._sequence_shift,
            proximity_time_s=ready.proximity_time_s + self._time_shift_s,
            tactile_time_s=ready.tactile_time_s + self._time_shift_s,
        )
        self._last_sequence, self._last_time_s, self._last_clock_s = (
            shifted.sequence,
            shifted.proximity_time_s,
            clock_s,
        )
        return shifted


@dataclass
class HealthRecord:
    """How the source is doing over the lives of several processes."""

    _now: Health = field(default_factory=Health)
    _lost: int = 0
    _no_slot: int = 0
    _unmatched: int = 0
    dropped_here: int = 0

    def heard(self, message: object) -> None:
        """Note what a message says of the source."""
        if isinstance(message, Opened | Heartbeat):
            self._now = message.health
        elif isinstance(message, FrameReady):
            self._no_slot = message.dropped

    def restart(self) -> None:
        """Keep the counts; the cameras' last states are those of a process that is no more."""
        now = self._now
        self._lost += now.dropped + self._no_slot
        self._unmatched += now.unmatched
        self._no_slot = 0
        cameras = tuple(replace(camera, state="stalled", message=_RESTARTING) for camera in now.cameras)
        self._now = Health(cameras=cameras)

    def health(self, notice: str, *, stale: bool) -> Health:
        """Return the health with what the supervisor has to say; ``stale``: no frame since a restart."""
        now = self._now
        return replace(
            now,
            ok=now.ok and not stale,
            message=" ".join(filter(None, (notice, now.message))),
            dropped=self._lost + self._no_slot + self.dropped_here + now.dropped,
            stale=now.stale or stale,
            unmatched=self._unmatched + now.unmatched,
        )


def check_same_rig(name: str, before: Rig, now: Rig) -> None:
    """Raise `SourceError` where frames of the rig now are not frames of the rig before."""
    for role, old, new in (
        ("proximity", before.proximity, now.proximity),
        ("tactile", before.tactile, now.tactile),
    ):
        if old.intrinsics.shape != new.intrinsics.shape:
            raise SourceError(
                f"{name}: after a restart the {role} camera gives {_size(new)} pixels instead of {_size(old)}; "
                "open the source again"
            )
        if old.serial != new.serial or old.depth_unit_m != new.depth_unit_m:
            raise SourceError(
                f"{name}: after a restart the {role} camera is {_name(new)} instead of {_name(old)}; "
                "open the source again"
            )
    if before.proximity_color_shape != now.proximity_color_shape:
        (old_v, old_u), (new_v, new_u) = before.proximity_color_shape, now.proximity_color_shape
        raise SourceError(
            f"{name}: after a restart the proximity colour image is {new_u} x {new_v} pixels instead of "
            f"{old_u} x {old_v}; open the source again"
        )


def _size(camera: DepthCamera) -> str:
    return f"{camera.intrinsics.width} x {camera.intrinsics.height}"


def _name(camera: DepthCamera) -> str:
    return f"{camera.model} {camera.serial} with a depth unit of {camera.depth_unit_m:g} m"
