"""ROS 1 bags as librealsense writes them up to 2.57."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Collection, Mapping
from functools import lru_cache
from io import BytesIO
from threading import Lock
from typing import Any, Final

import numpy as np
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.rosbag1.reader import Header, IndexData, RecordType, read_uint32
from rosbags.typesys import Stores, get_typestore

from ...model.arrays import Float64Array
from ..mcap.messages import matrix_of
from ..ros_image import DamagedFileError, RawImage
from .recording import RecordingFile, Times

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

    def _lens(self, topic: str) -> tuple[dict[str, Any], float]:
        info = self._entries[f"{topic}/info"]
        if not info:
            raise DamagedFileError(f"the topic {topic}/info is missing")
        (rate_hz,) = struct.unpack_from("<I", self._message(info[0]))
        lens: Any = self._first(f"{topic}/info/camera_info")
        fx, _, cx, _, fy, cy, *_ = lens.K
        size = {"width": lens.width, "height": lens.height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
        return {**size, "distortion": lens.distortion_model, "coefficients": lens.D}, float(rate_hz)

    def _pose(self, topic: str) -> Float64Array:
        return matrix_of(self._first(topic))

    def _times(self, topics: Collection[tuple[str, str]]) -> Mapping[str, Times]:
        """Read the stamp of every image, in the order of the file, and the clock of the last one."""
        stamps_s: dict[IndexData, float] = {}
        wanted = sorted((entry.chunk_pos, entry) for _, images in topics for entry in self._entries[images])
        for done, (_, entry) in enumerate(wanted):
            seconds, nanoseconds = struct.unpack_from("<II", self._message(entry), 4)
            stamps_s[entry] = seconds + nanoseconds * 1e-9
            if self.progress is not None and done % 1000 == 0:
                self.progress(done / len(wanted), f"indexing {self.path.name}")
        times: dict[str, Times] = {}
        for topic, images in topics:
            entries, about = self._entries[images], self._entries[f"{topic}/image/metadata"]
            # Cameras write two dozen facts for every image.
            facts = dict(_key_value(self._message(entry)) for entry in about if entry.time == about[-1].time)
            stamps = [stamps_s[entry] for entry in entries]
            times[topic] = Times([entry.time for entry in entries], stamps, facts.get("timestamp_domain", ""))
        return times

    def _image(self, topic: str, index: int) -> RawImage:
        """Some versions append a list of metadata, which the library does not accept."""
        message = self._message(self._entries[topic][index])
        _, at = _text(message, 12)
        height, width = struct.unpack_from("<II", message, at)
        encoding, at = _text(message, at + 8)
        big_endian, step, size = struct.unpack_from("<BII", message, at)
        at += 9
        if size > len(message) - at:
            raise DamagedFileError(f"it has {len(message) - at} bytes, too few for its size")
        return RawImage(height, width, encoding, bool(big_endian), step, np.frombuffer(message, np.uint8, size, at))

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
