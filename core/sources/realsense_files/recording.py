"""What a RealSense recording holds, whatever its file format: cameras, lenses, poses, units and times."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from ...model.arrays import Float64Array, Uint8Array, Uint16Array
from ...model.frames import DepthCamera, camera_pose
from ...model.intrinsics import Distortion, Intrinsics
from ..base import Progress
from ..cameras.camera import Calibration
from ..ros_image import DamagedFileError, RawImage, damage_told

_STREAM = re.compile(r"(/device_(\d{1,4})/sensor_\d{1,4}/(Depth|Color)_\d{1,4})/image/data(/compressed(?:Depth)?)?")


class ImageTime(NamedTuple):
    """Time stamps of one image; the clock of its own stamp is empty, and the arrival 0, where it is unknown."""

    recorded_ns: int
    stamp_s: float
    clock: str
    arrived_ms: float


@dataclass(frozen=True, eq=False)
class Stream:
    """One image stream.

    ``clock`` is that of the images' own stamps, in librealsense's words, or empty. All images of a recording have
    ``recorded_s`` on one clock; ``arrived_s`` is when they reached the computer, None if unknown. ``poses`` are 4 x 4,
    from a named reference to the stream; ``read`` returns an image by its number.
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


@dataclass(frozen=True, eq=False)
class Camera:
    """One device of a file at ``path``: its depth stream and, where recorded, its colour stream."""

    path: Path
    calibration: Calibration
    depth: Stream
    color: Stream | None

    @property
    def info(self) -> DepthCamera:
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


class RecordingFile(ABC):
    """An open recording; ``is_complete`` is False where its recorder was killed."""

    is_complete = True

    def __init__(self, path: Path, progress: Progress | None) -> None:
        self.path, self.progress = path, progress
        try:
            self.cameras = self._find_cameras(self._open())
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def _open(self) -> Collection[str]:
        """Open the file, and return the topics that have messages."""

    @abstractmethod
    def close(self) -> None:
        """Close the file; twice is harmless."""

    @abstractmethod
    def _names(self, topic: str) -> Mapping[str, str]:
        """Return the names and values of a device's description."""

    @abstractmethod
    def _depth_unit_m(self, sensor: str) -> float | None:
        """Return the depth unit of a sensor, or None if the recording does not say it."""

    @abstractmethod
    def _times(self, topics: Collection[tuple[str, str]]) -> Mapping[str, list[ImageTime]]:
        """Return the times of streams, given and returned by their prefix; no image is decoded for this."""

    @abstractmethod
    def _stream(self, topic: str, images: str, times: Sequence[ImageTime]) -> Stream:
        """Return the stream whose topics begin with ``topic`` and whose images are on ``images``."""

    def _find_cameras(self, topics: Collection[str]) -> list[Camera]:
        found: dict[tuple[int, str], tuple[str, str]] = {}
        for topic in sorted(topics):
            if match := _STREAM.fullmatch(topic):
                found.setdefault((int(match[2]), match[3]), (match[1], topic))
        times = self._times(found.values()) if any(kind == "Depth" for _, kind in found) else {}
        streams = {key: self._stream(*pair, times[pair[0]]) for key, pair in found.items() if times}
        return [
            self._camera(number, stream, streams.get((number, "Color")))
            for (number, kind), stream in sorted(streams.items())
            if kind == "Depth"
        ]

    def _camera(self, number: int, depth: Stream, color: Stream | None) -> Camera:
        unit_m = self._depth_unit_m(depth.topic.rpartition("/")[0])
        if unit_m is None:
            raise DamagedFileError("the depth unit is missing (topic …/option/Depth_Units/value)")
        if not 1e-7 <= unit_m <= 1.0:
            raise DamagedFileError(f"the depth unit is {unit_m} m, but it must be above 0 and at most 1")
        names = self._names(f"/device_{number}/info")
        info = DepthCamera(
            model=_plain(names.get("Name", "unknown")),
            serial=_plain(names.get("Serial Number", "")),
            intrinsics=depth.intrinsics,
            depth_unit_m=unit_m,
        )
        if color is None:
            return Camera(self.path, Calibration(info), depth, None)
        common = color.poses.keys() & depth.poses.keys()
        if not common:
            raise DamagedFileError(f"the pose of {color.topic} to {depth.topic} is missing (topics such as …/tf/0)")
        reference = min(common)
        pose = camera_pose(color.poses[reference] @ np.linalg.inv(depth.poses[reference]))
        return Camera(self.path, Calibration(info, color.intrinsics, pose), depth, color)


def make_stream(
    topic: str,
    lens: Mapping[str, float],
    lens_model: str,
    coefficients: Sequence[float],
    rate_hz: float,
    times: Sequence[ImageTime],
    poses: Mapping[str, Float64Array],
    read: Callable[[int], RawImage],
) -> Stream:
    """Return an image stream of what a file says; ``lens`` has width, height, fx, fy, cx and cy."""
    try:
        distortion = Distortion(lens_model.lower().replace(" ", "_"))
    except ValueError as error:
        known = ", ".join(Distortion)
        raise DamagedFileError(f"{topic} has the lens model {_plain(lens_model)!r}; known are {known}") from error
    try:
        intrinsics = Intrinsics.model_validate(
            {**lens, "distortion": distortion, "coefficients": tuple(map(float, coefficients))}
        )
    except ValidationError as error:
        field = ".".join(str(part) for part in error.errors()[0]["loc"])
        raise DamagedFileError(f"{topic}: {field} of the lens is out of range") from error
    recorded_s = np.array([time.recorded_ns for time in times]) * 1e-9
    arrived_s = np.array([time.arrived_ms for time in times]) * 1e-3
    stamps_s = np.array([time.stamp_s for time in times])
    # The first images of a camera may be on its own clock, until the driver knows its offset to the computer's.
    clock = Counter(time.clock for time in times).most_common(1)[0][0]
    other = np.array([time.clock != clock for time in times])
    stamps_s = np.where(other, recorded_s + np.median((stamps_s - recorded_s)[~other]), stamps_s)
    known_s = arrived_s if (arrived_s > 0).all() else None
    return Stream(topic, intrinsics, rate_hz, clock, stamps_s, recorded_s, known_s, poses, read)


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
