"""The interface of every source of frames."""

from __future__ import annotations

import itertools
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from ..errors import ExportError, SourceError
from ..model.arrays import Float64Array
from ..model.files import Closing, recording_files, user_path
from ..model.frames import Rig, SensorFrame

if TYPE_CHECKING:
    from ..preset import CamerasSection, Preset

#: Called with the fraction done of a long task, 0 to 1, and the current step.
Progress = Callable[[float, str], None]


def part_of(progress: Progress | None, number: int, count: int) -> Progress:
    """Return the progress of one of several equal parts of a task, counted from 0."""
    return lambda share, words: None if progress is None else progress((number + share) / count, words)


def frames_to_write(source: FrameSource, frames: int | None, progress: Progress | None) -> Iterator[SensorFrame]:
    """Yield at most ``frames`` of a source, from its present position; `ExportError` if there are none or no end."""
    left = None if source.length is None else source.length - source.position
    total = min((count for count in (left, frames) if count is not None), default=None)
    if total is None:
        raise ExportError(f"{source.name} is live and has no end; record it, or say how many frames to convert")
    count = 0
    for count, frame in enumerate(itertools.islice(source, total), start=1):
        yield frame
        if progress is not None:
            progress(count / total, f"frame {count} of {total}")
    if count == 0:
        raise ExportError(f"{source.name} has no frames left to export; seek to the first one")


def split_topics(name: str) -> tuple[str, str]:
    """Return the name of a recording and what follows it from ``?`` on, such as ``?proximity.depth=/a,...``, or ""."""
    match = re.search(r"\?(proximity|tactile)\.(depth|color|info)=", name)
    return (name, "") if match is None else (name[: match.start()], name[match.start() :])


#: Words in names of topics and files that tell a camera's role.
PROXIMITY_NAMES: Final = ("prox", "proximity", "l515", "tof", "lidar", "femto", "azure", "kinect")
TACTILE_NAMES: Final = ("tact", "tactile", "d405", "touch", "membrane", "bubble", "gel")
#: Which of the two depth cameras of a rig.
CameraRole = Literal["proximity", "tactile"]


@dataclass(frozen=True)
class CameraHealth:
    """State of one camera of a live source; ``message`` is a sentence for the user."""

    role: CameraRole
    state: Literal["streaming", "stalled", "missing"]
    model: str = ""
    serial: str = ""
    message: str = ""


@dataclass(frozen=True)
class Health:
    """State of a source; ``message`` can be shown unchanged and is empty where there is no problem.

    ``dropped`` counts frames lost before they were read, ``unmatched`` images without one of the other camera at the
    same time. ``stale``: the last frame does not show what the cameras see now.
    """

    ok: bool = True
    message: str = ""
    dropped: int = 0
    stale: bool = False
    cameras: tuple[CameraHealth, ...] = ()
    unmatched: int = 0


@dataclass(frozen=True)
class CameraOption:
    """One setting of a camera as the device reports it; values are numbers in ``unit``.

    ``choices`` names the values of a setting that is a list, such as a visual preset; ``name`` is
    the driver's own name and is what presets store.
    """

    camera: CameraRole
    name: str
    description: str
    minimum: float
    maximum: float
    step: float
    default: float
    value: float
    unit: str = ""
    choices: tuple[tuple[float, str], ...] = ()
    read_only: bool = False


class FrameSource(Closing, ABC):
    """A sequence of frames from one rig.

    A source with a ``length`` can ``seek``; a live one has ``length`` None. `next_frame` may block until the next
    frame arrives; it never paces a recording. Sources are context managers.
    """

    #: Name by which the source was opened, such as ``"sim:cup"`` or ``"folder:/data/scene"``.
    name: str
    #: The rig that took the frames.
    rig: Rig
    #: Number of frames, or None for a live source.
    length: int | None = None
    #: The rate at which frames were taken, in Hz.
    frame_rate_hz: float = 30.0
    #: Index of the frame that `next_frame` will return; a live source has none.
    position: int

    def times_s(self) -> Float64Array | None:
        """Return when each frame of a recording was taken, seconds from the first one; None where that is unknown."""
        return None

    @abstractmethod
    def next_frame(self) -> SensorFrame | None:
        """Return the next frame, or None at the end; `SourceError` if it cannot be read."""

    def wait(self, timeout_s: float) -> bool:
        """Wait until `next_frame` will not block; return False after the timeout. A recording is always ready."""
        return True

    def options(self) -> tuple[CameraOption, ...]:
        """Return the settings of the cameras; none for recordings."""
        return ()

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        """Change one setting of a camera; `SourceError` if there is no such one, or the camera refuses the value."""
        raise SourceError(f"{self.name}: there is no {camera} camera with an option {name!r}")

    def seek(self, index: int) -> None:
        """Make frame ``index`` (from 0) the next one; `SourceError` if the source is live or has no such frame."""
        raise SourceError(f"{self.name}: a live source cannot seek to frame {index}")

    def untouched(self) -> SensorFrame | None:
        """Return a frame of the untouched membrane, or None if the source has none."""
        return None

    def preset(self) -> Preset | None:
        """Return the preset that a recording holds, or None; `PresetError` if this version cannot use it."""
        return None

    def health(self) -> Health:
        """Return the state of the source."""
        return Health()

    def close(self) -> None:
        """Release files and devices. Closing twice is harmless."""

    def __iter__(self) -> Iterator[SensorFrame]:
        while (frame := self.next_frame()) is not None:
            yield frame


def from_first_s(stamps_s: Float64Array) -> Float64Array | None:
    """Return time stamps, seconds, from the first one; None unless they rise."""
    return stamps_s - stamps_s[0] if len(stamps_s) and bool((np.diff(stamps_s) > 0).all()) else None


class SeekableSource(FrameSource):
    """A source of known length that reads any frame by its index."""

    length: int

    def __init__(self, name: str, rig: Rig, length: int) -> None:
        self.name, self.rig, self.length = name, rig, length
        self.position = 0

    @abstractmethod
    def read(self, index: int) -> SensorFrame:
        """Return frame ``index``, 0 <= index < length."""

    def next_frame(self) -> SensorFrame | None:
        if self.position >= self.length:
            return None
        frame = self.read(self.position)
        self.position += 1
        return frame

    def seek(self, index: int) -> None:
        if not 0 <= index < self.length:
            raise SourceError(f"{self.name}: there is no frame {index}; frames run from 0 to {self.length - 1}")
        self.position = index


@dataclass(frozen=True)
class SourceKind:
    """One kind of source: its names, what the user must choose, and how it is opened.

    Attributes
    ----------
    scheme : str
        Text before the colon of a name.
    title : str
        Name in file dialogs.
    form : str
        How a name is written, such as ``"folder:PATH"``.
    open : callable
        ``open(rest, progress, cameras)`` returns the source. ``rest`` is the name after the colon, ``cameras`` the
        preset's section ``cameras``, or None. Raises `SourceError`. A heavy module is best imported inside.
    needs : {"nothing", "folder", "file"}
        What the user must choose to open a source.
    pattern : str
        File names that it opens, such as ``"*.bag *.db3"``, or those one of which makes a folder one, such as
        ``"rig.json"``; empty if it opens none.
    files : int
        How many files, with commas between them, may make one source.
    """

    scheme: str
    title: str
    form: str
    open: Callable[[str, Progress | None, CamerasSection | None], FrameSource]
    needs: Literal["nothing", "folder", "file"] = "nothing"
    pattern: str = ""
    files: int = 1

    def claim(self, name: str) -> str | None:
        """Return what to open where a name without a scheme is a path of this kind, else None."""
        path = user_path(name)
        if self.needs == "file":
            files = recording_files(name)
            fits = all(any(file.match(each) for each in self.pattern.split()) for file in files)
            return name if 0 < len(files) <= self.files and fits else None
        if self.needs == "folder" and self.pattern:
            if path.is_dir():
                return name if any(any(path.glob(each)) for each in self.pattern.split()) else None
            if path.name == self.pattern.split()[0] and path.is_file():
                return str(path.parent)
        return None
