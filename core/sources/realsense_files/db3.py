"""RealSense recordings in ``.db3`` files, as librealsense writes them from 2.58 on.

Such a file is the SQLite database of a ROS 2 bag. Its descriptions are strings of ``key=value;``.
2.58 compresses every message with zstd and keeps images raw; 2.59 keeps images as PNG.
"""

from __future__ import annotations

import sqlite3
import sys
from collections.abc import Collection, Mapping
from threading import Lock
from typing import Any, Final

import numpy as np

from ...model.arrays import Float64Array
from ...model.loading import decode_image
from ..mcap.messages import IMAGE, TEXT, TYPES
from ..ros_image import DamagedFileError, RawImage
from .recording import RecordingFile, Times

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
_DEPTH_PNG_START: Final = 12  # compressed_depth_image_transport puts its settings in front
#: How OpenCV decodes PNG images: type and number of channels.
_PNG_ENCODINGS: Final = {("uint16", 1): "16UC1", ("uint8", 1): "mono8", ("uint8", 3): "bgr8", ("uint8", 4): "bgra8"}


class Db3File(RecordingFile):
    """An open ``.db3``, read without the camera driver."""

    _database: sqlite3.Connection | None = None

    def _open(self) -> Collection[str]:
        uri = self.path.resolve().as_uri() + "?mode=ro&immutable=1"
        self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        self._lock = Lock()
        self._images: dict[str, list[int]] = {}
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

    def _lens(self, topic: str) -> tuple[dict[str, Any], float]:
        info, lens = self._names(f"{topic}/info"), self._names(f"{topic}/camera_info")
        keys = {"width": "width", "height": "height", "fx": "fx", "fy": "fy", "cx": "ppx", "cy": "ppy"}
        values: dict[str, Any] = {key: _numbers(lens, theirs)[0] for key, theirs in keys.items()}
        values |= {"distortion": lens.get("model", ""), "coefficients": _numbers(lens, "coeffs")}
        return values, _numbers(info, "fps")[0]

    def _pose(self, topic: str) -> Float64Array:
        """Its rotation is written column by column."""
        facts, matrix = self._names(topic), np.eye(4)
        matrix[:3, :3] = np.reshape(_numbers(facts, "rotation"), (3, 3)).T
        matrix[:3, 3] = _numbers(facts, "translation")
        return matrix

    def _times(self, topics: Collection[tuple[str, str]]) -> Mapping[str, Times]:
        times: dict[str, Times] = {}
        for done, (topic, images) in enumerate(topics, start=1):
            facts = {time_ns: self._pairs(row) for time_ns, row in self._rows(f"{topic}/image/metadata")}
            recorded_ns = [time_ns for time_ns, _ in self._rows(images)]
            self._images[images] = [row for _, row in self._rows(images)]
            stamps_s = [float(facts.get(time_ns, {}).get("timestamp", "nan")) * 1e-3 for time_ns in recorded_ns]
            if not np.isfinite(stamps_s).all():
                raise DamagedFileError(f"an image of {topic} has no time stamp")
            times[topic] = Times(recorded_ns, stamps_s, facts[recorded_ns[-1]].get("timestamp_domain", ""))
            if self.progress is not None:
                self.progress(done / len(topics), f"indexing {self.path.name}: stream {done} of {len(topics)}")
        return times

    def _image(self, topic: str, index: int) -> RawImage:
        data = self._message(self._images[topic][index])
        if topic.endswith("/image/data"):
            return RawImage.of(TYPES.deserialize_cdr(data, IMAGE))
        found: Any = TYPES.deserialize_cdr(data, "sensor_msgs/msg/CompressedImage")
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
        return zstd.decompress(found[0][0]) if found[0][0].startswith(_ZSTD_MAGIC) else found[0][0]

    def _select(self, query: str, *values: int) -> list[tuple[Any, ...]]:
        assert self._database is not None
        with self._lock:
            return self._database.execute(query, values).fetchall()


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
