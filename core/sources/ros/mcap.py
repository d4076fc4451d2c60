"""Random access to the messages of an MCAP file, finished or cut off.

The ``mcap`` library parses all records. It is not asked for messages: it decompresses a chunk for each question, and
all of a file that has no summary because its writer was killed.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import Final

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream

from ...errors import SourceError, TactuneError, closed_on_error
from ...model.arrays import Int64Array, Uint64Array
from ..base import Progress
from ..ros_image import damage_told
from .messages import ZSTD_MAGIC, Bag, long_name, stamp_ns, unpacked

MAGIC: Final = b"\x89MCAP0\r\n"
#: A chunk unpacks to at most this, plus 8 times the size of the file. One frame takes 20 MB.
_MAX_CHUNK_BYTES: Final = 2**26
#: Both cameras of a frame may be in different chunks, with the chunk of the frame before.
_CACHED_CHUNKS: Final = 4


class McapBag(Bag):
    """A ROS bag in MCAP; ``complete`` unless its writer was killed, so that its last chunk is missing.

    Opening reads the head of every record up to the first damage. Messages are not decompressed, unless a chunk has no
    index of its own. ``kinds`` has the type and encoding of the messages of each topic that has some; ``types`` those
    that ROS programs can have written.
    """

    def __init__(self, path: Path, progress: Progress | None = None) -> None:
        super().__init__()
        self.path, self._progress = path, progress
        self._lock = Lock()
        self._chunk_data = lru_cache(_CACHED_CHUNKS)(self._unpack)
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._places: defaultdict[int, array[int]] = defaultdict(lambda: array("Q"))  # a list takes ten times as much
        self._attachments: dict[str, tuple[int, int]] = {}  # offset and length of each record's body
        self.metadata: dict[str, dict[str, str]] = {}
        self._file = path.open("rb")
        with closed_on_error(self.close), damage_told(path, "it is damaged"):
            self._size = self._file.seek(0, 2)
            if not MAGIC.startswith(self._read(0, min(len(MAGIC), self._size))):
                raise SourceError(f"{path} is no MCAP file; choose a recording")
            self.complete = self._index()
        numbers: defaultdict[str, list[int]] = defaultdict(list)
        self.kinds: dict[str, tuple[str, str]] = {}
        for number, channel in self._channels.items():
            if number in self._places:
                schema = self._schemas.get(channel.schema_id)
                numbers[channel.topic].append(number)
                self.kinds[channel.topic] = ("" if schema is None else schema.name, channel.message_encoding)
        self.types = {topic: long_name(kind) for topic, (kind, how) in self.kinds.items() if how in ("cdr", "ros1")}
        #: Log time (ns), chunk (0: outside chunks) and offset of each message of a topic, in the order of log time.
        self._tables = {topic: self._table(each) for topic, each in numbers.items()}
        self._places.clear()

    def _table(self, numbers: list[int]) -> Uint64Array:
        table = np.concatenate([np.frombuffer(self._places[number], np.uint64) for number in numbers]).reshape(-1, 3)
        return table[np.argsort(table[:, 0], kind="stable")]

    def is_ros1(self, topic: str) -> bool:
        return self.kinds[topic][1] == "ros1"

    def count(self, topic: str) -> int:
        return len(self._tables.get(topic, ()))

    def times_ns(self, topic: str) -> Int64Array:
        return self._tables[topic][:, 0].astype(np.int64) if topic in self._tables else np.empty(0, np.int64)

    def raw(self, topic: str, index: int) -> memoryview:
        with self._lock, damage_told(self.path, "it is damaged"):
            _, chunk, offset = map(int, self._tables[topic][index])
            if chunk:
                data = self._chunk_data(chunk)
            else:
                (length,) = struct.unpack("<Q", self._read(offset + 1, 8))
                data, offset = memoryview(self._read(offset, 9 + length)), 0
            opcode, length = struct.unpack_from("<BQ", data, offset)
            if opcode != Opcode.MESSAGE or not 22 <= length <= len(data) - offset - 9:
                raise ValueError("its index points nowhere")
            return unpacked(data[offset + 31 : offset + 9 + length])

    def stamp_ns(self, topic: str, index: int) -> int:
        """Return the stamp; where nothing is compressed, nothing else is read."""
        with self._lock, damage_told(self.path, "it is damaged"):
            _, chunk, offset = map(int, self._tables[topic][index])
            if not chunk or self._read(chunk + 28, 4) == b"\0\0\0\0":  # the length of the compression's name
                head = self._read((chunk + 40 if chunk else 0) + offset, 43)
                if head[0] == Opcode.MESSAGE and head[31:35] != ZSTD_MAGIC:
                    return stamp_ns(head[31:], is_ros1=self.is_ros1(topic))
        return super().stamp_ns(topic, index)

    def attachment(self, name: str) -> bytes | None:
        if name not in self._attachments:
            return None
        with self._lock, damage_told(self.path, "it is damaged"):
            record = self._read(*self._attachments[name])
            (checksum,) = struct.unpack("<I", record[-4:])
            if checksum and zlib.crc32(memoryview(record)[:-4]) != checksum:
                raise ValueError(f"the checksum of {name} is wrong")
            data: bytes = Attachment.read(_stream(record)).data
            return data

    def close(self) -> None:
        self._file.close()
        self._chunk_data.cache_clear()

    def _index(self) -> bool:
        """Find all messages up to the last complete chunk; return whether the file has an end."""
        offset, chunk, chunks = len(MAGIC), 0, 0
        indexes: list[bytes] = []  # of this chunk, so far
        try:
            while offset + 9 <= self._size:
                opcode, length = struct.unpack("<BQ", self._read(offset, 9))
                start, offset = offset + 9, offset + 9 + length
                if opcode == 0 or offset > self._size:
                    break
                if opcode in (Opcode.CHUNK, Opcode.FOOTER):
                    self._add_chunk(chunk, indexes)
                    indexes, chunk, chunks = [], start, chunks + 1
                    if opcode == Opcode.FOOTER:
                        return True
                    if self._progress is not None and chunks % 256 == 0:
                        self._progress(offset / self._size, f"indexing {self.path.name}")
                elif opcode == Opcode.MESSAGE_INDEX:
                    indexes.append(self._read(start, length))
                elif opcode == Opcode.ATTACHMENT:
                    self._attachments[Attachment.read(_stream(self._read(start, length))).name] = start, length
                elif opcode == Opcode.METADATA:
                    found = Metadata.read(_stream(self._read(start, length)))
                    self.metadata[found.name] = found.metadata
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._declare(opcode, self._read(start, length))
                elif opcode == Opcode.MESSAGE:  # a recorder that is in a hurry writes no chunks
                    channel, log_time_ns = struct.unpack("<H4xQ", self._read(start, 14))
                    self._add_place(channel, log_time_ns, 0, start - 9)
        except (TactuneError, OSError):  # cancelled, or the disk fails
            raise
        except Exception:  # the library and its decompressors raise a dozen kinds; what comes before plays
            indexes = []
        with suppress(Exception):  # the last indexes may be cut off, or a power failure left a hole there
            self._add_chunk(chunk, [])
        return False

    def _add_chunk(self, start: int, indexes: list[bytes]) -> None:
        """Add a chunk's messages by its indexes, or by its content where these are missing or name new channels."""
        if indexes and all(int.from_bytes(index[:2], "little") in self._channels for index in indexes):
            for index in indexes:
                channel, length = struct.unpack_from("<HI", index)
                for log_time_ns, offset in struct.iter_unpack("<QQ", index[6 : 6 + length]):
                    self._add_place(channel, log_time_ns, start, offset)
        elif start:
            data = self._chunk_data(start)
            for opcode, offset, length in _records(data):
                if opcode == Opcode.MESSAGE:
                    channel, log_time_ns = struct.unpack_from("<H4xQ", data, offset)
                    self._add_place(channel, log_time_ns, start, offset - 9)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._declare(opcode, bytes(data[offset : offset + length]))

    def _add_place(self, channel: int, log_time_ns: int, chunk: int, offset: int) -> None:
        self._places[channel].extend((log_time_ns, chunk, offset))

    def _declare(self, opcode: int, body: bytes) -> None:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(_stream(body))
            self._schemas[schema.id] = schema
        else:
            channel = Channel.read(_stream(body))
            self._channels[channel.id] = channel

    def _unpack(self, start: int) -> memoryview:
        """Return a chunk's records, decompressed and checked."""
        (length,) = struct.unpack("<Q", self._read(start - 8, 8))
        chunk = Chunk.read(_stream(self._read(start, length)))
        if chunk.uncompressed_size > _MAX_CHUNK_BYTES + 8 * self._size:
            raise ValueError(f"a chunk claims to hold {chunk.uncompressed_size / 2**20:.0f} MiB")
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        return memoryview(stream.read(size))

    def _read(self, offset: int, length: int) -> bytes:
        if not 0 <= offset <= offset + length <= self._size:
            raise ValueError("a record reaches beyond its end")
        self._file.seek(offset)
        data = self._file.read(length)
        if len(data) != length:
            raise ValueError("it became shorter")
        return data


def _stream(record: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(record))


def _records(data: memoryview) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, body offset and body length of consecutive records."""
    offset = 0
    while offset < len(data):
        opcode, length = struct.unpack_from("<BQ", data, offset)
        if length > len(data) - offset - 9:
            raise ValueError("a record reaches beyond its end")
        yield opcode, offset + 9, length
        offset += 9 + length
