"""ROS 1 bags as librealsense writes them up to 2.57."""

from __future__ import annotations

import struct
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO, Final

import numpy as np
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.rosbag1.reader import Header, IndexData, RecordType, read_uint32
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from ...model.arrays import Float64Array
from ..base import Progress
from ..ros_image import DamagedFileError, RawImage
from .recording import Camera, ImageTimes, Stream, find_streams, make_camera, make_stream, milliseconds

_CACHED_CHUNKS: Final = 4
_INDEXING_THREADS: Final = 4
_CLOCK_KEY, _ARRIVAL_KEY = b"timestamp_domain", b"system_time"

_STORE = get_typestore(Stores.ROS1_NOETIC)
_STORE.register(
    get_types_from_msg("uint32 fps\nstring encoding\nbool is_recommended\n", "realsense_msgs/msg/StreamInfo")
)


class BagFile:
    """An open ``.bag``, read without the camera driver."""

    def __init__(self, path: Path, progress: Progress | None) -> None:
        self.path, self._progress = path, progress
        self.is_complete = True
        self._reader = Reader(path)
        try:
            self._reader.open()
        except ReaderError:
            self.is_complete = False
            self._reader = _Unfinished(path)
            self._reader.open()
        self._topics: dict[str, str] = {}  # type of the messages of each topic
        self._entries: dict[str, list[IndexData]] = {}
        for each in self._reader.connections:  # a merged bag has several of one topic
            if each.msgcount:
                self._topics[each.topic] = each.msgtype
                self._entries.setdefault(each.topic, []).extend(self._reader.indexes[each.id])
        for entries in self._entries.values():
            entries.sort()
        self._lock = Lock()
        self._chunks: OrderedDict[int, bytes] = OrderedDict()
        try:
            self.cameras = self._find_cameras()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; twice is harmless."""
        if self._reader.bio is not None:
            self._reader.close()

    def _find_cameras(self) -> list[Camera]:
        """Return the devices with depth; every image's time stamp is read for this, no image is decoded."""
        streams = find_streams(self._topics)
        numbers = sorted(number for number, kind in streams if kind == "Depth")
        times = self._times([topic for topic, _ in streams.values()]) if numbers else {}
        cameras = []
        for number in numbers:
            topic, color = streams[number, "Depth"][0], streams.get((number, "Color"))
            names = f"/device_{number}/info"
            pairs = [self._parsed(entry, names) for entry in self._index(names)]
            options = [f"{topic.rpartition('/')[0]}/option/{word}/value" for word in ("Depth Units", "Depth_Units")]
            unit = next((float(self._first(name).data) for name in options if name in self._topics), None)
            depth_stream = self._stream(topic, times[topic])
            color_stream = None if color is None else self._stream(color[0], times[color[0]])
            cameras.append(
                make_camera(self.path, {pair.key: pair.value for pair in pairs}, unit, depth_stream, color_stream)
            )
        return cameras

    def _stream(self, topic: str, times: ImageTimes) -> Stream:
        lens: Any = self._first(f"{topic}/info/camera_info")
        prefix, entries = f"{topic}/tf/", self._index(f"{topic}/image/data")
        return make_stream(
            topic,
            (lens.width, lens.height, lens.K[0], lens.K[4], lens.K[2], lens.K[5]),
            lens.distortion_model,
            [float(value) for value in lens.D],
            float(self._first(f"{topic}/info").fps),
            times,
            {name.removeprefix(prefix): _matrix(self._first(name)) for name in self._topics if name.startswith(prefix)},
            lambda index: _image(self._message(entries[index])),
        )

    def _times(self, topics: list[str]) -> dict[str, ImageTimes]:
        """Read the time stamp, clock and arrival of every image, chunk by chunk."""
        wanted: list[tuple[int, str, int | None, IndexData]] = []  # chunk, stream, number of the image, place
        for topic in topics:
            images, metadata = self._index(f"{topic}/image/data"), self._index(f"{topic}/image/metadata")
            wanted += [(entry.chunk_pos, topic, number, entry) for number, entry in enumerate(images)]
            wanted += [(entry.chunk_pos, topic, None, entry) for entry in metadata]
        wanted.sort(key=itemgetter(0))
        groups = [list(group) for _, group in groupby(wanted, itemgetter(0))]
        times_ns = {topic: [entry.time for entry in self._index(f"{topic}/image/data")] for topic in topics}
        stamps_s = {topic: np.zeros(len(times_ns[topic])) for topic in topics}
        clocks: dict[str, dict[int, str]] = {topic: {} for topic in topics}
        arrivals_ms: dict[str, dict[int, float]] = {topic: {} for topic in topics}

        def look(group: list[tuple[int, str, int | None, IndexData]]) -> None:
            chunk = self._unpack(group[0][0])
            for _, topic, number, entry in group:
                message = _message_at(chunk, entry.offset)
                if number is not None:
                    seconds, nanoseconds = struct.unpack_from("<II", message, 4)
                    stamps_s[topic][number] = seconds + nanoseconds * 1e-9
                elif message[4:20] == _CLOCK_KEY:  # cameras write two dozen facts for every image
                    clocks[topic][entry.time] = _key_value(message)
                elif message[4:15] == _ARRIVAL_KEY:
                    arrivals_ms[topic][entry.time] = milliseconds(_key_value(message))

        with ThreadPoolExecutor(_INDEXING_THREADS, thread_name_prefix="bag") as threads:
            for done, _ in enumerate(threads.map(look, groups), start=1):
                if self._progress is not None:
                    words = f"indexing {self.path.name}: part {done} of {len(groups)}"
                    self._progress(done / len(groups), words)
        return {
            topic: ImageTimes(
                recorded_ns=np.array(times_ns[topic], np.int64),
                stamps_s=stamps_s[topic],
                clocks=[clocks[topic].get(time, "") for time in times_ns[topic]],
                arrived_ms=np.array([arrivals_ms[topic].get(time, 0.0) for time in times_ns[topic]]),
            )
            for topic in topics
        }

    def _index(self, topic: str) -> list[IndexData]:
        return self._entries.get(topic, [])

    def _first(self, topic: str) -> Any:
        """Return the first message of a topic."""
        entries = self._index(topic)
        if not entries:
            raise DamagedFileError(f"the topic {topic} is missing")
        return self._parsed(entries[0], topic)

    def _parsed(self, entry: IndexData, topic: str) -> Any:
        return _STORE.deserialize_ros1(bytes(self._message(entry)), self._topics[topic])

    def _message(self, entry: IndexData) -> memoryview:
        with self._lock:
            chunk = self._chunks.get(entry.chunk_pos)
        if chunk is None:
            chunk = self._unpack(entry.chunk_pos)
            with self._lock:
                self._chunks[entry.chunk_pos] = chunk
                if len(self._chunks) > _CACHED_CHUNKS:
                    self._chunks.popitem(last=False)
        return _message_at(chunk, entry.offset)

    def _unpack(self, place: int) -> bytes:
        """Return the records of a chunk. Threads call this: LZ4 releases the interpreter's lock."""
        if self._reader.bio is None:
            raise DamagedFileError("it is closed; open it again")
        packed = self._reader.chunks[place]
        with self._lock:
            self._reader.bio.seek(packed.datapos)
            data = self._reader.bio.read(packed.datasize)
        return packed.decompressor(data)


class _Unfinished(Reader):
    """A bag that was killed or cut off, so that it has no index: one is made from its complete chunks."""

    def open(self) -> None:
        """Read the head of every chunk, and the connections inside."""
        size = self.path.stat().st_size
        self.bio = file = self.path.open("rb")
        try:
            self._index_chunks(file, size)
        except BaseException:
            self.close()
            raise

    def _index_chunks(self, file: BinaryIO, size: int) -> None:
        file.readline()
        Header.read(file)
        file.seek(read_uint32(file), 1)
        found: dict[int, list[IndexData]] = {}
        names: dict[int, Any] = {}
        while True:
            place = file.tell()
            try:
                head = Header.read(file)
                length = read_uint32(file)
                end = file.tell() + length
            except Exception:
                break
            if end > size or head.get_uint8("op") not in (RecordType.CHUNK, RecordType.IDXDATA):
                break
            if head.get_uint8("op") == RecordType.CHUNK:
                file.seek(place)
                self.chunks[place] = self.read_chunk()
                file.seek(end - length)
                self._walk(place, self.chunks[place].decompressor(file.read(length)), found, names)
            file.seek(end)
        self.indexes = {number: sorted(entries) for number, entries in found.items() if number in names}
        self.connections = [names[number]._replace(msgcount=len(self.indexes[number])) for number in self.indexes]

    def _walk(self, place: int, chunk: bytes, found: dict[int, list[IndexData]], names: dict[int, Any]) -> None:
        """Add the messages and the connections in a chunk."""
        stream, file = BytesIO(chunk), self.bio
        while (offset := stream.tell()) < len(chunk):
            head = Header.read(stream)
            if head.get_uint8("op") == RecordType.CONNECTION:
                stream.seek(offset)
                self.bio = stream  # the library reads a connection from its file
                connection = self.read_connection()
                self.bio = file
                names[connection.id] = connection
            else:
                stream.seek(read_uint32(stream), 1)
                entry = IndexData(head.get_time("time"), place, offset)
                found.setdefault(head.get_uint32("conn"), []).append(entry)


def _message_at(chunk: bytes, offset: int) -> memoryview:
    """Return the message at a place in a chunk; the index may point to the connection in front of it."""
    view = memoryview(chunk)
    while True:
        (head,) = struct.unpack_from("<I", chunk, offset)
        start = offset + 4 + head
        (size,) = struct.unpack_from("<I", chunk, start)
        if start + 4 + size > len(chunk):
            raise DamagedFileError("a message reaches beyond its chunk")
        if b"op=\x02" in chunk[offset:start]:
            return view[start + 4 : start + 4 + size]
        offset = start + 4 + size


def _key_value(message: memoryview) -> str:
    (key,) = struct.unpack_from("<I", message)
    (value,) = struct.unpack_from("<I", message, 4 + key)
    return bytes(message[8 + key : 8 + key + value]).decode(errors="replace")


def _image(message: memoryview) -> RawImage:
    """Return a ``sensor_msgs/Image``; some versions append a list of metadata, which the library does not accept."""
    (name,) = struct.unpack_from("<I", message, 12)
    at = 16 + name
    height, width, length = struct.unpack_from("<III", message, at)
    at += 12
    encoding = bytes(message[at : at + length]).decode(errors="replace")
    big_endian, step, size = struct.unpack_from("<BII", message, at + length)
    at += length + 9
    if size > len(message) - at:
        raise DamagedFileError(f"it has {len(message) - at} bytes, too few for its size")
    return RawImage(height, width, encoding, bool(big_endian), step, np.frombuffer(message, np.uint8, size, at))


def _matrix(transform: Any) -> Float64Array:
    """Return the 4 x 4 matrix of a ROS transform, its quaternion normalised."""
    q, t = transform.rotation, transform.translation
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    matrix[:3, 3] = t.x, t.y, t.z
    return matrix
