"""The container of a ROS 1 bag: which messages it holds, when each was written, and their bytes.

Bags are untrusted: every size, offset and count is checked before use, and the memory for reading is bounded by the
size of the file.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import TypeVar

import lz4.frame
import numpy as np

from ...model.arrays import Int64Array
from ...model.loading import open_regular
from ..ros_image import DamagedFileError
from .decoding import Cursor, check_size

MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG_HEADER, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = range(2, 8)
_LARGEST_HEADER = 2**20
#: Upper limit of the compression ratio: LZ4 cannot exceed it, and real images do not.
_LARGEST_RATIO = 256
#: A chunk holds at most this, plus 8 times the size of the file. One image takes 3 MB.
_LARGEST_CHUNK = 2**25
_LARGEST_RECORD_HEADER = 2**12
#: Connection records between the place that an index names and its message. Real bags have one at most.
_MOST_CONNECTIONS = 16
_CACHED_CHUNKS = 4
_INDEXING_THREADS = 4
_Result = TypeVar("_Result")


@dataclass(frozen=True, eq=False)
class Topic:
    """The messages of one topic, sorted by time.

    Attributes
    ----------
    times_ns : int64, shape (N,)
        When each message was written, nanoseconds on the recorder's clock.
    chunks, offsets : int64, shape (N,)
        Which chunk holds each message, and where in it.
    """

    name: str
    times_ns: Int64Array
    chunks: Int64Array
    offsets: Int64Array

    def __len__(self) -> int:
        return len(self.times_ns)


@dataclass(frozen=True)
class _Chunk:
    start: int
    stored: int
    size: int
    compression: str


class Ros1Bag:
    """An open bag.

    A bag whose recorder was killed has no index. Its chunks are then read once from start to end, and data after the
    last complete chunk are ignored.

    Attributes
    ----------
    topics : dict of str to Topic
        Topics with at least one message.
    is_complete : bool
        False where the recorder did not finish the file.

    Raises
    ------
    DamagedFileError
        The file is not a bag, or is incomplete.
    """

    def __init__(self, path: Path) -> None:
        self._file = open_regular(path)
        self._lock = Lock()
        self._claimed = 0
        self._chunks: list[_Chunk] = []
        self._cache: OrderedDict[int, bytes] = OrderedDict()
        try:
            self._size = path.stat().st_size
            self.topics, self.is_complete = self._open()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; twice is harmless."""
        self._file.close()
        self._cache.clear()

    def message(self, topic: Topic, index: int) -> bytes:
        """Return the bytes of one message."""
        number = int(topic.chunks[index])
        with self._lock:
            chunk = self._cache.get(number)
        if chunk is None:
            chunk = self._chunk(number)
            with self._lock:
                self._cache[number] = chunk
                if len(self._cache) > _CACHED_CHUNKS:
                    self._cache.popitem(last=False)
        start, size = message_bounds(chunk, int(topic.offsets[index]))
        return chunk[start : start + size]

    def map_chunks(self, numbers: list[int], work: Callable[[int, bytes], _Result]) -> Iterator[_Result]:
        """Yield ``work(number, bytes)`` of some chunks in order, computed on several threads."""
        with ThreadPoolExecutor(_INDEXING_THREADS, thread_name_prefix="bag") as threads:
            try:
                # In groups, so that an error does not wait for the whole file.
                for start in range(0, len(numbers), 4 * _INDEXING_THREADS):
                    group = numbers[start : start + 4 * _INDEXING_THREADS]
                    yield from threads.map(lambda number: work(number, self._chunk(number)), group)
            finally:
                threads.shutdown(cancel_futures=True)

    def _open(self) -> tuple[dict[str, Topic], bool]:
        if self._read(0, min(len(MAGIC), self._size)) != MAGIC:
            raise DamagedFileError("it does not begin as a ROS bag of version 2.0 does")
        header, at = self._record_header(len(MAGIC), _BAG_HEADER)
        if header.get(b"encryptor"):
            raise DamagedFileError("it is encrypted")
        data_start = at + 4 + self._u32(at)
        index_at = _number(header, b"index_pos", "<Q")
        if index_at == 0:
            return self._scan(data_start), False
        return self._read_index(index_at, _number(header, b"conn_count"), _number(header, b"chunk_count")), True

    def _read_index(self, at: int, connection_count: int, chunk_count: int) -> dict[str, Topic]:
        names: dict[int, str] = {}
        for _ in range(connection_count):
            header, at = self._record_header(at, _CONNECTION)
            names[_number(header, b"conn")] = _text(header, b"topic")
            at += 4 + self._u32(at)
        places = []
        for _ in range(chunk_count):
            header, at = self._record_header(at, _CHUNK_INFO)
            places.append((_number(header, b"chunk_pos", "<Q"), _number(header, b"count")))
            at += 4 + self._u32(at)
        if at > self._size:
            raise DamagedFileError(f"it ends at byte {self._size} of {at}")
        entries: dict[str, list[Int64Array]] = {}
        end = 0
        for place, index_count in sorted(places):
            if place < end:
                raise DamagedFileError("its chunks overlap")
            chunk, end = self._chunk_header(place)
            number = len(self._chunks)
            self._chunks.append(chunk)
            for _ in range(index_count):
                header, end = self._record_header(end, _INDEX)
                connection = _number(header, b"conn")
                if connection not in names:
                    raise DamagedFileError(f"its index names a topic {connection} that it does not have")
                size = self._u32(end)
                if size != 12 * _number(header, b"count"):
                    raise DamagedFileError("the size of its index is wrong")
                raw = np.frombuffer(self._read(end + 4, size), "<u4").reshape(-1, 3).astype(np.int64)
                end += 4 + size
                times_ns = raw[:, 0] * 1_000_000_000 + raw[:, 1]
                entries.setdefault(names[connection], []).append(
                    np.column_stack([times_ns, np.full(len(raw), number), raw[:, 2]])
                )
        return _topics(entries)

    def _scan(self, at: int) -> dict[str, Topic]:
        """Read every complete chunk of a bag without an index."""
        names: dict[int, str] = {}
        entries: dict[str, list[Int64Array]] = {}
        while at < self._size:
            try:
                header, _ = self._record_header(at)
                if _operation(header) != _CHUNK:
                    at = self._next_record(at)
                    continue
                chunk, at = self._chunk_header(at)
            except DamagedFileError:
                break  # the recorder was stopped here
            self._chunks.append(chunk)
            number = len(self._chunks) - 1
            for topic, time_ns, offset in _walk(self._chunk(number), names):
                entries.setdefault(topic, []).append(np.array([[time_ns, number, offset]]))
        return _topics(entries)

    def _chunk_header(self, at: int) -> tuple[_Chunk, int]:
        """Return a chunk and where it ends."""
        header, at = self._record_header(at, _CHUNK)
        compression, size, stored = _text(header, b"compression"), _number(header, b"size"), self._u32(at)
        if compression not in _UNPACK:
            known = ", ".join(_UNPACK)
            raise DamagedFileError(
                f"its compression {compression!r} is not one of {known}; convert it by rosbag decompress"
            )
        self._claimed += check_size(size, _LARGEST_CHUNK + 8 * self._size)
        if self._claimed > max(self._size * _LARGEST_RATIO, 2**28):
            raise DamagedFileError(f"its {self._size} bytes claim to hold {self._claimed} or more")
        end = at + 4 + stored
        if end > self._size:
            raise DamagedFileError(f"a chunk ends at byte {end} of {self._size}")
        return _Chunk(at + 4, stored, size, compression), end

    def _chunk(self, number: int) -> bytes:
        chunk = self._chunks[number]
        data = _UNPACK[chunk.compression](self._read(chunk.start, chunk.stored), chunk.size)
        if len(data) != chunk.size:
            raise DamagedFileError(f"a chunk holds {len(data)} bytes instead of {chunk.size}")
        return data

    def _record_header(self, at: int, expected: int | None = None) -> tuple[dict[bytes, bytes], int]:
        """Return the fields of the record at ``at`` and where its data begin."""
        size = self._u32(at)
        if size > _LARGEST_HEADER:
            raise DamagedFileError(f"the record at byte {at} claims a header of {size} bytes")
        header = _fields(self._read(at + 4, size))
        if expected is not None and _operation(header) != expected:
            raise DamagedFileError(f"at byte {at} is a record of another kind than expected")
        return header, at + 4 + size

    def _next_record(self, at: int) -> int:
        at += 4 + self._u32(at)
        return at + 4 + self._u32(at)

    def _u32(self, at: int) -> int:
        return int.from_bytes(self._read(at, 4), "little")

    def _read(self, at: int, size: int) -> bytes:
        if not 0 <= at <= at + size <= self._size:
            raise DamagedFileError(f"it ends at byte {self._size}, but {size} bytes at {at} are needed")
        with self._lock:
            self._file.seek(at)
            data = self._file.read(size)
        if len(data) != size:
            raise DamagedFileError(f"it became shorter while it was read, at byte {at}")
        return data


def message_bounds(chunk: bytes, offset: int) -> tuple[int, int]:
    """Return start and size of the message at ``offset``; a connection record may precede it."""
    for _ in range(_MOST_CONNECTIONS):
        header, start, size = _record_in(chunk, offset)
        operation = _operation(header)
        if operation == _MESSAGE:
            return start, size
        if operation != _CONNECTION:
            raise DamagedFileError("its index points at something that is no message")
        offset = start + size
    raise DamagedFileError(f"more than {_MOST_CONNECTIONS} connections precede a message")


def _walk(chunk: bytes, names: dict[int, str]) -> Iterator[tuple[str, int, int]]:
    """Yield topic, time in ns and offset of every message; learn the topics' names on the way."""
    offset = 0
    while offset < len(chunk):
        header, start, size = _record_in(chunk, offset)
        if _operation(header) == _CONNECTION:
            names[_number(header, b"conn")] = _text(header, b"topic")
        elif _operation(header) == _MESSAGE:
            connection = _number(header, b"conn")
            if connection not in names:
                raise DamagedFileError(f"a message is of a topic {connection} that it does not have")
            seconds, nanoseconds = struct.unpack("<II", _field(header, b"time", 8))
            yield names[connection], seconds * 1_000_000_000 + nanoseconds, offset
        offset = start + size


def _record_in(chunk: bytes, offset: int) -> tuple[dict[bytes, bytes], int, int]:
    """Return the fields of a record in a chunk, and where its data begin and how long they are."""
    try:
        (header_size,) = struct.unpack_from("<I", chunk, offset)
        start = offset + 4 + header_size
        (size,) = struct.unpack_from("<I", chunk, start)
    except struct.error as error:
        raise DamagedFileError("a message lies outside its chunk") from error
    if header_size > _LARGEST_RECORD_HEADER:
        raise DamagedFileError(f"a message claims a header of {header_size} bytes")
    if start + 4 + size > len(chunk):
        raise DamagedFileError("a message lies outside its chunk")
    return _fields(chunk[offset + 4 : start]), start + 4, size


def _fields(data: bytes) -> dict[bytes, bytes]:
    """Return the ``name=value`` fields of a record's header."""
    fields = {}
    cursor = Cursor(data)
    while cursor.rest:
        name, _, value = cursor.take(cursor.u32()).partition(b"=")
        fields[name] = value
    return fields


def _field(header: dict[bytes, bytes], name: bytes, size: int) -> bytes:
    value = header.get(name, b"")
    if len(value) != size:
        raise DamagedFileError(f"a record's field {name.decode()!r} is missing or misshapen")
    return value


def _number(header: dict[bytes, bytes], name: bytes, code: str = "<I") -> int:
    return int(struct.unpack(code, _field(header, name, struct.calcsize(code)))[0])


def _text(header: dict[bytes, bytes], name: bytes) -> str:
    if name not in header:
        raise DamagedFileError(f"a record's field {name.decode()!r} is missing")
    return header[name].decode(errors="replace")


def _operation(header: dict[bytes, bytes]) -> int:
    return _field(header, b"op", 1)[0]


def _topics(entries: dict[str, list[Int64Array]]) -> dict[str, Topic]:
    topics = {}
    for name, parts in entries.items():
        table = np.concatenate(parts)
        if len(table):
            table = table[np.argsort(table[:, 0], kind="stable")]
            topics[name] = Topic(name, table[:, 0], table[:, 1], table[:, 2])
    return topics


def _unpack_lz4(data: bytes, size: int) -> bytes:
    try:
        unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    except (RuntimeError, EOFError) as error:
        raise DamagedFileError(f"a chunk cannot be decompressed: {error}") from error
    return unpacked


_UNPACK: dict[str, Callable[[bytes, int], bytes]] = {
    "none": lambda data, _: data,
    "lz4": _unpack_lz4,
}
