"""Random access to the messages of an MCAP file, finished or cut off.

The ``mcap`` library reads finished files only: a killed recording has no summary, and the library then has to read
and decompress all of it.
"""

from __future__ import annotations

import struct
import sys
import zlib
from array import array
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import lz4.frame
import numpy as np
from mcap.opcode import Opcode

from ...errors import SourceError
from ...model.arrays import Uint64Array
from ...model.loading import open_regular

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAGIC: Final = b"\x89MCAP0\r\n"
#: Chunk number of a message that lies outside of chunks.
_OUTSIDE: Final = 2**64 - 1

_FOOTER_BYTES: Final = 9 + 20 + len(MAGIC)
#: A chunk unpacks to at most this, plus 8 times the size of the file. One frame takes 20 MB.
_LARGEST_CHUNK: Final = 2**26
_CACHED_CHUNKS, _CACHED_BYTES = 8, 2**27
#: A file has at most this many messages, plus one for each 8 of its bytes.
_MOST_RECORDS: Final = 2**20

#: Exceptions that damaged bytes can raise.
_DAMAGE: Final = (ValueError, IndexError, KeyError, OverflowError, EOFError, RuntimeError, struct.error, zstd.ZstdError)


@dataclass(frozen=True)
class Channel:
    """A topic and the type of its messages."""

    topic: str
    message_type: str
    encoding: str


class McapFile:
    """An MCAP file, open for reading.

    Opening reads the summary at the end. Where there is none, because the writer was killed, the header of every
    record is read once; messages are not decompressed, unless a chunk has no index of its own.

    Attributes
    ----------
    path : Path
    complete : bool
        Whether the writer finished the file; otherwise it ends with the last complete chunk.

    Parameters
    ----------
    path : Path
    progress : callable, optional
        Called with the fraction of the index that is read, 0 to 1, and the current step.

    Raises
    ------
    SourceError
        Not an MCAP file, or damaged; the message says what to do.
    """

    def __init__(self, path: Path, progress: Callable[[float, str], None] | None = None) -> None:
        self.path = path
        self._progress = progress
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, Channel] = {}
        self._chunks: list[tuple[int, int]] = []  # offset and length of each record's body
        self._places: dict[int, array[int]] = {}
        self._attachments: dict[str, tuple[int, int]] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._cache: OrderedDict[int, memoryview] = OrderedDict()
        self._indexed_bytes = self._records = 0
        self._file = open_regular(path)
        try:
            with self._damage_told():
                self._size = self._file.seek(0, 2)
                begun = self._read(0, min(len(MAGIC), self._size))
                if begun != MAGIC and MAGIC.startswith(begun):
                    raise SourceError(
                        f"{path} holds no frame: it was cut off before its first frame was complete; record it again"
                    )
                if begun != MAGIC:
                    raise SourceError(f"{path} is no MCAP file; choose a recording")
                self.complete = self._from_summary() or self._from_scan()
                known = self._channels.keys()
                self._places = {number: places for number, places in self._places.items() if places and number in known}
        except BaseException:
            self.close()
            raise

    @property
    def topics(self) -> dict[str, Channel]:
        """The topics that have messages."""
        return {self._channels[number].topic: self._channels[number] for number in self._places}

    def places(self, topic: str) -> Uint64Array:
        """Return log time (ns), chunk and offset of each message of a topic, in the order of log time."""
        found = [places for number, places in self._places.items() if self._channels[number].topic == topic]
        table = np.concatenate([np.frombuffer(places, np.uint64) for places in found] or [np.empty(0, np.uint64)])
        table = table.reshape(-1, 3)
        return table[np.argsort(table[:, 0], kind="stable")]

    def message(self, place: Uint64Array) -> memoryview:
        """Return the bytes of the message at a place."""
        with self._damage_told():
            chunk, offset = int(place[1]), int(place[2])
            if chunk == _OUTSIDE:
                _, length = struct.unpack("<BQ", self._read(offset, 9))
                return memoryview(self._read(offset + 31, length - 22))
            data = self._chunk_data(chunk)
            opcode, length = struct.unpack_from("<BQ", data, offset)
            if opcode != Opcode.MESSAGE or not 22 <= length <= len(data) - offset - 9:
                raise ValueError("its index points nowhere")
            return data[offset + 31 : offset + 9 + length]

    def attachment(self, name: str) -> bytes | None:
        """Return an attached file by its name, or None."""
        if name not in self._attachments:
            return None
        with self._damage_told():
            record = self._read(*self._attachments[name])
            cursor = _Cursor(record)
            cursor.take("<QQ")
            cursor.text(), cursor.text()
            data = cursor.bytes_(*cursor.take("<Q"))
            end = cursor.position
            (checksum,) = cursor.take("<I")
            if checksum and zlib.crc32(memoryview(record)[:end]) != checksum:
                raise ValueError(f"the checksum of {name} is wrong")
            return bytes(data)

    def metadata(self, name: str) -> dict[str, str]:
        """Return a table of texts by its name; empty if there is none."""
        return self._metadata.get(name, {})

    def close(self) -> None:
        """Close the file; twice is harmless."""
        self._file.close()
        self._cache.clear()

    def _from_summary(self) -> bool:
        """Index a finished file by its summary; return whether it has a usable one."""
        with suppress(*_DAMAGE):
            if self._read_summary():
                return True
        for table in (self._schemas, self._channels, self._chunks, self._places, self._attachments, self._metadata):
            table.clear()
        self._indexed_bytes = self._records = 0
        return False

    def _from_scan(self) -> bool:
        """Index a file up to its last complete chunk; return whether it is complete."""
        with suppress(*_DAMAGE):
            if self._scan():
                return True
        with suppress(*_DAMAGE):  # a power failure can leave a hole where the last chunk was
            self._take_indexes([])
        return False

    def _read_summary(self) -> bool:
        if self._size < _FOOTER_BYTES + len(MAGIC):
            return False
        footer = self._read(self._size - _FOOTER_BYTES, _FOOTER_BYTES)
        opcode, length, start, _, checksum = struct.unpack_from("<BQQQI", footer)
        if footer[-8:] != MAGIC or (opcode, length) != (Opcode.FOOTER, 20) or not 0 < start < self._size:
            return False
        summary = self._read(start, self._size - _FOOTER_BYTES - start)
        if checksum and zlib.crc32(summary + footer[:25]) != checksum:
            return False
        chunk_indexes: list[_Cursor] = []
        expected = -1
        for opcode, offset, length in _records(memoryview(summary)):
            body = _Cursor(memoryview(summary)[offset : offset + length])
            if opcode == Opcode.CHUNK_INDEX:
                chunk_indexes.append(body)
            elif opcode == Opcode.ATTACHMENT_INDEX:
                position, size, *_ = body.take("<QQQQQ")
                self._attachments[body.text()] = position + 9, size - 9
            elif opcode == Opcode.METADATA_INDEX:
                position, size = body.take("<QQ")
                self._add_metadata(position + 9, size - 9)
            elif opcode == Opcode.STATISTICS:
                expected = body.take("<QHIIII")[-1]
            else:
                self._declare(opcode, body)
        if not chunk_indexes or len(chunk_indexes) != expected:
            return False
        for number, body in enumerate(chunk_indexes):
            self._tell(number / len(chunk_indexes))
            self._index_chunk(body)
        return True

    def _index_chunk(self, index: _Cursor) -> None:
        """Add the chunk that an index record of the summary describes."""
        _, _, position, chunk_length = index.take("<QQQQ")
        index.bytes_(*index.take("<I"))
        (length,) = index.take("<Q")
        self._chunks.append((position + 9, chunk_length - 9))
        if length == 0:
            self._look_inside(len(self._chunks) - 1)
            return
        self._spend(length)
        body = memoryview(self._read(position + chunk_length, length))
        for opcode, offset, size in _records(body):
            if opcode == Opcode.MESSAGE_INDEX:
                self._add_places(body[offset : offset + size])

    def _scan(self) -> bool:
        """Visit the head of every record; return whether there is a footer."""
        offset = len(MAGIC)
        indexed: list[bytes] = []  # of the last chunk, so far
        while offset + 9 <= self._size:
            opcode, length = struct.unpack("<BQ", self._read(offset, 9))
            start = offset + 9
            if opcode == 0 or length > self._size - start:
                break
            if opcode in (Opcode.CHUNK, Opcode.FOOTER):
                self._take_indexes(indexed)
                indexed = []
            if opcode == Opcode.FOOTER:
                return True
            if opcode == Opcode.CHUNK:
                self._tell(offset / self._size)
                self._chunks.append((start, length))
            elif opcode == Opcode.MESSAGE_INDEX:
                indexed.append(self._read(start, length))
            elif opcode == Opcode.MESSAGE:
                channel, _, log_time_ns = struct.unpack("<HIQ", self._read(start, 14))
                self._places.setdefault(channel, array("Q")).extend((log_time_ns, _OUTSIDE, offset))
            elif opcode == Opcode.ATTACHMENT:
                self._attachments[_Cursor(self._read(start, min(length, 4096)), 16).text()] = start, length
            elif opcode == Opcode.METADATA:
                self._add_metadata(start, length)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._declare(opcode, _Cursor(self._read(start, length)))
            offset = start + length
        return False

    def _take_indexes(self, records: list[bytes]) -> None:
        """Add the messages of the last chunk by its index, or by its content where the index is missing or unknown."""
        if not self._chunks:
            return
        known = all(int.from_bytes(record[:2], "little") in self._channels for record in records)
        if records and known:
            for record in records:
                self._add_places(record)
        else:
            self._look_inside(len(self._chunks) - 1)

    def _look_inside(self, chunk: int) -> None:
        """Decompress a chunk to find its messages."""
        self._spend(self._chunks[chunk][1])
        data = self._chunk_data(chunk)
        for opcode, offset, length in _records(data):
            self._count(1)
            if opcode == Opcode.MESSAGE:
                channel, _, log_time_ns = struct.unpack_from("<HIQ", data, offset)
                self._places.setdefault(channel, array("Q")).extend((log_time_ns, chunk, offset - 9))
            else:
                self._declare(opcode, _Cursor(data[offset : offset + length]))

    def _add_places(self, record: bytes | memoryview) -> None:
        """Add a message index of the last chunk."""
        channel, length = struct.unpack_from("<HI", record)
        self._count(length // 16)
        places = self._places.setdefault(channel, array("Q"))
        for log_time_ns, offset in struct.iter_unpack("<QQ", record[6 : 6 + length]):
            places.extend((log_time_ns, len(self._chunks) - 1, offset))

    def _add_metadata(self, position: int, length: int) -> None:
        self._spend(length)
        cursor = _Cursor(self._read(position, length))
        name = cursor.text()
        self._metadata[name] = cursor.text_map()

    def _spend(self, length: int) -> None:
        """Count bytes that the index sends to; raise where it sends to the same bytes again and again."""
        self._indexed_bytes += length
        if self._indexed_bytes > self._size:
            raise ValueError("its index points to one place more than once")

    def _count(self, records: int) -> None:
        """Count records; raise where there are far more than its bytes can hold."""
        self._records += records
        if self._records > _MOST_RECORDS + self._size // 8:
            raise ValueError("it claims far more messages than its size allows")

    def _declare(self, opcode: int, body: _Cursor) -> None:
        """Add a schema or a channel; ignore other records."""
        if opcode == Opcode.SCHEMA:
            (number,) = body.take("<H")
            self._schemas[number] = body.text()
        elif opcode == Opcode.CHANNEL:
            number, schema = body.take("<HH")
            self._channels[number] = Channel(body.text(), self._schemas.get(schema, ""), body.text())

    def _chunk_data(self, number: int) -> memoryview:
        """Return a chunk's records, decompressed and checked; the last few are kept."""
        if number in self._cache:
            self._cache.move_to_end(number)
            return self._cache[number]
        cursor = _Cursor(self._read(*self._chunks[number]))
        _, _, size, checksum = cursor.take("<QQQI")
        compression, (packed_size,) = cursor.text(), cursor.take("<Q")
        if size > _LARGEST_CHUNK + 8 * self._size:
            raise ValueError(f"a chunk claims to hold {size / 2**20:.0f} MiB")
        data = _decompress(cursor.bytes_(packed_size), compression, size)
        if len(data) != size or (checksum and zlib.crc32(data) != checksum):
            raise ValueError("the checksum of a chunk is wrong")
        self._cache[number] = memoryview(data)
        while len(self._cache) > _CACHED_CHUNKS or (
            len(self._cache) > 1 and sum(map(len, self._cache.values())) > _CACHED_BYTES
        ):
            self._cache.popitem(last=False)
        return self._cache[number]

    def _read(self, offset: int, length: int) -> bytes:
        if not 0 <= offset <= offset + length <= self._size:
            raise ValueError("a record reaches beyond its end")
        self._file.seek(offset)
        data = self._file.read(length)
        if len(data) != length:
            raise ValueError("it became shorter")
        return data

    def _tell(self, share: float) -> None:
        if self._progress is not None and len(self._chunks) % 256 == 0:
            self._progress(share, f"indexing {self.path.name}")

    @contextmanager
    def _damage_told(self) -> Iterator[None]:
        try:
            if self._file.closed:
                raise SourceError(f"{self.path} is closed; open it again")
            yield
        except _DAMAGE as error:
            detail = " ".join(str(error).split()) or type(error).__name__
            raise SourceError(f"{self.path} is damaged ({detail}); copy or record it again") from error
        except OSError as error:
            raise SourceError(f"cannot read {self.path}: {error.strerror or error}; check the disk") from error


class _Cursor:
    """Reads the fields of a record one after the other."""

    def __init__(self, data: bytes | memoryview, position: int = 0) -> None:
        self._data = memoryview(data)
        self.position = position

    def take(self, layout: str) -> tuple[Any, ...]:
        values = struct.unpack_from(layout, self._data, self.position)
        self.position += struct.calcsize(layout)
        return values

    def bytes_(self, length: int) -> memoryview:
        if length > len(self._data) - self.position:
            raise ValueError("a record reaches beyond its end")
        self.position += length
        return self._data[self.position - length : self.position]

    def text(self) -> str:
        return bytes(self.bytes_(*self.take("<I"))).decode()

    def text_map(self) -> dict[str, str]:
        (length,) = self.take("<I")
        end = self.position + length
        values = {}
        while self.position < end:
            key = self.text()
            values[key] = self.text()
        return values


def _records(data: memoryview) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, body offset and body length of consecutive records."""
    offset = 0
    while offset < len(data):
        opcode, length = struct.unpack_from("<BQ", data, offset)
        if length > len(data) - offset - 9:
            raise ValueError("a record reaches beyond its end")
        yield opcode, offset + 9, length
        offset += 9 + length


def _decompress(packed: memoryview, compression: str, size: int) -> bytes | memoryview:
    """Decompress at most the size that the chunk states, so that no file can fill the memory."""
    if compression == "zstd":
        return zstd.ZstdDecompressor().decompress(packed, max_length=size)
    if compression == "lz4":
        data: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size)
        return data
    if compression:
        raise ValueError(f"it is compressed with {compression!r}; known are zstd and lz4")
    return packed
