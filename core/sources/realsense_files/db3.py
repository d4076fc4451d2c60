"""RealSense recordings in ``.db3`` files, as librealsense writes them from 2.58 on.

Such a file is the SQLite database of a ROS 2 bag. Its descriptions are strings of ``key=value;``.
2.58 compresses every message with zstd and keeps images raw; 2.59 keeps images as PNG.
"""

from __future__ import annotations

import re
import sqlite3
import sys
from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from typing import Any, Final

import numpy as np

from ...model.arrays import Float64Array, Int64Array
from ...model.loading import decode_image
from ..base import Progress
from ..mcap.messages import IMAGE, TEXT, TYPES
from ..ros_image import DamagedFileError, RawImage
from .recording import Camera, ImageTimes, Stream, find_streams, make_camera, make_stream, milliseconds

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
_LARGEST_BYTES: Final = 128 * 2**20


class Db3File:
    """An open ``.db3``, read without the camera driver."""

    is_complete = True

    def __init__(self, path: Path, progress: Progress | None) -> None:
        self.path, self._progress = path, progress
        uri = path.resolve().as_uri() + "?mode=ro&immutable=1"
        self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        self._lock = Lock()
        try:
            used = "SELECT name, id FROM topics WHERE id IN (SELECT DISTINCT topic_id FROM messages)"
            self._ids = dict(self._database.execute(used))
            self.cameras = self._find_cameras()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; twice is harmless."""
        self._database.close()

    def _find_cameras(self) -> list[Camera]:
        streams = find_streams(self._ids)
        numbers = sorted(number for number, kind in streams if kind == "Depth")
        cameras = []
        for done, number in enumerate(numbers, start=1):
            depth, color = streams[number, "Depth"], streams.get((number, "Color"))
            unit = self._facts(f"{depth[0].rpartition('/')[0]}/option/Depth_Units/value")
            cameras.append(
                make_camera(
                    self.path,
                    self._facts(f"/device_{number}/info"),
                    _numbers({"unit": next(iter(unit))}, "unit")[0] if unit else None,
                    self._stream(*depth),
                    None if color is None else self._stream(*color),
                )
            )
            if self._progress is not None:
                self._progress(done / len(numbers), f"indexing {self.path.name}: camera {done} of {len(numbers)}")
        return cameras

    def _stream(self, topic: str, images: str) -> Stream:
        info, lens = self._facts(f"{topic}/info"), self._facts(f"{topic}/camera_info")
        for name, found in (("info", info), ("camera_info", lens)):
            if not found:
                raise DamagedFileError(f"the topic {topic}/{name} is missing")
        width, height, fx, fy, cx, cy = (
            _numbers(lens, key)[0] for key in ("width", "height", "fx", "fy", "ppx", "ppy")
        )
        prefix, rows = f"{topic}/tf/", self._rows(images)
        return make_stream(
            topic,
            (int(width), int(height), fx, fy, cx, cy),
            lens.get("model", ""),
            _numbers(lens, "coeffs"),
            _numbers(info, "fps")[0],
            self._times(topic, rows),
            {name.removeprefix(prefix): _matrix(self._facts(name)) for name in self._ids if name.startswith(prefix)},
            lambda index: self._image(int(rows[index, 1]), images),
        )

    def _times(self, topic: str, rows: Int64Array) -> ImageTimes:
        metadata = {time_ns: _pairs(self._text(row)) for time_ns, row in self._rows(f"{topic}/image/metadata").tolist()}
        facts = [metadata.get(time_ns, {}) for time_ns in rows[:, 0].tolist()]
        if not all("timestamp" in each for each in facts):
            raise DamagedFileError(f"an image of {topic} has no time stamp")
        return ImageTimes(
            recorded_ns=rows[:, 0],
            stamps_s=np.array([milliseconds(each["timestamp"]) * 1e-3 for each in facts]),
            clocks=[each.get("timestamp_domain", "") for each in facts],
            arrived_ms=np.array([milliseconds(each.get("system_time", "")) for each in facts]),
        )

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

    def _facts(self, topic: str) -> dict[str, str]:
        """Return the merged key-value pairs of all messages of a string topic."""
        facts: dict[str, str] = {}
        for row in self._rows(topic)[:, 1].tolist():
            facts |= _pairs(self._text(row))
        return facts

    def _rows(self, topic: str) -> Int64Array:
        """Return time in ns and row of a topic's messages, sorted by time: shape (N, 2)."""
        query = "SELECT timestamp, id FROM messages WHERE topic_id = ? ORDER BY timestamp, id"
        with self._lock:
            rows = self._database.execute(query, (self._ids.get(topic, -1),)).fetchall()
        return np.array(rows, np.int64).reshape(-1, 2)

    def _text(self, row: int) -> str:
        message: Any = TYPES.deserialize_cdr(self._message(row), TEXT)
        return str(message.data)

    def _message(self, row: int) -> bytes:
        with self._lock:
            found = self._database.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchone()
        if found is None or not isinstance(found[0], bytes):
            raise DamagedFileError(f"message {row} is missing")
        return _unpacked(found[0]) if found[0].startswith(_ZSTD_MAGIC) else found[0]


def _unpacked(data: bytes) -> bytes:
    size = zstd.get_frame_info(data).decompressed_size
    if size is None or size > _LARGEST_BYTES:
        raise DamagedFileError(f"a part of it claims {size} bytes, more than any camera writes")
    return zstd.decompress(data)


def _png(data: bytes) -> RawImage:
    """Return a PNG as a raw image."""
    image = decode_image(data)
    height, width = image.shape[:2]
    encoding = _PNG_ENCODINGS.get((image.dtype.name, image.size // (height * width)))
    if encoding is None:
        raise DamagedFileError(f"it is a PNG of the shape {image.shape} and type {image.dtype}")
    rows = np.ascontiguousarray(image).reshape(-1).view(np.uint8)
    return RawImage(height, width, encoding, False, len(rows) // height, rows)


def _pairs(text: str) -> dict[str, str]:
    """Return ``key=value;key=value``; a part without a value is a key with an empty value."""
    return {key: value for key, _, value in (part.partition("=") for part in text.split(";")) if key}


def _numbers(facts: Mapping[str, str], key: str) -> tuple[float, ...]:
    """Return the comma-separated numbers of a field, at the precision of the cameras."""
    text = facts.get(key, "")
    try:
        return tuple(float(np.float32(float(part))) for part in text.split(","))
    except ValueError as error:
        raise DamagedFileError(f"{key} is {text[:40]!r}, which is no number") from error


def _matrix(facts: Mapping[str, str]) -> Float64Array:
    """Return the 4 x 4 matrix of a pose; its rotation is written column by column."""
    rotation, translation = _numbers(facts, "rotation"), _numbers(facts, "translation")
    if len(rotation) != 9 or len(translation) != 3:
        raise DamagedFileError("a pose has not nine and three numbers")
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(rotation, (3, 3)).T
    matrix[:3, 3] = translation
    return matrix
