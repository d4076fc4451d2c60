"""What a RealSense recording holds, whatever its file format: cameras, lenses, poses, units and times."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from ...model.arrays import AnyArray, Float64Array
from ...model.frames import DepthCamera, camera_pose
from ...model.intrinsics import Distortion, Intrinsics
from ..base import Progress
from ..cameras.camera import Calibration
from ..ros_image import DamagedFileError, RawImage, damage_told

_STREAM = re.compile(r"(/device_(\d{1,4})/sensor_\d{1,4}/(Depth|Color)_\d{1,4})/image/data(/compressed(?:Depth)?)?")


#: Stamps of one stream that are farther from each other, against the recorder's time, are of two clocks.
_OTHER_CLOCK_S: Final = 1e6


class Times(NamedTuple):
    """When the images of a stream were recorded, their own stamps, and the clock of these, empty if unknown."""

    recorded_ns: Sequence[int]
    stamps_s: Sequence[float]
    clock: str


@dataclass(frozen=True, eq=False)
class Stream:
    """One image stream.

    ``clock`` is that of the images' own stamps, in librealsense's words, or empty. All images of a recording have
    ``recorded_s`` on one clock. ``poses`` are 4 x 4, from a named reference to the stream; ``read`` returns an image by
    its number.
    """

    topic: str
    intrinsics: Intrinsics
    rate_hz: float
    clock: str
    stamps_s: Float64Array
    recorded_s: Float64Array
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

    def image(self, stream: Stream, index: int) -> AnyArray:
        """Return raw counts, uint16 (H, W), or an RGB image, uint8 (H, W, 3)."""
        with damage_told(self.path, f"image {index} of {stream.topic} cannot be read"):
            raw, shape = stream.read(index), stream.intrinsics.shape
            return raw.counts(shape) if stream is self.depth else raw.color(shape)


class RecordingFile(ABC):
    """An open recording; ``is_complete`` is False where its recorder was killed."""

    is_complete = True

    def __init__(self, path: Path, progress: Progress | None) -> None:
        self.path, self.progress = path, progress
        try:
            self._topics = self._open()
            self.cameras = self._find_cameras()
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
    def _times(self, topics: Collection[tuple[str, str]]) -> Mapping[str, Times]:
        """Return the times of streams, given and returned by their prefix; no image is decoded for this."""

    @abstractmethod
    def _lens(self, topic: str) -> tuple[dict[str, Any], float]:
        """Return the fields of a stream's `Intrinsics` in the driver's words, and its rate, Hz."""

    @abstractmethod
    def _pose(self, topic: str) -> Float64Array:
        """Return the 4 x 4 matrix of a pose."""

    @abstractmethod
    def _image(self, topic: str, index: int) -> RawImage:
        """Return an image by its number in the order of `_times`."""

    def _find_cameras(self) -> list[Camera]:
        found: dict[tuple[int, str], tuple[str, str]] = {}
        for topic in sorted(self._topics):
            if match := _STREAM.fullmatch(topic):
                found.setdefault((int(match[2]), match[3]), (match[1], topic))
        times = self._times(found.values()) if any(kind == "Depth" for _, kind in found) else {}
        streams = {key: self._stream(*pair, times[pair[0]]) for key, pair in found.items() if times}
        return [
            self._camera(number, stream, streams.get((number, "Color")))
            for (number, kind), stream in sorted(streams.items())
            if kind == "Depth"
        ]

    def _stream(self, topic: str, images: str, times: Times) -> Stream:
        lens, rate_hz = self._lens(topic)
        lens["distortion"] = Distortion(lens["distortion"].lower().replace(" ", "_"))
        lens["coefficients"] = tuple(map(float, lens["coefficients"]))
        recorded_s, stamps_s = np.array(times.recorded_ns) * 1e-9, np.array(times.stamps_s)
        # The first images of a camera may be on its own clock, until the driver knows its offset to the computer's.
        ahead_s = stamps_s - recorded_s
        usual_s = np.median(ahead_s)
        stamps_s = np.where(np.abs(ahead_s - usual_s) > _OTHER_CLOCK_S, recorded_s + usual_s, stamps_s)
        prefix = f"{topic}/tf/"
        poses = {name.removeprefix(prefix): self._pose(name) for name in self._topics if name.startswith(prefix)}
        read = partial(self._image, images)
        return Stream(topic, Intrinsics(**lens), rate_hz, times.clock, stamps_s, recorded_s, poses, read)

    def _camera(self, number: int, depth: Stream, color: Stream | None) -> Camera:
        unit_m = self._depth_unit_m(depth.topic.rpartition("/")[0])
        if unit_m is None:
            raise DamagedFileError("the depth unit is missing (topic …/option/Depth_Units/value)")
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


def _plain(text: str) -> str:
    """Return a name from a file as one short printable line."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())[:80]
