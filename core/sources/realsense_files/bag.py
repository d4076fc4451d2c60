"""ROS 1 bags as librealsense writes them up to 2.57."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache
from io import BytesIO
from threading import Lock
from typing import Any, Final

import numpy as np
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.rosbag1.reader import Header, IndexData, RecordType, read_uint32
from rosbags.typesys import Stores, get_typestore

from ..mcap.messages import matrix_of
from ..ros_image import DamagedFileError, RawImage
from .recording import ImageTime, RecordingFile, Stream, make_stream, milliseconds

_CACHED_CHUNKS: Final = 4
_STORE = get_typestore(Stores.ROS1_NOETIC)


class BagFile(RecordingFile):
    """An open ``.bag``, read without the camera driver."""

    _reader: Reader | None = None

    def _open(self) -> Collection[str]:
        self._lock = Lock()
        self._chunk = lru_cache(_CACHED_CHUNKS)(self._unpack)
        self._reader = Reader(self.path)
        try:
            self._reader.open()
        except ReaderError:
            self.is_complete = False
            self._reader = _Unfinished(self.path)
            self._reader.open()
        self._types: dict[str, str] = {}
        self._entries: defaultdict[str, list[IndexData]] = defaultdict(list)
        for each in self._reader.connections:  # a merged bag has several of one topic
            if each.msgcount:
                self._types[each.topic] = each.msgtype
                self._entries[each.topic] += self._reader.indexes[each.id]
        for entries in self._entries.values():
            entries.sort()
        return self._types

    def close(self) -> None:
        if self._reader is not None and self._reader.bio is not None:
            self._reader.close()

    def _names(self, topic: str) -> Mapping[str, str]:
        return dict(_key_value(self._message(entry)) for entry in self._entries[topic])

    def _depth_unit_m(self, sensor: str) -> float | None:
        options = [f"{sensor}/option/{words}/value" for words in ("Depth Units", "Depth_Units")]
        return next((float(self._first(option).data) for option in options if option in self._types), None)

    def _stream(self, topic: str, images: str, times: Sequence[ImageTime]) -> Stream:
        info = self._entries[f"{topic}/info"]
        if not info:
            raise DamagedFileError(f"the topic {topic}/info is missing")
        (rate_hz,) = struct.unpack_from("<I", self._message(info[0]))
        lens: Any = self._first(f"{topic}/info/camera_info")
        fx, _, cx, _, fy, cy, *_ = lens.K
        prefix, entries = f"{topic}/tf/", self._entries[images]
        poses = [name for name in self._types if name.startswith(prefix)]
        return make_stream(
            topic,
            {"width": lens.width, "height": lens.height, "fx": fx, "fy": fy, "cx": cx, "cy": cy},
            lens.distortion_model,
            lens.D,
            float(rate_hz),
            times,
            {name.removeprefix(prefix): matrix_of(self._first(name)) for name in poses},
            lambda index: _image(self._message(entries[index])),
        )

    def _times(self, topics: Collection[tuple[str, str]]) -> Mapping[str, list[ImageTime]]:
        """Read the time stamp, clock and arrival of every image, in the order of the file."""
        stamps_s: dict[IndexData, float] = {}
        facts: defaultdict[tuple[str, int], dict[str, str]] = defaultdict(dict)
        wanted = [(entry, topic, True) for topic, images in topics for entry in self._entries[images]]
        wanted += [(entry, topic, False) for topic, _ in topics for entry in self._entries[f"{topic}/image/metadata"]]
        wanted.sort(key=lambda each: each[0].chunk_pos)
        for done, (entry, topic, is_image) in enumerate(wanted):
            message = self._message(entry)
            if is_image:
                seconds, nanoseconds = struct.unpack_from("<II", message, 4)
                stamps_s[entry] = seconds + nanoseconds * 1e-9
            else:  # cameras write two dozen facts for every image
                key, value = _key_value(message)
                facts[topic, entry.time][key] = value
            if self.progress is not None and done % 1000 == 0:
                self.progress(done / len(wanted), f"indexing {self.path.name}")
        times: dict[str, list[ImageTime]] = {}
        for topic, images in topics:
            times[topic] = []
            for entry in self._entries[images]:
                known = facts[topic, entry.time]
                clock, arrived_ms = known.get("timestamp_domain", ""), milliseconds(known.get("system_time", ""))
                times[topic].append(ImageTime(entry.time, stamps_s[entry], clock, arrived_ms))
        return times

    def _first(self, topic: str) -> Any:
        if topic not in self._types:
            raise DamagedFileError(f"the topic {topic} is missing")
        return _STORE.deserialize_ros1(bytes(self._message(self._entries[topic][0])), self._types[topic])

    def _message(self, entry: IndexData) -> memoryview:
        """Return a message; the index may point to the connection in front of it."""
        chunk, offset = self._chunk(entry.chunk_pos), entry.offset
        while True:
            (head,) = struct.unpack_from("<I", chunk, offset)
            start = offset + 8 + head
            (size,) = struct.unpack_from("<I", chunk, start - 4)
            if start + size > len(chunk):
                raise DamagedFileError("a message reaches beyond its chunk")
            if b"op=\x02" in chunk[offset:start]:
                return memoryview(chunk)[start : start + size]
            offset = start + size

    def _unpack(self, place: int) -> bytes:
        assert self._reader is not None
        packed = self._reader.chunks[place]
        with self._lock:
            file: Any = self._reader.bio
            file.seek(packed.datapos)
            data = file.read(packed.datasize)
        return packed.decompressor(data)


class _Unfinished(Reader):
    """A bag that was killed or cut off, so that it has no index: one is made from its complete chunks."""

    def open(self) -> None:
        size = self.path.stat().st_size
        self.bio = file = self.path.open("rb")
        file.readline()
        Header.read(file)
        file.seek(read_uint32(file), 1)
        found: defaultdict[int, list[IndexData]] = defaultdict(list)
        names: dict[int, Any] = {}
        while True:
            place = file.tell()
            try:
                kind = Header.read(file).get_uint8("op")
                length = read_uint32(file)
            except Exception:  # the end, or damage
                break
            start = file.tell()
            if start + length > size or kind not in (RecordType.CHUNK, RecordType.IDXDATA):
                break
            if kind == RecordType.CHUNK:
                file.seek(place)
                self.chunks[place] = self.read_chunk()
                file.seek(start)
                self._walk(place, self.chunks[place].decompressor(file.read(length)), found, names)
            file.seek(start + length)
        self.indexes = {number: sorted(entries) for number, entries in found.items() if number in names}
        self.connections = [names[number]._replace(msgcount=len(self.indexes[number])) for number in self.indexes]

    def _walk(self, place: int, chunk: bytes, found: dict[int, list[IndexData]], names: dict[int, Any]) -> None:
        """Add the messages and the connections in a chunk."""
        inside = Reader(self.path)  # it reads connections from the chunk
        inside.bio = BytesIO(chunk)
        while (offset := inside.bio.tell()) < len(chunk):
            head = Header.read(inside.bio)
            if head.get_uint8("op") == RecordType.CONNECTION:
                inside.bio.seek(offset)
                connection = inside.read_connection()
                names[connection.id] = connection
            else:
                inside.bio.seek(read_uint32(inside.bio), 1)
                found[head.get_uint32("conn")].append(IndexData(head.get_time("time"), place, offset))


def _text(message: memoryview, at: int) -> tuple[str, int]:
    """Return a text in a message, and where it ends."""
    (length,) = struct.unpack_from("<I", message, at)
    end = at + 4 + length
    return bytes(message[at + 4 : end]).decode(errors="replace"), end


def _key_value(message: memoryview) -> tuple[str, str]:
    key, at = _text(message, 0)
    return key, _text(message, at)[0]


def _image(message: memoryview) -> RawImage:
    """Return a ``sensor_msgs/Image``; some versions append a list of metadata, which the library does not accept."""
    _, at = _text(message, 12)
    height, width = struct.unpack_from("<II", message, at)
    encoding, at = _text(message, at + 8)
    big_endian, step, size = struct.unpack_from("<BII", message, at)
    at += 9
    if size > len(message) - at:
        raise DamagedFileError(f"it has {len(message) - at} bytes, too few for its size")
    return RawImage(height, width, encoding, bool(big_endian), step, np.frombuffer(message, np.uint8, size, at))
