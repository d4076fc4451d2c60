"""Random access to the messages of an MCAP file, finished or cut off.

The ``mcap`` library parses all records. It is not asked for messages: it decompresses a chunk for each question, and
all of a file that has no summary because its writer was killed.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Final

import lz4.frame
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream

from ...errors import SourceError, TactuneError
from ...model.arrays import Uint64Array
from ..base import Progress

MAGIC: Final = b"\x89MCAP0\r\n"
#: Chunk number of a message that lies outside of chunks.
_OUTSIDE: Final = 2**64 - 1
#: The last record, with the magic bytes behind it.
_FOOTER_BYTES: Final = 9 + 20 + len(MAGIC)
#: A chunk unpacks to at most this, plus 8 times the size of the file. One frame takes 20 MB.
_LARGEST_CHUNK: Final = 2**26
#: A file has at most this many messages, plus one for each 8 of its bytes.
_MOST_MESSAGES: Final = 2**20
_CACHED_CHUNKS, _CACHED_BYTES = 8, 2**27


class McapFile:
    """An MCAP file, open for reading.

    Opening reads the summary at the end. Where there is none, because the writer was killed, the header of every
    record is read once; messages are not decompressed, unless a chunk has no index of its own.

    Attributes
    ----------
    path : Path
    complete : bool
        Whether the writer finished the file; otherwise it ends with the last complete chunk.
    topics : dict of str to (str, str)
        Type and encoding of the messages of each topic that has some.
    metadata : dict of str to dict
        Tables of texts by their names.
    """

    def __init__(self, path: Path, progress: Progress | None = None) -> None:
        self.path, self._progress = path, progress
        self._cache: OrderedDict[int, memoryview] = OrderedDict()
        self._file = path.open("rb")
        try:
            with self._damage_told():
                self._size = self._file.seek(0, 2)
                begun = self._read(0, min(len(MAGIC), self._size))
                if not MAGIC.startswith(begun):
                    raise SourceError(f"{path} is no MCAP file; choose a recording")
                self.complete = self._index_by_summary() or self._index_by_scan()
        except BaseException:
            self.close()
            raise
        self._numbers: dict[str, list[int]] = {}
        self.topics: dict[str, tuple[str, str]] = {}
        for number, channel in self._channels.items():
            if number in self._places:
                schema = self._schemas.get(channel.schema_id)
                self._numbers.setdefault(channel.topic, []).append(number)
                self.topics[channel.topic] = ("" if schema is None else schema.name, channel.message_encoding)

    def places(self, topic: str) -> Uint64Array:
        """Return log time (ns), chunk and offset of each message of a topic, in the order of log time."""
        found = [np.frombuffer(self._places[number], np.uint64) for number in self._numbers.get(topic, [])]
        table = np.concatenate([*found, np.empty(0, np.uint64)]).reshape(-1, 3)
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
            (checksum,) = struct.unpack("<I", record[-4:])
            if checksum and zlib.crc32(memoryview(record)[:-4]) != checksum:
                raise ValueError(f"the checksum of {name} is wrong")
            data: bytes = Attachment.read(_stream(record)).data
            return data

    def close(self) -> None:
        """Close the file; twice is harmless."""
        self._file.close()
        self._cache.clear()

    def _forget_index(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._places: dict[int, array[int]] = {}
        self._attachments: dict[str, tuple[int, int]] = {}  # offset and length of each record's body
        self.metadata: dict[str, dict[str, str]] = {}

    def _index_by_summary(self) -> bool:
        """Index a finished file by its summary; return whether it has a usable one."""
        self._forget_index()
        try:
            if not self._summary_is_whole():
                return False
            self._file.seek(0)
            summary = SeekingReader(self._file, record_size_limit=self._size).get_summary()
            if summary is None or summary.statistics is None:
                return False
            chunks = summary.chunk_indexes
            if not chunks or len(chunks) != summary.statistics.chunk_count:
                return False
            self._schemas, self._channels = summary.schemas, summary.channels
            for attachment in summary.attachment_indexes:
                self._attachments[attachment.name] = attachment.offset + 9, attachment.length - 9
            for found in summary.metadata_indexes:
                self._add_metadata(found.offset + 9, found.length - 9)
            for number, chunk in enumerate(chunks):
                self._tell(number, number / len(chunks))
                start = chunk.chunk_start_offset + 9
                if chunk.message_index_length == 0:
                    self._look_inside(start)
                    continue
                records = memoryview(
                    self._read(chunk.chunk_start_offset + chunk.chunk_length, chunk.message_index_length)
                )
                for opcode, offset, length in _records(records):
                    if opcode == Opcode.MESSAGE_INDEX:
                        self._add_places(start, records[offset : offset + length])
        except TactuneError:  # the progress callable cancels
            raise
        except Exception:  # the library checks with whatever Python raises
            return False
        return True

    def _summary_is_whole(self) -> bool:
        """Return whether the summary's checksum is right, which the library does not check, or not given."""
        footer = self._read(self._size - _FOOTER_BYTES, _FOOTER_BYTES)
        start, checksum = struct.unpack_from("<9xQ8xI", footer)
        summary = self._read(start, self._size - _FOOTER_BYTES - start)
        return not checksum or zlib.crc32(summary + footer[:25]) == checksum

    def _index_by_scan(self) -> bool:
        """Index a file up to its last complete chunk by the head of every record; return whether it has an end."""
        self._forget_index()
        offset, chunk, chunks = len(MAGIC), 0, 0
        indexes: list[bytes] = []  # of this chunk, so far
        ended = False
        try:
            while offset + 9 <= self._size and not ended:
                opcode, length = struct.unpack("<BQ", self._read(offset, 9))
                start = offset + 9
                if opcode == 0 or length > self._size - start:
                    break
                offset = start + length
                if opcode in (Opcode.CHUNK, Opcode.FOOTER):
                    self._add_chunk(chunk, indexes)
                    indexes, chunk, chunks = [], start, chunks + 1
                    ended = opcode == Opcode.FOOTER
                    self._tell(chunks, offset / self._size)
                elif opcode == Opcode.MESSAGE_INDEX:
                    indexes.append(self._read(start, length))
                elif opcode == Opcode.MESSAGE:
                    channel, log_time_ns = struct.unpack("<H4xQ", self._read(start, 14))
                    self._add_place(channel, log_time_ns, _OUTSIDE, start - 9)
                elif opcode == Opcode.ATTACHMENT:
                    self._attachments[Attachment.read(_stream(self._read(start, length))).name] = start, length
                elif opcode == Opcode.METADATA:
                    self._add_metadata(start, length)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._declare(opcode, self._read(start, length))
        except (TactuneError, OSError):  # cancelled, or the disk fails
            raise
        except Exception:  # the library and its decompressors raise a dozen kinds; what comes before plays
            ended = False
        if not ended:
            with suppress(Exception):  # its indexes may be cut off, or a power failure left a hole there
                self._add_chunk(chunk, [])
        return ended

    def _add_chunk(self, start: int, indexes: list[bytes]) -> None:
        """Add a chunk's messages by its indexes, or by its content where these are missing or name new channels."""
        if indexes and all(int.from_bytes(index[:2], "little") in self._channels for index in indexes):
            for index in indexes:
                self._add_places(start, index)
        elif start:
            self._look_inside(start)

    def _look_inside(self, chunk: int) -> None:
        """Decompress a chunk to find its messages."""
        data = self._chunk_data(chunk)
        for opcode, offset, length in _records(data):
            if opcode == Opcode.MESSAGE:
                channel, log_time_ns = struct.unpack_from("<H4xQ", data, offset)
                self._add_place(channel, log_time_ns, chunk, offset - 9)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._declare(opcode, bytes(data[offset : offset + length]))

    def _add_places(self, chunk: int, index: bytes | memoryview) -> None:
        channel, length = struct.unpack_from("<HI", index)
        for log_time_ns, offset in struct.iter_unpack("<QQ", index[6 : 6 + length]):
            self._add_place(channel, log_time_ns, chunk, offset)

    def _add_place(self, channel: int, log_time_ns: int, chunk: int, offset: int) -> None:
        places = self._places.setdefault(channel, array("Q"))
        places.extend((log_time_ns, chunk, offset))
        if len(places) > 3 * (_MOST_MESSAGES + self._size // 8):
            raise ValueError("it claims far more messages than its size allows")

    def _add_metadata(self, start: int, length: int) -> None:
        found = Metadata.read(_stream(self._read(start, length)))
        self.metadata[found.name] = found.metadata

    def _declare(self, opcode: int, body: bytes) -> None:
        """Add a schema or a channel."""
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(_stream(body))
            self._schemas[schema.id] = schema
        else:
            channel = Channel.read(_stream(body))
            self._channels[channel.id] = channel

    def _chunk_data(self, start: int) -> memoryview:
        """Return a chunk's records, decompressed and checked; the last few are kept."""
        if start in self._cache:
            self._cache.move_to_end(start)
            return self._cache[start]
        (length,) = struct.unpack("<Q", self._read(start - 8, 8))
        chunk = Chunk.read(_stream(self._read(start, length)))
        if chunk.uncompressed_size > _LARGEST_CHUNK + 8 * self._size:
            raise ValueError(f"a chunk claims to hold {chunk.uncompressed_size / 2**20:.0f} MiB")
        if chunk.compression == "lz4":  # the library would unpack all of it, however much more than it claims
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=chunk.uncompressed_size)
            chunk = replace(chunk, compression="", data=data)
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        self._cache[start] = memoryview(stream.read(size))
        while len(self._cache) > _CACHED_CHUNKS or (
            len(self._cache) > 1 and sum(map(len, self._cache.values())) > _CACHED_BYTES
        ):
            self._cache.popitem(last=False)
        return self._cache[start]

    def _read(self, offset: int, length: int) -> bytes:
        if not 0 <= offset <= offset + length <= self._size:
            raise ValueError("a record reaches beyond its end")
        self._file.seek(offset)
        data = self._file.read(length)
        if len(data) != length:
            raise ValueError("it became shorter")
        return data

    def _tell(self, chunks: int, share: float) -> None:
        if self._progress is not None and chunks % 256 == 0:
            self._progress(share, f"indexing {self.path.name}")

    @contextmanager
    def _damage_told(self) -> Iterator[None]:
        try:
            if self._file.closed:
                raise SourceError(f"{self.path} is closed; open it again")
            yield
        except TactuneError:  # also of a progress callable that cancels
            raise
        except OSError as error:
            raise SourceError(f"cannot read {self.path}: {error.strerror or error}; check the disk") from error
        except Exception as error:  # the library checks with whatever Python raises
            detail = " ".join(str(error).split()) or type(error).__name__
            raise SourceError(f"{self.path} is damaged ({detail}); copy or record it again") from error


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
