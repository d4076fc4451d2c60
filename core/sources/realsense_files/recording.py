"""What a RealSense recording holds, whatever its file format: cameras, lenses, poses, units and times."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from pydantic import ValidationError

from ...errors import SourceError, TactuneError
from ...model.arrays import Float64Array, Int64Array, Uint8Array, Uint16Array
from ...model.frames import DepthCamera, camera_pose
from ...model.intrinsics import Distortion, Intrinsics
from ..cameras.camera import Calibration
from ..ros_image import DamagedFileError, RawImage

HARDWARE_CLOCK = "Hardware Clock"
_STREAM = re.compile(r"(/device_(\d{1,4})/sensor_\d{1,4}/(Depth|Color)_\d{1,4})/image/data(/compressed(?:Depth)?)?")


@dataclass(frozen=True, eq=False)
class ImageTimes:
    """Time stamps of the images of one stream as in the file.

    ``clocks`` is an empty string and ``arrived_ms`` is 0 where they are unknown.
    """

    recorded_ns: Int64Array
    stamps_s: Float64Array
    clocks: Sequence[str]
    arrived_ms: Float64Array


@dataclass(frozen=True, eq=False)
class Stream:
    """One image stream: its lens, time stamps and images.

    Attributes
    ----------
    clock : str
        Clock of ``stamps_s``, in librealsense's words; empty if unknown.
    stamps_s : float64, shape (N,)
        The images' own time stamps, seconds.
    recorded_s : float64, shape (N,)
        When each was recorded, seconds on the one clock of the whole recording.
    arrived_s : float64, shape (N,), or None
        When each reached the computer, seconds of its system time; None if the recording does not say.
    poses : dict of str to 4 x 4
        From a named reference to the stream, by the reference's name.
    read : callable
        Returns an image by its number.
    """

    topic: str
    intrinsics: Intrinsics
    rate_hz: float
    clock: str
    stamps_s: Float64Array
    recorded_s: Float64Array
    arrived_s: Float64Array | None
    poses: Mapping[str, Float64Array]
    read: Callable[[int], RawImage]

    def __len__(self) -> int:
        return len(self.stamps_s)


@dataclass(frozen=True, eq=False)
class Camera:
    """One device of a file at ``path``: its depth stream and, where recorded, its colour stream."""

    path: Path
    calibration: Calibration
    depth: Stream
    color: Stream | None

    @property
    def info(self) -> DepthCamera:
        """Model, serial number, lens and depth unit."""
        return self.calibration.depth

    def depth_image(self, index: int) -> Uint16Array:
        """Return raw counts: uint16, shape (H, W)."""
        with damage_told(self.path, f"image {index} of {self.depth.topic} cannot be read"):
            return self.depth.read(index).depth(self.depth.intrinsics.shape)

    def color_image(self, index: int) -> Uint8Array:
        """Return a colour image: RGB uint8, shape (H, W, 3)."""
        assert self.color is not None
        with damage_told(self.path, f"image {index} of {self.color.topic} cannot be read"):
            return self.color.read(index).color(self.color.intrinsics.shape)


class RecordingFile(Protocol):
    """An open recording; `is_complete` is False where its recorder was killed."""

    path: Path
    is_complete: bool
    cameras: list[Camera]

    def close(self) -> None:
        """Close the file; twice is harmless."""


def find_streams(topics: Iterable[str]) -> dict[tuple[int, str], tuple[str, str]]:
    """Return the image topics by device number and ``"Depth"`` or ``"Color"``: the topics' prefix, and the topic."""
    streams: dict[tuple[int, str], tuple[str, str]] = {}
    for topic in sorted(topics):
        if match := _STREAM.fullmatch(topic):
            streams.setdefault((int(match[2]), match[3]), (match[1], topic))
    return streams


@contextmanager
def damage_told(path: Path, what: str) -> Iterator[None]:
    """Turn damage, in whichever way a library reports it, into a `SourceError` of one sentence."""
    try:
        yield
    except TactuneError:  # also of a progress callable that cancels
        raise
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; check the disk") from error
    except Exception as error:
        detail = " ".join(str(error).split())[:300] or type(error).__name__
        raise SourceError(f"{path}: {what} ({detail}); copy or record it again") from error


def make_camera(
    path: Path, names: Mapping[str, str], depth_unit_m: float | None, depth: Stream, color: Stream | None
) -> Camera:
    """Return a device of what a file says; ``names`` holds its model and serial number."""
    if depth_unit_m is None:
        raise DamagedFileError("the depth unit is missing (topic …/option/Depth_Units/value)")
    if not 1e-7 <= depth_unit_m <= 1.0:
        raise DamagedFileError(f"the depth unit is {depth_unit_m} m, but it must be above 0 and at most 1")
    info = DepthCamera(
        model=_plain(names.get("Name", "unknown")),
        serial=_plain(names.get("Serial Number", "")),
        intrinsics=depth.intrinsics,
        depth_unit_m=depth_unit_m,
    )
    if color is None:
        return Camera(path, Calibration(info), depth, None)
    common = color.poses.keys() & depth.poses.keys()
    if not common:
        raise DamagedFileError(f"the pose of {color.topic} to {depth.topic} is missing (topics such as …/tf/0)")
    reference = min(common)
    pose = camera_pose(color.poses[reference] @ np.linalg.inv(depth.poses[reference]))
    return Camera(path, Calibration(info, color.intrinsics, pose), depth, color)


def make_stream(
    topic: str,
    lens: tuple[int, int, float, float, float, float],
    lens_model: str,
    coefficients: Sequence[float],
    rate_hz: float,
    times: ImageTimes,
    poses: Mapping[str, Float64Array],
    read: Callable[[int], RawImage],
) -> Stream:
    """Return an image stream of what a file says; ``lens`` is width, height, fx, fy, cx, cy."""
    try:
        distortion = Distortion(lens_model.lower().replace(" ", "_"))
    except ValueError as error:
        known = ", ".join(Distortion)
        raise DamagedFileError(f"{topic} has the lens model {_plain(lens_model)!r}; known are {known}") from error
    names = ("width", "height", "fx", "fy", "cx", "cy")
    values = {**dict(zip(names, lens, strict=True)), "distortion": distortion, "coefficients": tuple(coefficients)}
    try:
        intrinsics = Intrinsics.model_validate(values)
    except ValidationError as error:
        field = ".".join(str(part) for part in error.errors()[0]["loc"])
        raise DamagedFileError(f"{topic}: {field} of the lens is out of range") from error
    clock, stamps_s, arrived_s = on_one_clock(times)
    recorded_s = np.asarray(times.recorded_ns * 1e-9, np.float64)
    return Stream(topic, intrinsics, rate_hz, clock, stamps_s, recorded_s, arrived_s, poses, read)


def on_one_clock(times: ImageTimes) -> tuple[str, Float64Array, Float64Array | None]:
    """Return the clock of most images, the stamps of all on it, and their arrival in seconds, if known.

    The first images of a camera may be on its own clock, until the driver knows its offset to the computer's. Their
    stamps are estimated from their recording times.
    """
    clock = Counter(times.clocks).most_common(1)[0][0]
    recorded_s = times.recorded_ns * 1e-9
    stamps_s = times.stamps_s
    other = np.array([name != clock for name in times.clocks])
    if other.any():
        stamps_s = np.where(other, recorded_s + np.median((stamps_s - recorded_s)[~other]), stamps_s)
    arrived_s = times.arrived_ms * 1e-3
    return clock, stamps_s, arrived_s if (arrived_s > 0).all() else None


def milliseconds(text: str) -> float:
    """Return a time in text as a number; 0, which means unknown, where it is not a number."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if math.isfinite(value) else 0.0


def _plain(text: str) -> str:
    """Return a name from a file as one short printable line."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())[:80]
