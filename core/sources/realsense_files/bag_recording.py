"""RealSense recordings in ROS 1 bags, as librealsense writes them up to 2.57."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ...model.arrays import Float64Array, Int64Array, Uint8Array, Uint16Array
from ..ros_image import DamagedFileError, RawImage
from .decoding import Cursor
from .recording import ImageTimes, Lens, Recording, Stream, milliseconds
from .ros1_bag import Ros1Bag, Topic, message_bounds

_STREAM_TOPIC = re.compile(r"/device_(\d{1,4})/sensor_(\d{1,4})/(Depth|Color)_\d{1,4}/image/data")
_CLOCK_KEY, _ARRIVAL_KEY = b"timestamp_domain", b"system_time"
_LONGEST_METADATA = 1024


class BagRecording(Recording):
    """A RealSense ``.bag``, read without the camera driver."""

    _bag: Ros1Bag | None = None

    def _open(self) -> None:
        self._bag = Ros1Bag(self.path)
        self._topics = self._bag.topics
        self.is_complete = self._bag.is_complete

    def _close(self) -> None:
        if self._bag is not None:
            self._bag.close()

    def _streams(self) -> dict[tuple[int, str], str]:
        streams: dict[tuple[int, str], str] = {}
        for topic in sorted(self._topics):
            if match := _STREAM_TOPIC.fullmatch(topic):
                streams.setdefault((int(match[1]), match[3]), topic.removesuffix("/image/data"))
        return streams

    def _times(self, topics: Sequence[str]) -> Mapping[str, ImageTimes]:
        return _Indexing(self._bag_open(), topics, self._tell).run()

    def _tell(self, share: float, words: str) -> None:
        if self._progress is not None:
            self._progress(share, f"indexing {self.path.name}: {words}")

    def _device_info(self, device: int) -> Mapping[str, str]:
        topic = self._topics.get(f"/device_{device}/info")
        if topic is None:
            return {}
        cursors = [Cursor(self._bag_open().message(topic, index)) for index in range(len(topic))]
        return {cursor.text(): cursor.text() for cursor in cursors}

    def _rate_hz(self, topic: str) -> float:
        return float(Cursor(self._first(f"{topic}/info")).u32())

    def _lens(self, topic: str) -> Lens:
        cursor = Cursor(self._first(f"{topic}/info/camera_info"))
        _skip_header(cursor)
        height, width, model = cursor.u32(), cursor.u32(), cursor.text()
        coefficient_count = cursor.u32()
        coefficients = cursor.f64s(min(coefficient_count, 16))
        fx, _, cx, _, fy, cy = cursor.f64s(6)
        return Lens(width, height, fx, fy, cx, cy, model, coefficients)

    def _depth_unit_m(self, sensor: str) -> float | None:
        for spelling in ("Depth Units", "Depth_Units"):
            topic = f"{sensor}/option/{spelling}/value"
            if topic in self._topics:
                return Cursor(self._first(topic)).f32()
        return None

    def _poses(self, topic: str) -> Mapping[str, Float64Array]:
        prefix = f"{topic}/tf/"
        names = [name for name in self._topics if name.startswith(prefix)]
        return {name.removeprefix(prefix): _matrix(Cursor(self._first(name)).f64s(7)) for name in names}

    def _depth_image(self, stream: Stream, index: int) -> Uint16Array:
        return self._image(stream, index).depth(stream.intrinsics.shape)

    def _color_image(self, stream: Stream, index: int) -> Uint8Array:
        return self._image(stream, index).color(stream.intrinsics.shape)

    def _image(self, stream: Stream, index: int) -> RawImage:
        topic = self._topics[f"{stream.topic}/image/data"]
        cursor = Cursor(self._bag_open().message(topic, index))
        _skip_header(cursor)
        # Some versions append a list of metadata, so bytes may be left at the end.
        return RawImage(
            height=cursor.u32(),
            width=cursor.u32(),
            encoding=cursor.text(),
            big_endian=bool(cursor.u8()),
            step=cursor.u32(),
            data=cursor.bytes(),
        )

    def _first(self, topic: str) -> bytes:
        if topic not in self._topics:
            raise self._refusal(f"the topic {topic} is missing")
        return self._bag_open().message(self._topics[topic], 0)

    def _bag_open(self) -> Ros1Bag:
        assert self._bag is not None
        return self._bag


class _Indexing:
    """One pass over the chunks that gathers every image's time stamp, clock and arrival; no image is decoded."""

    def __init__(self, bag: Ros1Bag, topics: Sequence[str], tell: Callable[[float, str], None]) -> None:
        self._bag = bag
        self._tell = tell
        self._topics = {name: bag.topics[f"{name}/image/data"] for name in topics}
        self._stamps_s = {name: np.zeros(len(topic)) for name, topic in self._topics.items()}
        self._clocks: dict[str, dict[int, str]] = {name: {} for name in topics}
        self._arrivals_ms: dict[str, dict[int, float]] = {name: {} for name in topics}
        #: By chunk: stream, index of the image or None for metadata, when it was written, offset.
        self._wanted: dict[int, list[tuple[str, int | None, int, int]]] = {}
        for name, topic in self._topics.items():
            self._want(name, topic, are_images=True)
            metadata = bag.topics.get(f"{name}/image/metadata")
            if metadata is not None:
                self._want(name, metadata, are_images=False)

    def run(self) -> Mapping[str, ImageTimes]:
        """Read every chunk once."""
        total = sum(map(len, self._topics.values()))
        count = 0
        for images in self._bag.map_chunks(sorted(self._wanted), self._read_chunk):
            count += images
            if images:
                self._tell(count / total, f"image {count} of {total}")
        return {name: self._result(name, topic.times_ns) for name, topic in self._topics.items()}

    def _want(self, name: str, topic: Topic, are_images: bool) -> None:
        places = zip(topic.times_ns.tolist(), topic.chunks.tolist(), topic.offsets.tolist(), strict=True)
        for index, (time_ns, chunk, offset) in enumerate(places):
            self._wanted.setdefault(chunk, []).append((name, index if are_images else None, time_ns, offset))

    def _read_chunk(self, number: int, chunk: bytes) -> int:
        """Read the wanted messages of a chunk and return its number of images."""
        images = 0
        for name, index, time_ns, offset in self._wanted[number]:
            start, size = message_bounds(chunk, offset)
            if index is None:
                self._read_metadata(name, time_ns, chunk[start : start + min(size, _LONGEST_METADATA)])
                continue
            if size < 12:
                raise DamagedFileError("an image has no time stamp")
            seconds, nanoseconds = struct.unpack_from("<II", chunk, start + 4)
            self._stamps_s[name][index] = seconds + nanoseconds * 1e-9
            images += 1
        return images

    def _read_metadata(self, name: str, time_ns: int, message: bytes) -> None:
        # Cameras write two dozen of these for every image, so others are skipped quickly.
        if message.startswith((_CLOCK_KEY, _ARRIVAL_KEY), 4):
            cursor = Cursor(message)
            key, value = cursor.text(), cursor.text()
            if key == _CLOCK_KEY.decode():
                self._clocks[name][time_ns] = value
            else:
                self._arrivals_ms[name][time_ns] = milliseconds(value)

    def _result(self, name: str, times_ns: Int64Array) -> ImageTimes:
        keys = times_ns.tolist()
        clocks, arrivals_ms = self._clocks[name], self._arrivals_ms[name]
        return ImageTimes(
            recorded_ns=times_ns,
            stamps_s=self._stamps_s[name],
            clocks=[clocks.get(key, "") for key in keys],
            arrived_ms=np.array([arrivals_ms.get(key, 0.0) for key in keys]),
        )


def _skip_header(cursor: Cursor) -> None:
    """Skip a ``std_msgs/Header``: number, seconds, nanoseconds, name of the frame."""
    cursor.take(12)
    cursor.text()


def _matrix(translation_and_quaternion: tuple[float, ...]) -> Float64Array:
    """Return the 4 x 4 matrix of a ROS transform, its quaternion normalised."""
    translation, quaternion = translation_and_quaternion[:3], translation_and_quaternion[3:]
    if not (np.isfinite(translation_and_quaternion).all() and np.linalg.norm(quaternion) > 0):
        raise DamagedFileError("a pose is not finite")
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    matrix[:3, 3] = translation
    return matrix
