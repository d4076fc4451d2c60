"""What librealsense writes into a ROS 1 bag: depth and colour streams, lenses, poses and units."""

from __future__ import annotations

import re
import struct
from bisect import bisect_left
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import ValidationError
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

from ..errors import SourceError
from ..frames import DepthCamera, Matrix4, rigid_transform
from ..intrinsics import Distortion, Intrinsics
from .base import Progress

Float64Array = npt.NDArray[np.float64]
_STREAM_TOPIC = re.compile(r"/device_(\d+)/sensor_(\d+)/(Depth|Color)_\d+/image/data")
_DEPTH_ENCODINGS = ("mono16", "16UC1")
_TYPES = get_typestore(Stores.ROS1_NOETIC)

#: Bytes per pixel of each colour encoding that librealsense records and OpenCV's conversion to RGB.
_TO_RGB = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
    "YUYV": (2, cv2.COLOR_YUV2RGB_YUYV),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
}


@dataclass(frozen=True, eq=False)
class Stream:
    """One image stream: its lens and when each image was taken.

    Attributes
    ----------
    topic : str
        The part of its topics that all share, such as ``"/device_0/sensor_0/Depth_0"``.
    clock : str
        What ``stamps_s`` count on, in librealsense's words; empty where unknown.
    stamps_s : float64, shape (N,)
        The images' own time stamps, seconds.
    recorded_s : float64, shape (N,)
        When each was recorded, seconds on the one clock of the whole recording.
    """

    topic: str
    device: int
    intrinsics: Intrinsics
    rate_hz: float
    clock: str
    stamps_s: Float64Array
    recorded_s: Float64Array
    _connection: Connection
    _recorded_ns: list[int]

    def __len__(self) -> int:
        return len(self.stamps_s)


@dataclass(frozen=True, eq=False)
class Camera:
    """One device: its depth stream and, where recorded, its colour stream and how that stands to depth."""

    info: DepthCamera
    depth: Stream
    color: Stream | None
    T_color_depth: Matrix4

    @property
    def color_is_aligned(self) -> bool:
        """Whether colour and depth pixels are the same rays."""
        same_lens = self.color is not None and self.color.intrinsics == self.depth.intrinsics
        return same_lens and np.allclose(self.T_color_depth, np.eye(4), atol=1e-9)


class RealSenseBag:
    """An open recording: its cameras, by device number, and their images on demand.

    Raises
    ------
    SourceError
        The file is damaged or no RealSense recording with depth.
    """

    def __init__(self, path: Path, progress: Progress | None = None) -> None:
        self._path = path
        self._progress = progress
        self._reader = Reader(path)
        self._is_open = False
        with self._damage_told():
            self._reader.open()
            self._is_open = True
            try:
                self._topics = {connection.topic: connection for connection in self._reader.connections}
                self.cameras = self._find_cameras()
            except BaseException:
                self.close()
                raise

    def close(self) -> None:
        """Close the file; twice is harmless."""
        if self._is_open:
            self._is_open = False
            self._reader.close()

    def depth_image(self, stream: Stream, index: int) -> npt.NDArray[np.uint16]:
        """Return raw counts: uint16, shape (H, W)."""
        message = self._image(stream, index)
        if message.encoding not in _DEPTH_ENCODINGS:
            raise self._refusal(f"{stream.topic} is encoded as {message.encoding!r}, not as 16 bit depth")
        rows = self._rows(stream, message, bytes_per_pixel=2)
        return rows.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)

    def color_image(self, stream: Stream, index: int) -> npt.NDArray[np.uint8]:
        """Return a colour image: RGB uint8, shape (H, W, 3)."""
        message = self._image(stream, index)
        if message.encoding not in _TO_RGB:
            known = ", ".join(_TO_RGB)
            raise self._refusal(f"{stream.topic} is encoded as {message.encoding!r}; known are {known}")
        bytes_per_pixel, conversion = _TO_RGB[message.encoding]
        rows = self._rows(stream, message, bytes_per_pixel)
        image = rows.reshape(*stream.intrinsics.shape, bytes_per_pixel)
        return image.copy() if conversion is None else np.asarray(cv2.cvtColor(image, conversion), np.uint8)

    def _find_cameras(self) -> list[Camera]:
        streams: dict[tuple[int, str], str] = {}
        for topic in sorted(self._topics):
            match = _STREAM_TOPIC.fullmatch(topic)
            if match and self._topics[topic].msgcount:
                streams.setdefault((int(match[1]), match[3]), topic.removesuffix("/image/data"))
        times = self._index([f"{topic}/image/data" for topic in streams.values()])
        devices = sorted(device for device, kind in streams if kind == "Depth")
        if not devices:
            raise self._refusal("it holds no depth images (a topic such as /device_0/sensor_0/Depth_0/image/data)")
        return [self._camera(device, streams, times) for device in devices]

    def _index(self, topics: list[str]) -> dict[str, list[tuple[int, float]]]:
        """Return per topic when each image was recorded (ns) and its own time stamp (s)."""
        connections = [self._topics[topic] for topic in topics]
        times: dict[str, list[tuple[int, float]]] = {topic: [] for topic in topics}
        total = sum(connection.msgcount for connection in connections)
        for count, (connection, recorded_ns, raw) in enumerate(self._messages(connections), start=1):
            _, seconds, nanoseconds = struct.unpack_from("<3I", raw)
            times[connection.topic].append((recorded_ns, seconds + nanoseconds * 1e-9))
            if self._progress is not None and (count % 64 == 0 or count == total):
                self._progress(count / total, f"indexing {self._path.name}: image {count} of {total}")
        return times

    def _camera(
        self, device: int, streams: dict[tuple[int, str], str], times: dict[str, list[tuple[int, float]]]
    ) -> Camera:
        depth = self._stream(device, streams[device, "Depth"], times)
        names = {message.key: message.value for message in self._all(f"/device_{device}/info")}
        info = DepthCamera(
            model=names.get("Name", "unknown"),
            serial=names.get("Serial Number", ""),
            intrinsics=depth.intrinsics,
            depth_unit_m=self._depth_unit_m(depth),
        )
        if (device, "Color") not in streams:
            return Camera(info, depth, None, rigid_transform(np.eye(4)))
        color = self._stream(device, streams[device, "Color"], times)
        return Camera(info, depth, color, self._pose(color, depth))

    def _stream(self, device: int, topic: str, times: dict[str, list[tuple[int, float]]]) -> Stream:
        connection = self._topics[f"{topic}/image/data"]
        recorded_ns, stamps_s = zip(*times[connection.topic], strict=True)
        clocks = (
            message.value for message in self._all(f"{topic}/image/metadata") if message.key == "timestamp_domain"
        )
        _, _, information = next(self._messages([self._connection(f"{topic}/info")]))
        return Stream(
            topic=topic,
            device=device,
            intrinsics=self._intrinsics(topic),
            rate_hz=float(struct.unpack_from("<I", information)[0]),
            clock=next(clocks, ""),
            stamps_s=np.array(stamps_s),
            recorded_s=np.array(recorded_ns) * 1e-9,
            _connection=connection,
            _recorded_ns=list(recorded_ns),
        )

    def _intrinsics(self, topic: str) -> Intrinsics:
        message = self._first(f"{topic}/info/camera_info")
        try:
            return Intrinsics(
                width=message.width,
                height=message.height,
                fx=message.K[0],
                fy=message.K[4],
                cx=message.K[2],
                cy=message.K[5],
                distortion=Distortion(message.distortion_model.lower().replace(" ", "_")),
                coefficients=tuple(message.D),
            )
        except ValidationError as error:
            field = ".".join(str(part) for part in error.errors()[0]["loc"])
            raise self._refusal(f"{topic}: {field} of the lens is out of range") from error
        except ValueError as error:
            known = ", ".join(Distortion)
            raise self._refusal(
                f"{topic} has the lens model {message.distortion_model!r}; known are {known}"
            ) from error

    def _depth_unit_m(self, depth: Stream) -> float:
        sensor = "/".join(depth.topic.split("/")[:3])
        for spelling in ("Depth Units", "Depth_Units"):
            topic = f"{sensor}/option/{spelling}/value"
            if topic in self._topics:
                unit_m = float(self._first(topic).data)
                if not 0.0 < unit_m <= 1.0:
                    raise self._refusal(f"the depth unit is {unit_m} m, but it must be above 0 and at most 1")
                return unit_m
        raise self._refusal(f"the depth unit is missing (topic {sensor}/option/Depth_Units/value)")

    def _pose(self, color: Stream, depth: Stream) -> Matrix4:
        """Take depth coordinates to colour coordinates by way of the reference that both name."""
        common = self._reference_frames(color) & self._reference_frames(depth)
        if not common:
            raise self._refusal(f"the pose of {color.topic} to {depth.topic} is missing (topics such as …/tf/0)")
        reference = min(common)
        T_color_reference, T_depth_reference = (
            _matrix(self._first(f"{stream.topic}/tf/{reference}")) for stream in (color, depth)
        )
        return rigid_transform(T_color_reference @ np.linalg.inv(T_depth_reference))

    def _reference_frames(self, stream: Stream) -> set[str]:
        prefix = f"{stream.topic}/tf/"
        return {topic.removeprefix(prefix) for topic in self._topics if topic.startswith(prefix)}

    def _image(self, stream: Stream, index: int) -> Any:
        """Return image message ``index`` of a stream."""
        if not self._is_open:
            raise SourceError(f"{self._path} is closed; open it again")
        recorded_ns = stream._recorded_ns[index]
        before = index - bisect_left(stream._recorded_ns, recorded_ns)
        with self._damage_told():
            messages = self._messages([stream._connection], recorded_ns)
            for _ in range(before):
                next(messages)
            return self._decode(next(messages))

    def _rows(self, stream: Stream, message: Any, bytes_per_pixel: int) -> npt.NDArray[np.uint8]:
        """Return the image's bytes, shape (H, W * bytes per pixel), padding cut off."""
        height, width = stream.intrinsics.shape
        if (message.height, message.width) != (height, width):
            raise self._refusal(
                f"{stream.topic} has an image of {message.width} x {message.height} pixels, "
                f"but its lens is said to have {width} x {height}"
            )
        if message.step < width * bytes_per_pixel or len(message.data) != height * message.step:
            raise self._refusal(f"{stream.topic} has an image of {len(message.data)} bytes, too few for its size")
        rows = message.data.reshape(height, message.step)[:, : width * bytes_per_pixel]
        return np.ascontiguousarray(rows)

    def _connection(self, topic: str) -> Connection:
        if topic not in self._topics or not self._topics[topic].msgcount:
            raise self._refusal(f"the topic {topic} is missing")
        return self._topics[topic]

    def _first(self, topic: str) -> Any:
        return self._decode(next(self._messages([self._connection(topic)])))

    def _all(self, topic: str) -> Iterator[Any]:
        if topic in self._topics:
            yield from map(self._decode, self._messages([self._topics[topic]]))

    def _messages(
        self, connections: list[Connection], start_ns: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        if connections:
            yield from self._reader.messages(connections, start=start_ns)

    def _decode(self, message: tuple[Connection, int, bytes]) -> Any:
        connection, _, raw = message
        return _TYPES.deserialize_ros1(raw, connection.msgtype)

    def _refusal(self, what: str) -> SourceError:
        return SourceError(f"{self._path}: {what}; record it again with the RealSense viewer or rs-record")

    @contextmanager
    def _damage_told(self) -> Iterator[None]:
        """Turn whatever the library meets in a damaged file into one sentence.

        The library checks with assertions and lets errors of struct, lz4 and others through, so no
        shorter list of exceptions would do.
        """
        try:
            yield
        except SourceError:
            raise
        except Exception as error:
            detail = " ".join(str(error).split()) or type(error).__name__
            raise SourceError(f"{self._path} is no readable ROS 1 bag ({detail}); copy or record it again") from error


def _matrix(transform: Any) -> Float64Array:
    """Return the 4 x 4 matrix of a ROS transform, its quaternion normalised."""
    q, t = transform.rotation, transform.translation
    x, y, z, w = np.array([q.x, q.y, q.z, q.w]) / np.linalg.norm([q.x, q.y, q.z, q.w])
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), t.x],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), t.y],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), t.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
