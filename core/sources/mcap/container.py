"""Writes the MCAP container: https://mcap.dev/spec.

Written here because neither library can do what a recording of a running sensor needs: that of
``rosbags`` writes a folder, holds schemas and metadata back until the end and knows no attachments;
the official ``mcap`` compresses at level 3 only, which takes 20 ms a frame where level 1 takes 7.

Everything that a reader needs stands before the first chunk, and chunks go to the operating system
as they fill, so a file that ends anywhere is readable up to its last complete chunk.
"""

from __future__ import annotations

import struct
import sys
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from io import FileIO
from typing import Final

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

Buffer = bytes | bytearray | memoryview

MAGIC: Final = b"\x89MCAP0\r\n"
PROFILE: Final = "ros2"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(0x01, 0x09)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(0x09, 0x10)

#: Level 1 compresses a pair of noisy 640 x 480 images to 47 % in 7 ms; level 3 to 41 % in 20 ms.
_COMPRESSION_LEVEL = 1

_LAST_TIME_NS = 2**64 - 1


@dataclass(frozen=True)
class Message:
    """One message of a channel; ``parts`` are its bytes, in pieces so that images are copied once only."""

    channel: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    parts: tuple[Buffer, ...]


class McapWriter:
    """An MCAP file that is being written.

    Schemas, channels, attachments and metadata come first, then chunks, then `finish`. Each method
    writes whole records or, where the operating system refuses, takes back what it wrote of them.

    Parameters
    ----------
    file : FileIO
        New and unbuffered. The caller closes it.
    library : str
        Who writes, for the header.

    Raises
    ------
    OSError
        From every method: the disk is full, or the operating system refuses otherwise.
    """

    def __init__(self, file: FileIO, library: str) -> None:
        self._file = file
        self._size = 0
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._attachment_indexes: list[bytes] = []
        self._metadata_indexes: list[bytes] = []
        self._chunk_indexes: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._first_ns, self._last_ns = _LAST_TIME_NS, 0
        self._scratch = bytearray()
        # Kept from chunk to chunk: making one costs as much as compressing a frame.
        self._compressor = zstd.ZstdCompressor(level=_COMPRESSION_LEVEL)
        self._write(MAGIC + _record(HEADER, _text(PROFILE) + _text(library)))

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._size

    def add_schema(self, name: str, definition: str) -> int:
        """Write a message type with its full ROS 2 definition; return its number."""
        number = len(self._schemas) + 1
        body = struct.pack("<H", number) + _text(name) + _text("ros2msg") + _text(definition)
        self._schemas.append(_record(SCHEMA, body))
        self._write(self._schemas[-1])
        return number

    def add_channel(self, topic: str, schema: int, metadata: dict[str, str]) -> int:
        """Write a topic of messages in CDR; return its number."""
        number = len(self._channels) + 1
        body = struct.pack("<HH", number, schema) + _text(topic) + _text("cdr") + _text_map(metadata)
        self._channels.append(_record(CHANNEL, body))
        self._counts[number] = 0
        self._write(self._channels[-1])
        return number

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Write a file into the file."""
        body = struct.pack("<QQ", 0, 0) + _text(name) + _text(media_type) + struct.pack("<Q", len(data)) + data
        record = _record(ATTACHMENT, body + struct.pack("<I", zlib.crc32(body)))
        index = struct.pack("<QQQQQ", self._size, len(record), 0, 0, len(data)) + _text(name) + _text(media_type)
        self._write(record)
        self._attachment_indexes.append(_record(ATTACHMENT_INDEX, index))

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a named table of texts."""
        record = _record(METADATA, _text(name) + _text_map(values))
        index = struct.pack("<QQ", self._size, len(record)) + _text(name)
        self._write(record)
        self._metadata_indexes.append(_record(METADATA_INDEX, index))

    def write_chunk(self, messages: Iterable[Message]) -> None:
        """Write messages, compressed together, and their index."""
        pieces: list[Buffer] = []
        places: dict[int, list[tuple[int, int]]] = {}
        size = 0
        for message in messages:
            length = 22 + sum(map(len, message.parts))
            number = message.sequence & 0xFFFFFFFF
            times = message.log_time_ns, message.publish_time_ns
            pieces += [struct.pack("<BQHIQQ", MESSAGE, length, message.channel, number, *times), *message.parts]
            places.setdefault(message.channel, []).append((message.log_time_ns, size))
            size += 9 + length
        raw = self._gather(pieces, size)
        log_times = [time_ns for entries in places.values() for time_ns, _ in entries]
        first_ns, last_ns = min(log_times), max(log_times)

        packed = self._compressor.compress(raw, zstd.ZstdCompressor.FLUSH_FRAME)
        span = struct.pack("<QQ", first_ns, last_ns)
        head = span + struct.pack("<QI", len(raw), zlib.crc32(raw)) + _text("zstd") + struct.pack("<Q", len(packed))
        chunk_length = 9 + len(head) + len(packed)
        offsets, indexes = [], []
        offset = self._size + chunk_length
        for channel, entries in places.items():
            body = b"".join(struct.pack("<QQ", *entry) for entry in entries)
            indexes.append(_record(MESSAGE_INDEX, struct.pack("<HI", channel, len(body)) + body))
            offsets.append(struct.pack("<HQ", channel, offset))
            offset += len(indexes[-1])
        index_length = offset - self._size - chunk_length
        body = (
            span
            + struct.pack("<QQI", self._size, chunk_length, 10 * len(offsets))
            + b"".join(offsets)
            + struct.pack("<Q", index_length)
            + _text("zstd")
            + struct.pack("<QQ", len(packed), len(raw))
        )
        self._write(struct.pack("<BQ", CHUNK, len(head) + len(packed)) + head, packed, *indexes)

        self._chunk_indexes.append(_record(CHUNK_INDEX, body))
        for channel, entries in places.items():
            self._counts[channel] += len(entries)
        self._first_ns, self._last_ns = min(self._first_ns, first_ns), max(self._last_ns, last_ns)

    def _gather(self, pieces: list[Buffer], size: int) -> memoryview:
        """Lay pieces one after the other, in memory that is kept: fresh pages cost more than the copy."""
        if len(self._scratch) < size:
            self._scratch = bytearray(size)
        view = memoryview(self._scratch)[:size]
        offset = 0
        for piece in pieces:
            view[offset : offset + len(piece)] = piece
            offset += len(piece)
        return view

    def finish(self) -> None:
        """Write the summary, which lets readers seek at once, and the footer."""
        data_end = _record(DATA_END, struct.pack("<I", 0))
        start = self._size + len(data_end)
        groups = [
            (SCHEMA, self._schemas),
            (CHANNEL, self._channels),
            (STATISTICS, [self._statistics()]),
            (CHUNK_INDEX, self._chunk_indexes),
            (ATTACHMENT_INDEX, self._attachment_indexes),
            (METADATA_INDEX, self._metadata_indexes),
        ]
        summary, offsets = b"", b""
        for opcode, records in groups:
            if records:
                group = b"".join(records)
                offsets += _record(SUMMARY_OFFSET, struct.pack("<BQQ", opcode, start + len(summary), len(group)))
                summary += group
        footer = struct.pack("<BQQQ", FOOTER, 20, start, start + len(summary))
        checksum = zlib.crc32(summary + offsets + footer)
        self._write(data_end + summary + offsets + footer + struct.pack("<I", checksum) + MAGIC)

    def _statistics(self) -> bytes:
        total = sum(self._counts.values())
        counts = b"".join(struct.pack("<HQ", *item) for item in self._counts.items())
        body = struct.pack(
            "<QHIIIIQQI",
            total,
            len(self._schemas),
            len(self._channels),
            len(self._attachment_indexes),
            len(self._metadata_indexes),
            len(self._chunk_indexes),
            self._first_ns if total else 0,
            self._last_ns,
            len(counts),
        )
        return _record(STATISTICS, body + counts)

    def _write(self, *pieces: bytes) -> None:
        """Write all of it or nothing."""
        try:
            for piece in pieces:
                rest = memoryview(piece)
                while rest:
                    rest = rest[self._file.write(rest) :]
        except OSError:
            self._file.seek(self._size)
            self._file.truncate()
            raise
        self._size += sum(map(len, pieces))


def _record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _text_map(values: dict[str, str]) -> bytes:
    data = b"".join(_text(key) + _text(value) for key, value in values.items())
    return struct.pack("<I", len(data)) + data
