"""What the two processes tell each other; plain values that travel as pickles over a socket pair."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ... import errors
from ...errors import SourceError, TactuneError
from ...model.arrays import AnyArray
from ...model.frames import GroundTruth, Rig, SensorFrame
from ..base import FrameSource, Health, Progress
from .ring import ArrayPlace

#: Opens a source in the capture process; a function of a module, or `functools.partial` of one.
Opener = Callable[[Progress], FrameSource]

#: More than the frames that wait, so that one can be written and another copied meanwhile.
SLOTS = 8

#: The capture process gives a sign of life so often, seconds.
HEARTBEAT_S = 0.2


@dataclass(frozen=True)
class Start:
    """To the capture process, first: what to open, and whether to wait rather than to lose a frame."""

    opener: Opener
    lossless: bool


@dataclass(frozen=True)
class GiveBack:
    """To the capture process: this slot has been copied."""

    slot: int


@dataclass(frozen=True)
class Call:
    """To the capture process: call this method of the source and reply."""

    number: int
    method: str
    arguments: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Opening:
    """From the capture process: how far it is with opening."""

    fraction: float
    text: str


@dataclass(frozen=True)
class Opened:
    """From the capture process: the source is open and the memory has its size."""

    name: str
    rig: Rig
    frame_rate_hz: float
    health: Health
    slot_bytes: int


@dataclass(frozen=True)
class FrameReady:
    """From the capture process: a slot holds a frame; ``dropped`` counts those that found no slot."""

    slot: int
    places: tuple[ArrayPlace, ...]
    sequence: int
    proximity_time_s: float
    tactile_time_s: float
    dropped: int


@dataclass(frozen=True)
class Heartbeat:
    """From the capture process, again and again: how the source is doing.

    ``busy_s`` tells for how long the source has been at one and the same call.
    """

    health: Health
    busy_s: float


@dataclass(frozen=True)
class Reply:
    """From the capture process: what a call returned, or how it failed."""

    number: int
    value: Any = None
    failure: Failure | None = None


@dataclass(frozen=True)
class Ended:
    """From the capture process, last: the source has no more frames."""


@dataclass(frozen=True)
class Failure:
    """From the capture process: an error; as a message of its own, the last one."""

    kind: str
    sentence: str

    @classmethod
    def of(cls, error: Exception, what: str) -> Failure:
        """Describe an error; where it is none of the tool's own, ``what`` says what went wrong."""
        if isinstance(error, TactuneError):
            return cls(type(error).__name__, str(error))
        return cls(SourceError.__name__, f"{what} ({type(error).__name__}: {error})")

    def error(self) -> TactuneError:
        """Return the error as it was raised, of the same class."""
        kind = getattr(errors, self.kind, SourceError)
        made: TactuneError = kind(self.sentence)
        return made


def arrays_of(frame: SensorFrame) -> dict[str, AnyArray]:
    """Return the arrays of a frame by name, those of its truth behind a dot."""
    arrays: dict[str, AnyArray | None] = {
        "proximity_depth": frame.proximity_depth,
        "tactile_depth": frame.tactile_depth,
        "proximity_color": frame.proximity_color,
        "tactile_color": frame.tactile_color,
    }
    if frame.truth is not None:
        arrays |= {"truth.contact": frame.truth.contact, "truth.depth_m": frame.truth.depth_m}
    return {name: array for name, array in arrays.items() if array is not None}


def frame_of(ready: FrameReady, arrays: dict[str, AnyArray]) -> SensorFrame:
    """Put a frame together again; the inverse of `arrays_of`."""
    truth = None
    if "truth.contact" in arrays:
        for name in ("truth.contact", "truth.depth_m"):
            if name in arrays:
                arrays[name].flags.writeable = False
        truth = GroundTruth(arrays["truth.contact"], arrays.get("truth.depth_m"))
    return SensorFrame(
        sequence=ready.sequence,
        proximity_depth=arrays["proximity_depth"],
        tactile_depth=arrays["tactile_depth"],
        proximity_color=arrays["proximity_color"],
        tactile_color=arrays.get("tactile_color"),
        proximity_time_s=ready.proximity_time_s,
        tactile_time_s=ready.tactile_time_s,
        truth=truth,
    )
