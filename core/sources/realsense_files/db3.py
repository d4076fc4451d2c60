"""RealSense recordings in ``.db3`` files, as librealsense writes them from 2.58 on.

Such a file is the SQLite database of a ROS 2 bag. Its descriptions are strings of ``key=value;``.
2.58 compresses every message with zstd and keeps images raw; 2.59 keeps images as PNG.
"""

from __future__ import annotations

import re
import sqlite3
import sys
from collections.abc import Collection, Mapping, Sequence
from threading import Lock
from typing import Any, Final

import numpy as np

from ...model.arrays import Float64Array
from ...model.loading import decode_image
from ..mcap.messages import IMAGE, TEXT, TYPES
from ..ros_image import DamagedFileError, RawImage
from .recording import ImageTime, RecordingFile, Stream, make_stream, milliseconds

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

#: How 2.59 describes images that it cannot write as PNG.
_ZSTD_LAYOUT = re.compile(r"(\w+); zstd; (\d{1,6})x(\d{1,6}) step=(\d{1,9})")
_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
_DEPTH_PNG_START: Final = 12  # compressed_depth_image_transport puts its settings in front
#: How OpenCV decodes PNG images: type and number of channels.
_PNG_ENCODINGS: Final = {("uint16", 1): "16UC1", ("uint8", 1): "mono8", ("uint8", 3): "bgr8", ("uint8", 4): "bgra8"}
#: A message unpacks to at most this; one image takes 3 MB.
_MAX_BYTES: Final = 128 * 2**20


class Db3File(RecordingFile):
    """An open ``.db3``, read without the camera driver."""

    _database: sqlite3.Connection | None = None

    def _open(self) -> Collection[str]:
        uri = self.path.resolve().as_uri() + "?mode=ro&immutable=1"
        self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        self._lock = Lock()
        used = "SELECT name, id FROM topics WHERE id IN (SELECT DISTINCT topic_id FROM messages)"
        self._ids: dict[str, int] = dict(self._select(used))
        return self._ids

    def close(self) -> None:
        if self._database is not None:
            self._database.close()

    def _names(self, topic: str) -> dict[str, str]:
        """Return the merged key-value pairs of all messages of a string topic."""
        facts: dict[str, str] = {}
        for _, row in self._rows(topic):
            facts |= self._pairs(row)
        return facts

    def _depth_unit_m(self, sensor: str) -> float | None:
        unit = self._names(f"{sensor}/option/Depth_Units/value")
        return _numbers({"unit": next(iter(unit))}, "unit")[0] if unit else None

    def _stream(self, topic: str, images: str, times: Sequence[ImageTime]) -> Stream:
        info, lens = self._names(f"{topic}/info"), self._names(f"{topic}/camera_info")
        for name, found in (("info", info), ("camera_info", lens)):
            if not found:
                raise DamagedFileError(f"the topic {topic}/{name} is missing")
        keys = {"width": "width", "height": "height", "fx": "fx", "fy": "fy", "cx": "ppx", "cy": "ppy"}
        prefix, rows = f"{topic}/tf/", self._rows(images)
        return make_stream(
            topic,
            {key: _numbers(lens, theirs)[0] for key, theirs in keys.items()},
            lens.get("model", ""),
            _numbers(lens, "coeffs"),
            _numbers(info, "fps")[0],
            times,
            {name.removeprefix(prefix): _matrix(self._names(name)) for name in self._ids if name.startswith(prefix)},
            lambda index: self._image(rows[index][1], images),
        )

    def _times(self, topics: Collection[tuple[str, str]]) -> Mapping[str, list[ImageTime]]:
        times: dict[str, list[ImageTime]] = {}
        for done, (topic, images) in enumerate(topics, start=1):
            metadata = {time_ns: self._pairs(row) for time_ns, row in self._rows(f"{topic}/image/metadata")}
            times[topic] = []
            for time_ns, _ in self._rows(images):
                facts = metadata.get(time_ns, {})
                if "timestamp" not in facts:
                    raise DamagedFileError(f"an image of {topic} has no time stamp")
                stamp_s, arrived_ms = (
                    milliseconds(facts["timestamp"]) * 1e-3,
                    milliseconds(facts.get("system_time", "")),
                )
                times[topic].append(ImageTime(time_ns, stamp_s, facts.get("timestamp_domain", ""), arrived_ms))
            if self.progress is not None:
                self.progress(done / len(topics), f"indexing {self.path.name}: stream {done} of {len(topics)}")
        return times

    def _image(self, row: int, topic: str) -> RawImage:
        data = self._message(row)
        if topic.endswith("/image/data"):
            return RawImage.of(TYPES.deserialize_cdr(data, IMAGE))
        found: Any = TYPES.deserialize_cdr(data, "sensor_msgs/msg/CompressedImage")
        layout = _ZSTD_LAYOUT.fullmatch(found.format)
        if layout is not None:
            raw = np.frombuffer(_unpacked(found.data.tobytes()), np.uint8)
            return RawImage(int(layout[3]), int(layout[2]), layout[1], False, int(layout[4]), raw)
        return _png(found.data[_DEPTH_PNG_START if topic.endswith("Depth") else 0 :].tobytes())

    def _pairs(self, row: int) -> dict[str, str]:
        """Return the ``key=value;key=value`` of a message; a part without a value is a key with an empty value."""
        message: Any = TYPES.deserialize_cdr(self._message(row), TEXT)
        return {key: value for key, _, value in (part.partition("=") for part in message.data.split(";")) if key}

    def _rows(self, topic: str) -> list[tuple[int, int]]:
        """Return time in ns and row of a topic's messages, sorted by time."""
        query = "SELECT timestamp, id FROM messages WHERE topic_id = ? ORDER BY timestamp, id"
        return [(int(time_ns), int(row)) for time_ns, row in self._select(query, self._ids.get(topic, -1))]

    def _message(self, row: int) -> bytes:
        found = self._select("SELECT data FROM messages WHERE id = ?", row)
        if not found or not isinstance(found[0][0], bytes):
            raise DamagedFileError(f"message {row} is missing")
        return _unpacked(found[0][0]) if found[0][0].startswith(_ZSTD_MAGIC) else found[0][0]

    def _select(self, query: str, *values: int) -> list[tuple[Any, ...]]:
        assert self._database is not None
        with self._lock:
            return self._database.execute(query, values).fetchall()


def _unpacked(data: bytes) -> bytes:
    size = zstd.get_frame_info(data).decompressed_size
    if size is None or size > _MAX_BYTES:
        raise DamagedFileError(f"a part of it claims {size} bytes, more than any camera writes")
    return zstd.decompress(data)


def _png(data: bytes) -> RawImage:
    image = decode_image(data)
    height, width = image.shape[:2]
    encoding = _PNG_ENCODINGS.get((image.dtype.name, image.size // (height * width)))
    if encoding is None:
        raise DamagedFileError(f"it is a PNG of the shape {image.shape} and type {image.dtype}")
    rows = np.ascontiguousarray(image).reshape(-1).view(np.uint8)
    return RawImage(height, width, encoding, False, len(rows) // height, rows)


def _numbers(facts: Mapping[str, str], key: str) -> tuple[float, ...]:
    """Return the comma-separated numbers of a field, at the precision of the cameras."""
    text = facts.get(key, "")
    try:
        return tuple(float(np.float32(float(part))) for part in text.split(","))
    except ValueError as error:
        raise DamagedFileError(f"{key} is {text[:40]!r}, which is no number") from error


def _matrix(facts: Mapping[str, str]) -> Float64Array:
    """Return the 4 x 4 matrix of a pose; its rotation is written column by column."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(_numbers(facts, "rotation"), (3, 3)).T
    matrix[:3, 3] = _numbers(facts, "translation")
    return matrix
