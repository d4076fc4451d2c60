"""Recordings that librealsense writes, of one or two depth cameras, read without the camera driver.

Up to 2.57 they are ROS 1 bags. From 2.58 on they are SQLite databases of ROS 2 bags, whose descriptions are strings of
``key=value;``: 2.58 compresses every message with zstd and keeps images raw, 2.59 keeps images as PNG.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from ..errors import SourceError, closed_on_error, foreign
from ..model.arrays import AnyArray, Float64Array
from ..model.files import recording_paths
from ..model.frames import DepthCamera, camera_pose, pose_matrix
from ..model.intrinsics import Distortion, Intrinsics
from .base import Progress, part_of
from .cameras.camera import Calibration
from .cameras.pairing import nearest
from .recorded import RecordedCamera, RecordedSource
from .ros.bags import Ros1Bag, open_bag
from .ros.messages import IMAGE, TEXT, TYPES, Bag, matrix_of
from .ros_image import DamagedFileError, RawImage, damage_told

_STREAM = re.compile(r"(/device_(\d{1,4})/sensor_\d{1,4}/(Depth|Color)_\d{1,4})/image/data(/compressed(?:Depth)?)?")
#: Stamps of one stream that are farther from each other, against the recorder's time, are of two clocks.
_OTHER_CLOCK_S: Final = 1e6


class BagSource(RecordedSource):
    """A RealSense recording: one file with one or two depth cameras, or two files with one each.

    The proximity camera is the L515, or the first device where there is none. Times are the images' stamps where both
    cameras use one clock (global or system time), else, in one file, the recording times. A recording does not contain
    the pose between the cameras: the preset must have it.
    """

    def __init__(self, name: Path | str, progress: Progress | None = None) -> None:
        text = str(name)
        paths = recording_paths(text)
        with ExitStack() as resources:
            recordings = [
                resources.enter_context(closing(open_recording(path, part_of(progress, number, len(paths)))))
                for number, path in enumerate(paths)
            ]
            lacks = [
                f"{recording.path.name} was not finished when it was recorded: it is shown up to its last whole part"
                for recording in recordings
                if not recording.bag.complete
            ]
            super().__init__(f"bag:{text}", _cameras(f"bag:{text}", recordings), resources, lacks)
            self._resources = resources.pop_all()


def is_realsense(text: str) -> bool:
    """Whether a name is that of librealsense's recordings: their topics begin with a device's number."""
    with closing(open_bag(recording_paths(text))) as bag:
        return any(topic.startswith("/device_") for topic in bag.types)


def _cameras(name: str, recordings: Sequence[RecordingFile]) -> list[RecordedCamera]:
    """Return the proximity camera and, if there are two, the tactile one, with times on one clock."""
    cameras = [camera for recording in recordings for camera in recording.cameras]
    if len(cameras) > 2 or len(cameras) < len(recordings):
        models = ", ".join(camera.calibration.depth.model for camera, _ in cameras)
        raise SourceError(f"{name} has {len(cameras)} depth cameras ({models}); record one or two")
    first, last = cameras[0][0].calibration.depth, cameras[-1][0].calibration.depth
    if len(cameras) == 2 and first.serial == last.serial != "":
        raise SourceError(f"{name}: both are of the same {first.model} {first.serial}; give one of each camera")
    cameras.sort(key=lambda camera: "L515" not in camera[0].calibration.depth.model)
    one, other = cameras[0][1], cameras[-1][1]
    times_s = _common_times(one, other, one_device=len(cameras) == 1)
    if len(recordings) == 2 and times_s[0] is one.recorded_s:
        raise SourceError(
            f"{name}: the cameras' clocks cannot be compared ({one.clock or 'unknown'} and "
            f"{other.clock or 'unknown'}); record both cameras with global time enabled"
        )
    return [replace(camera, times_s=its_s) for (camera, _), its_s in zip(cameras, times_s, strict=False)]


@dataclass(frozen=True, eq=False)
class Stream:
    """One image stream with both times; ``clock`` is that of the stamps or empty, ``poses`` (4, 4) by reference."""

    topic: str
    read: Callable[[int], AnyArray]
    intrinsics: Intrinsics
    rate_hz: float
    clock: str
    stamps_s: Float64Array
    recorded_s: Float64Array
    poses: Mapping[str, Float64Array]


def _common_times(first: Stream, second: Stream, *, one_device: bool) -> tuple[Float64Array, Float64Array]:
    """Return both streams' own stamps, s, if they are on one clock, else when they were recorded."""
    if first.clock == second.clock != "" and (one_device or first.clock != "Hardware Clock"):
        return first.stamps_s, second.stamps_s
    return first.recorded_s, second.recorded_s


class RecordingFile:
    """An open recording: a ``.bag``, as librealsense writes it up to 2.57."""

    def __init__(self, path: Path, bag: Bag, progress: Progress) -> None:
        self.path, self.bag = path, bag
        self.cameras = self._find_cameras(progress)

    def close(self) -> None:
        self.bag.close()

    def _find_cameras(self, progress: Progress) -> list[tuple[RecordedCamera, Stream]]:
        found: dict[tuple[int, str], tuple[str, str]] = {}
        for topic in sorted(self.bag.types):
            if match := _STREAM.fullmatch(topic):
                found.setdefault((int(match[2]), match[3]), (match[1], topic))
        streams = {
            key: self._stream(key[1], *topics, part_of(progress, number, len(found)))
            for number, (key, topics) in enumerate(found.items())
        }
        return [
            (self._camera(number, stream, streams.get((number, "Color"))), stream)
            for (number, kind), stream in sorted(streams.items())
            if kind == "Depth"
        ]

    def _stream(self, kind: str, topic: str, images: str, progress: Progress) -> Stream:
        lens, rate_hz = self._lens(topic)
        lens["distortion"] = Distortion(lens["distortion"].lower().replace(" ", "_"))
        lens["coefficients"] = tuple(map(float, lens["coefficients"]))
        recorded_s = np.array(self.bag.times_ns(images) * 1e-9)
        stamps_s, clock = self._times(topic, images, progress)
        # The first images of a camera may be on its own clock, until the driver knows its offset to the computer's.
        ahead_s = stamps_s - recorded_s
        usual_s = np.median(ahead_s)
        stamps_s = np.where(np.abs(ahead_s - usual_s) > _OTHER_CLOCK_S, recorded_s + usual_s, stamps_s)
        prefix = f"{topic}/tf/"
        poses = {name.removeprefix(prefix): self._pose(name) for name in self.bag.types if name.startswith(prefix)}
        intrinsics = Intrinsics(**lens)

        def read(index: int) -> AnyArray:
            image = self.image(images, index)
            return image.counts(intrinsics.shape) if kind == "Depth" else image.color(intrinsics.shape)

        return Stream(topic, read, intrinsics, rate_hz, clock, stamps_s, recorded_s, poses)

    def _camera(self, number: int, depth: Stream, color: Stream | None) -> RecordedCamera:
        """Return a camera with the stamps of its depth images; each has the colour image nearest to it."""
        unit_m = self._depth_unit_m(depth.topic.rpartition("/")[0])
        if unit_m is None:
            raise DamagedFileError("the depth unit is missing (topic …/option/Depth_Units/value)")
        names = self._names(f"/device_{number}/info")
        info = DepthCamera(
            model=foreign(names.get("Name", "unknown"), 80),
            serial=foreign(names.get("Serial Number", ""), 80),
            intrinsics=depth.intrinsics,
            depth_unit_m=unit_m,
        )
        calibration, partners = Calibration(info), np.empty(0, np.int64)
        if color is not None:
            common = color.poses.keys() & depth.poses.keys()
            if not common:
                raise DamagedFileError(f"the pose of {color.topic} to {depth.topic} is missing (topics such as …/tf/0)")
            reference = min(common)
            pose = camera_pose(color.poses[reference] @ np.linalg.inv(depth.poses[reference]))
            calibration = Calibration(info, color.intrinsics, pose)
            partners = nearest(*_common_times(depth, color, one_device=True))
        read_color = None if color is None else color.read
        return RecordedCamera(self.path, calibration, depth.rate_hz, depth.stamps_s, depth.read, read_color, partners)

    def image(self, topic: str, index: int) -> RawImage:
        """Return an image by its number; some versions append a list of metadata, which the library does not accept."""
        message = self.bag.raw(topic, index)
        _, at = _text(message, 12)
        height, width = struct.unpack_from("<II", message, at)
        encoding, at = _text(message, at + 8)
        big_endian, step, size = struct.unpack_from("<BII", message, at)
        at += 9
        if size > len(message) - at:
            raise DamagedFileError(f"it has {len(message) - at} bytes, too few for its size")
        return RawImage(height, width, encoding, bool(big_endian), step, np.frombuffer(message, np.uint8, size, at))

    def _names(self, topic: str) -> Mapping[str, str]:
        """Return the names and values of a description."""
        return self._facts(topic, range(self.bag.count(topic)))

    def _depth_unit_m(self, sensor: str) -> float | None:
        """Return the depth unit of a sensor, or None if the recording does not say it."""
        options = [f"{sensor}/option/{words}/value" for words in ("Depth Units", "Depth_Units")]
        return next((float(self._first(option).data) for option in options if self.bag.count(option)), None)

    def _lens(self, topic: str) -> tuple[dict[str, Any], float]:
        """Return the fields of a stream's `Intrinsics` in the driver's words, and its rate, Hz."""
        if not self.bag.count(f"{topic}/info"):
            raise DamagedFileError(f"the topic {topic}/info is missing")
        (rate_hz,) = struct.unpack_from("<I", self.bag.raw(f"{topic}/info", 0))
        lens: Any = self._first(f"{topic}/info/camera_info")
        fx, _, cx, _, fy, cy, *_ = lens.K
        size = {"width": lens.width, "height": lens.height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
        return {**size, "distortion": lens.distortion_model, "coefficients": lens.D}, float(rate_hz)

    def _pose(self, topic: str) -> Float64Array:
        """Return the 4 x 4 matrix of a pose."""
        return matrix_of(self._first(topic))

    def _times(self, topic: str, images: str, progress: Progress) -> tuple[Float64Array, str]:
        """Return the stamps of a stream, s, and the clock of these, empty if unknown; no image is decoded for this."""
        about = f"{topic}/image/metadata"
        # Cameras write two dozen facts for every image; those of the last one tell the clock.
        written_ns = self.bag.times_ns(about)
        last = np.flatnonzero(written_ns == written_ns[-1:])
        facts = self._facts(about, last.tolist())
        return self.bag.stamps_s(images, progress), facts.get("timestamp_domain", "")

    def _facts(self, topic: str, numbers: Iterable[int]) -> dict[str, str]:
        messages = (self.bag.message(topic, number) for number in numbers)
        return {message.key: message.value for message in messages}

    def _first(self, topic: str) -> Any:
        if not self.bag.count(topic):
            raise DamagedFileError(f"the topic {topic} is missing")
        return self.bag.message(topic, 0)


class Db3File(RecordingFile):
    """A ``.db3``, as librealsense writes it from 2.58 on: the same in other messages."""

    def image(self, topic: str, index: int) -> RawImage:
        data = self.bag.raw(topic, index)
        if topic.endswith("/image/data"):
            return RawImage.of(TYPES.deserialize_cdr(data, IMAGE))
        found: Any = TYPES.deserialize_cdr(data, "sensor_msgs/msg/CompressedImage")
        found.format = "16UC1; compressedDepth png" if topic.endswith("Depth") else "png"
        return RawImage.of(found)

    def _names(self, topic: str) -> dict[str, str]:
        """Return the merged key-value pairs of all messages of a string topic."""
        facts: dict[str, str] = {}
        for index in range(self.bag.count(topic)):
            facts |= self._pairs(topic, index)
        return facts

    def _depth_unit_m(self, sensor: str) -> float | None:
        unit = self._names(f"{sensor}/option/Depth_Units/value")
        return _numbers({"unit": next(iter(unit))}, "unit")[0] if unit else None

    def _lens(self, topic: str) -> tuple[dict[str, Any], float]:
        info, lens = self._names(f"{topic}/info"), self._names(f"{topic}/camera_info")
        keys = {"width": "width", "height": "height", "fx": "fx", "fy": "fy", "cx": "ppx", "cy": "ppy"}
        values: dict[str, Any] = {key: _numbers(lens, theirs)[0] for key, theirs in keys.items()}
        values |= {"distortion": lens.get("model", ""), "coefficients": _numbers(lens, "coeffs")}
        return values, _numbers(info, "fps")[0]

    def _pose(self, topic: str) -> Float64Array:
        """Its rotation is written column by column."""
        facts = self._names(topic)
        return pose_matrix(np.reshape(_numbers(facts, "rotation"), (3, 3)).T, _numbers(facts, "translation"))

    def _times(self, topic: str, images: str, progress: Progress) -> tuple[Float64Array, str]:
        about = f"{topic}/image/metadata"
        facts = {int(time_ns): self._pairs(about, index) for index, time_ns in enumerate(self.bag.times_ns(about))}
        of_images = [facts.get(int(time_ns), {}) for time_ns in self.bag.times_ns(images)]
        stamps_s = np.array([float(each.get("timestamp", "nan")) * 1e-3 for each in of_images])
        if not np.isfinite(stamps_s).all():
            raise DamagedFileError(f"an image of {topic} has no time stamp")
        return stamps_s, of_images[-1].get("timestamp_domain", "")

    def _pairs(self, topic: str, index: int) -> dict[str, str]:
        """Return the ``key=value;key=value`` of a message; a part without a value is a key with an empty value."""
        message: Any = TYPES.deserialize_cdr(self.bag.raw(topic, index), TEXT)
        return {key: value for key, _, value in (part.partition("=") for part in message.data.split(";")) if key}


def open_recording(path: Path, progress: Progress) -> RecordingFile:
    bag = open_bag([path])
    with closed_on_error(bag.close), damage_told(path, "this is no readable RealSense recording"):
        # Decided by content, because a .bag may have been renamed.
        opened = (RecordingFile if isinstance(bag, Ros1Bag) else Db3File)(path, bag, progress)
        if not opened.cameras:
            raise DamagedFileError("it holds no depth images")
        return opened


def _text(message: memoryview, at: int) -> tuple[str, int]:
    """Return a text in a message, and where it ends."""
    (length,) = struct.unpack_from("<I", message, at)
    end = at + 4 + length
    return bytes(message[at + 4 : end]).decode(errors="replace"), end


def _numbers(facts: Mapping[str, str], key: str) -> tuple[float, ...]:
    """Return the comma-separated numbers of a field, at the precision of the cameras."""
    return tuple(float(np.float32(float(part))) for part in facts.get(key, "").split(","))
