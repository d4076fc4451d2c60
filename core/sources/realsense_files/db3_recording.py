"""RealSense recordings in ``.db3`` files, as librealsense writes them from 2.58 on.

Such a file is the SQLite database of a ROS 2 bag. Its descriptions are strings of ``key=value;``.
2.58 compresses every message with zstd and keeps images raw; 2.59 keeps images as PNG.
"""

from __future__ import annotations

import re
import sqlite3
import struct
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from threading import Lock
from typing import Any

import numpy as np

from ...model.arrays import Float64Array, Int64Array, Uint8Array, Uint16Array
from ..mcap.messages import IMAGE, TEXT, parse
from ..ros_image import DamagedFileError, RawImage
from .decoding import (
    LARGEST_BYTES,
    check_size,
    png_color,
    png_depth,
)
from .recording import ImageTimes, Lens, Recording, Stream, milliseconds

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAGIC = b"SQLite format 3\x00"
_STREAM_TOPIC = re.compile(
    r"(/device_(\d{1,4})/sensor_(\d{1,4})/(Depth|Color)_\d{1,4})/image/data(?:/compressed|/compressedDepth)?"
)
#: How 2.59 describes images that it cannot write as PNG.
_ZSTD_LAYOUT = re.compile(r"(\w+); zstd; (\d{1,6})x(\d{1,6}) step=(\d{1,9})")
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_DEPTH_PNG_START = 12  # compressed_depth_image_transport puts its settings in front
_LONGEST_TEXT = 2**14
_STEPS_A_CALL = 100_000


class Db3Recording(Recording):
    """A RealSense ``.db3``, read without the camera driver."""

    _database: sqlite3.Connection | None = None

    def _open(self) -> None:
        size = self.path.stat().st_size
        # A row takes at least a few bytes and a few steps: more steps mean that pages form a loop.
        self._steps_allowed = (size // _STEPS_A_CALL + 1) * 10
        with self.path.open("rb") as file:
            head = file.read(100)
        if len(head) < 100:
            raise DamagedFileError(f"it ends at byte {size}")
        page_size, pages = struct.unpack_from(">H", head, 16)[0], struct.unpack_from(">I", head, 28)[0]
        if size < pages * (page_size if page_size > 1 else 65536):
            raise DamagedFileError(f"it ends at byte {size} of {pages * page_size}")
        uri = self.path.resolve().as_uri() + "?mode=ro&immutable=1"
        with _database_told():
            self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
            self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_BYTES)
            self._database.execute("PRAGMA trusted_schema = OFF")
            self._database.execute("PRAGMA cell_size_check = ON")
            self._database.set_progress_handler(self._count_steps, _STEPS_A_CALL)
        self._check_tables()
        self._ids = {
            name: number
            for number, name in self._rows("SELECT id, name FROM topics")
            if isinstance(number, int) and isinstance(name, str)
        }
        self._lock = Lock()
        self._images: dict[str, str] = {}
        self._index: dict[str, Int64Array] = {}

    def _close(self) -> None:
        if self._database is not None:
            self._database.close()

    def _streams(self) -> dict[tuple[int, str], str]:
        streams: dict[tuple[int, str], str] = {}
        for topic in sorted(self._ids):
            match = _STREAM_TOPIC.fullmatch(topic)
            if match and (int(match[2]), match[4]) not in streams:
                index = self._topic_index(topic)
                if len(index):
                    streams[int(match[2]), match[4]] = match[1]
                    self._images[match[1]], self._index[match[1]] = topic, index
        return streams

    def _times(self, topics: Sequence[str]) -> Mapping[str, ImageTimes]:
        times = {}
        for number, topic in enumerate(topics, start=1):
            times[topic] = self._stream_times(topic)
            if self._progress is not None:
                self._progress(number / len(topics), f"indexing {self.path.name}: stream {number} of {len(topics)}")
        return times

    def _stream_times(self, topic: str) -> ImageTimes:
        recorded_ns = self._index[topic][:, 0]
        metadata = {
            int(time_ns): _pairs(self._text(row))
            for time_ns, row in self._topic_index(f"{topic}/image/metadata").tolist()
        }
        stamps_s, clocks, arrived_ms = [], [], []
        for time_ns in recorded_ns.tolist():
            facts = metadata.get(time_ns, {})
            if "timestamp" not in facts:
                raise DamagedFileError(f"an image of {topic} has no time stamp")
            stamps_s.append(milliseconds(facts["timestamp"]) * 1e-3)
            clocks.append(facts.get("timestamp_domain", ""))
            arrived_ms.append(milliseconds(facts.get("system_time", "")))
        return ImageTimes(recorded_ns, np.array(stamps_s), clocks, np.array(arrived_ms))

    def _device_info(self, device: int) -> Mapping[str, str]:
        return self._facts(f"/device_{device}/info")

    def _rate_hz(self, topic: str) -> float:
        return _numbers(self._required(f"{topic}/info"), "fps")[0]

    def _lens(self, topic: str) -> Lens:
        facts = self._required(f"{topic}/camera_info")
        width, height, fx, fy, cx, cy = (
            _numbers(facts, key)[0] for key in ("width", "height", "fx", "fy", "ppx", "ppy")
        )
        return Lens(int(width), int(height), fx, fy, cx, cy, facts.get("model", ""), _numbers(facts, "coeffs"))

    def _depth_unit_m(self, sensor: str) -> float | None:
        facts = self._facts(f"{sensor}/option/Depth_Units/value")
        return _numbers({"unit": next(iter(facts))}, "unit")[0] if facts else None

    def _poses(self, topic: str) -> Mapping[str, Float64Array]:
        prefix = f"{topic}/tf/"
        return {name.removeprefix(prefix): _matrix(self._facts(name)) for name in self._ids if name.startswith(prefix)}

    def _depth_image(self, stream: Stream, index: int) -> Uint16Array:
        image = self._image(stream, index)
        shape = stream.intrinsics.shape
        return image.depth(shape) if isinstance(image, RawImage) else png_depth(image[_DEPTH_PNG_START:], shape)

    def _color_image(self, stream: Stream, index: int) -> Uint8Array:
        image = self._image(stream, index)
        shape = stream.intrinsics.shape
        return image.color(shape) if isinstance(image, RawImage) else png_color(image, shape)

    def _image(self, stream: Stream, index: int) -> RawImage | Uint8Array:
        """Return an image as it is stored: raw, or the bytes of a PNG."""
        row, topic = int(self._index[stream.topic][index, 1]), self._images[stream.topic]
        data = self._message(row, LARGEST_BYTES)
        if topic.endswith("/image/data"):
            return RawImage.of(parse(data, IMAGE, self.path))
        found = parse(data, "sensor_msgs/msg/CompressedImage", self.path)
        layout = _ZSTD_LAYOUT.fullmatch(found.format)
        if layout is None:
            return np.asarray(found.data, np.uint8)
        raw = np.frombuffer(_unpack_zstd(found.data.tobytes(), LARGEST_BYTES), np.uint8)
        return RawImage(int(layout[3]), int(layout[2]), layout[1], False, int(layout[4]), raw)

    def _required(self, topic: str) -> Mapping[str, str]:
        facts = self._facts(topic)
        if not facts:
            raise self._refusal(f"the topic {topic} is missing")
        return facts

    def _facts(self, topic: str) -> dict[str, str]:
        """Return the merged key-value pairs of all messages of a string topic."""
        if topic not in self._ids:
            return {}
        facts: dict[str, str] = {}
        for row in self._topic_index(topic)[:, 1].tolist():
            facts |= _pairs(self._text(row))
        return facts

    def _topic_index(self, topic: str) -> Int64Array:
        """Return time in ns and row of a topic's messages, sorted by time: shape (N, 2)."""
        if topic not in self._ids:
            return np.zeros((0, 2), np.int64)
        query = "SELECT timestamp, rowid FROM messages WHERE topic_id = ? AND typeof(timestamp) = 'integer'"
        numbers: Iterator[Any] = chain.from_iterable(self._rows(query, self._ids[topic]))
        rows = np.fromiter(numbers, np.int64).reshape(-1, 2)
        return rows[np.lexsort(rows.T[::-1])]

    def _text(self, row: int) -> str:
        return str(parse(self._message(row, _LONGEST_TEXT), TEXT, self.path).data)

    def _message(self, row: int, largest: int) -> bytes:
        with self._lock:
            found = list(self._rows("SELECT data FROM messages WHERE rowid = ?", row))
        data = found[0][0] if found else None
        if not isinstance(data, bytes):
            raise DamagedFileError(f"message {row} is missing")
        if data.startswith(_ZSTD_MAGIC):
            data = _unpack_zstd(data, largest)
        check_size(len(data), largest)
        return data

    def _rows(self, query: str, *values: int) -> Iterator[tuple[object, ...]]:
        assert self._database is not None
        self._steps = 0
        with _database_told():
            yield from self._database.execute(query, values)

    def _check_tables(self) -> None:
        """Refuse views and computed columns, which could run any code."""
        query = "SELECT name, type, rootpage FROM sqlite_master WHERE name IN ('topics', 'messages')"
        tables = {name for name, kind, page in self._rows(query) if kind == "table" and page}
        if tables != {"topics", "messages"}:
            raise DamagedFileError("it has no tables of topics and messages")
        columns = [*self._rows("PRAGMA table_xinfo(topics)"), *self._rows("PRAGMA table_xinfo(messages)")]
        if any(column[6] for column in columns):
            raise DamagedFileError("its tables have computed columns")

    def _count_steps(self) -> bool:
        self._steps += 1
        return self._steps > self._steps_allowed


@contextmanager
def _database_told() -> Iterator[None]:
    try:
        yield
    except (sqlite3.Error, OverflowError, TypeError, ValueError) as error:
        raise DamagedFileError(str(error)) from error


def _unpack_zstd(data: bytes, largest: int) -> bytes:
    try:
        size = check_size(zstd.get_frame_info(data).decompressed_size, largest)
        return zstd.ZstdDecompressor().decompress(data, max_length=size)
    except zstd.ZstdError as error:
        raise DamagedFileError(f"a message cannot be decompressed: {error}") from error


def _pairs(text: str) -> dict[str, str]:
    """Return ``key=value;key=value``; a part without a value is a key with an empty value."""
    return {key: value for key, _, value in (part.partition("=") for part in text.split(";")) if key}


def _numbers(facts: Mapping[str, str], key: str) -> tuple[float, ...]:
    """Return the comma-separated numbers of a field, at the precision of the cameras."""
    text = facts.get(key, "")
    try:
        numbers = tuple(float(np.float32(float(part))) for part in text.split(",")[:16] if abs(float(part)) < 1e30)
    except ValueError:
        numbers = ()
    if len(numbers) != min(text.count(",") + 1, 16):
        raise DamagedFileError(f"{key} is {text[:40]!r}, which is no number")
    return numbers


def _matrix(facts: Mapping[str, str]) -> Float64Array:
    """Return the 4 x 4 matrix of a pose; its rotation is written column by column."""
    rotation, translation = _numbers(facts, "rotation"), _numbers(facts, "translation")
    if len(rotation) != 9 or len(translation) != 3:
        raise DamagedFileError("a pose has not nine and three numbers")
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(rotation, (3, 3)).T
    matrix[:3, 3] = translation
    return matrix
