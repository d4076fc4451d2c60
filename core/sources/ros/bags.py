"""ROS recordings as containers: messages by topic and number, whatever program wrote them.

`open_bag` opens ROS 1 bags, ROS 2 bags in SQLite and MCAP, and the folder that ``ros2 bag record`` writes.
"""

from __future__ import annotations

import re
import sqlite3
import struct
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from contextlib import ExitStack
from functools import lru_cache
from io import BytesIO
from pathlib import Path, PurePath
from threading import Lock
from typing import Any, Final

import numpy as np
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.rosbag1.reader import Header, IndexData, RecordType, read_uint32
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from ...errors import SourceError, closed_on_error, foreign
from ...model.arrays import Int64Array
from ...model.loading import read_file
from ..base import Progress
from ..ros_image import DamagedFileError, damage_told
from .mcap import MAGIC, McapBag
from .messages import ZSTD_MAGIC, Bag, long_name, stamp_ns, unpack_file, unpacked

METADATA: Final = "metadata.yaml"
#: More than that of a recording with hundreds of topics and files.
_MAX_METADATA_BYTES: Final = 500_000
#: Endings of the files in a folder of ``ros2 bag record``.
BAG_ENDINGS: Final = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
SQLITE_MAGIC: Final = b"SQLite format 3\x00"
ROS1_MAGIC: Final = b"#ROSBAG V"
_CACHED_CHUNKS: Final = 4
#: A message begins with four bytes of CDR and its stamp.
_HEAD_BYTES: Final = 12


class SqliteBag(Bag):
    """A ROS 2 bag in an SQLite database; each message may be compressed with zstd."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        uri = path.resolve().as_uri() + "?mode=ro&immutable=1"
        self._lock = Lock()
        self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        with closed_on_error(self.close):
            if self._select("SELECT 1 FROM sqlite_master WHERE type = 'view'"):  # one can have rows without end
                raise DamagedFileError("it computes its messages")
            topics = self._select("SELECT id, name, type FROM topics WHERE serialization_format = 'cdr' ORDER BY id")
            self._rows: defaultdict[str, list[tuple[int, int]]] = defaultdict(list)
            for number, topic, kind in topics:
                query = "SELECT timestamp, id FROM messages WHERE topic_id = ?"
                if rows := self._select(query, number):
                    self.types[topic] = long_name(kind)
                    self._rows[topic] += [(int(time_ns), int(row)) for time_ns, row in rows]
            for found in self._rows.values():
                found.sort()

    def count(self, topic: str) -> int:
        return len(self._rows.get(topic, ()))

    def raw(self, topic: str, index: int) -> memoryview:
        found = self._select("SELECT data FROM messages WHERE id = ?", self._rows[topic][index][1])
        if not found or not isinstance(found[0][0], bytes):
            raise DamagedFileError(f"message {index} of {topic} is missing")
        return unpacked(memoryview(found[0][0]))

    def stamp_ns(self, topic: str, index: int) -> int:
        """Return the stamp; of a message that is not compressed, nothing else is read."""
        with (
            self._lock,
            self._database.blobopen("messages", "data", self._rows[topic][index][1], readonly=True) as blob,
        ):
            head = blob.read(_HEAD_BYTES)
        return super().stamp_ns(topic, index) if head.startswith(ZSTD_MAGIC) else stamp_ns(head)

    def times_ns(self, topic: str) -> Int64Array:
        return np.array([time_ns for time_ns, _ in self._rows.get(topic, ())], np.int64)

    def close(self) -> None:
        self._database.close()

    def _select(self, query: str, *values: int) -> list[tuple[Any, ...]]:
        with self._lock:
            return self._database.execute(query, values).fetchall()


class Ros1Bag(Bag):
    """A ROS 1 bag; one that was cut off ends with its last complete chunk."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._lock = Lock()
        self._chunk = lru_cache(_CACHED_CHUNKS)(self._unpack)
        self._reader = Reader(path)
        try:
            self._reader.open()
        except ReaderError:
            self.complete = False
            self._reader = _Unfinished(path)
            with closed_on_error(self.close):
                self._reader.open()
        self._entries: defaultdict[str, list[IndexData]] = defaultdict(list)
        for each in self._reader.connections:  # a merged bag has several of one topic
            if each.msgcount:
                self.types[each.topic] = each.msgtype
                self._entries[each.topic] += self._reader.indexes[each.id]
        for entries in self._entries.values():
            entries.sort()

    def is_ros1(self, topic: str) -> bool:
        return True

    def count(self, topic: str) -> int:
        return len(self._entries.get(topic, ()))

    def raw(self, topic: str, index: int) -> memoryview:
        """Return a message; the index may point to the connection in front of it."""
        entry = self._entries[topic][index]
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

    def times_ns(self, topic: str) -> Int64Array:
        return np.array([entry.time for entry in self._entries.get(topic, ())], np.int64)

    def close(self) -> None:
        if self._reader.bio is not None:
            self._reader.bio.close()

    def _unpack(self, place: int) -> bytes:
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


class SplitBag(Bag):
    """The files of one recording, one after another, which ``ros2 bag record`` writes into a folder."""

    def __init__(self, paths: Sequence[Path], progress: Progress | None) -> None:
        super().__init__()
        self._resources = ExitStack()
        self._parts: list[Bag] = []
        with closed_on_error(self.close):
            for path in paths:
                part = open_bag([self._plain(path)], progress)
                self._resources.callback(part.close)
                self._parts.append(part)
                self.types |= part.types
        self.complete = all(part.complete for part in self._parts)

    def is_ros1(self, topic: str) -> bool:
        return any(part.is_ros1(topic) for part in self._parts if topic in part.types)

    def count(self, topic: str) -> int:
        return sum(part.count(topic) for part in self._parts)

    def raw(self, topic: str, index: int) -> memoryview:
        part, index = self._part(topic, index)
        return part.raw(topic, index)

    def stamp_ns(self, topic: str, index: int) -> int:
        part, index = self._part(topic, index)
        return part.stamp_ns(topic, index)

    def times_ns(self, topic: str) -> Int64Array:
        found = [part.times_ns(topic) for part in self._parts if topic in part.types]
        return np.concatenate(found) if found else np.empty(0, np.int64)

    def close(self) -> None:
        self._resources.close()

    def _part(self, topic: str, index: int) -> tuple[Bag, int]:
        """Return the file that holds a message, and its number there."""
        for part in self._parts:
            if index < part.count(topic):
                return part, index
            index -= part.count(topic)
        raise DamagedFileError(f"there is no message {index} of {topic}")

    def _plain(self, path: Path) -> Path:
        """Return a file that was compressed as a whole, unpacked into a folder that goes when the bag is closed."""
        if path.suffix != ".zstd":
            return path
        folder = Path(self._resources.enter_context(tempfile.TemporaryDirectory(prefix="tactune-")))
        unpack_file(path, folder / path.stem)
        return folder / path.stem


def open_bag(paths: Sequence[Path], progress: Progress | None = None) -> Bag:
    """Open a file by its content, the folder of ``ros2 bag record``, or the files of one recording.

    `SourceError` says what is wrong.
    """
    path = paths[0].parent if paths[0].name == METADATA else paths[0]
    with damage_told(path, "this is no readable ROS recording"):
        if path.is_dir():
            return SplitBag(_parts_of(path), progress)
        if len(paths) > 1:
            return SplitBag(sorted(paths, key=_number), progress)
        with path.open("rb") as file:
            start = file.read(32)
        if start.startswith(SQLITE_MAGIC):
            return SqliteBag(path)
        if start.startswith(ROS1_MAGIC):
            return Ros1Bag(path)
        if start and MAGIC.startswith(start[: len(MAGIC)]):
            return McapBag(path, progress)
        raise DamagedFileError("it begins neither as a ROS 1 bag nor as MCAP or SQLite" if start else "it is empty")


def _parts_of(folder: Path) -> list[Path]:
    """Return the files of a recording in the order of time."""
    names = _names_in(folder / METADATA)
    if names is None:
        paths = sorted((path for ending in BAG_ENDINGS for path in folder.glob(f"*{ending}")), key=_number)
        if not paths:
            raise SourceError(f"{folder} holds no recording ({', '.join(BAG_ENDINGS)}); choose another folder")
        if len(starts := {re.sub(r"(_\d+)?\..*", "", path.name) for path in paths}) != 1:
            raise SourceError(
                f"{folder} has no {METADATA} that can be read, and files of {len(starts)} recordings "
                f"({', '.join(foreign(name, 40) for name in sorted(starts)[:4])}); choose the files of one"
            )
        return paths
    paths = [folder / name for name in dict.fromkeys(PurePath(name).name for name in names)]
    if missing := [path for path in paths if not path.is_file()]:
        raise SourceError(f"{folder} lacks {missing[0].name}, which {METADATA} names; copy all files of the recording")
    if not paths:
        raise SourceError(f"{folder / METADATA} names no file; choose the files of the recording")
    return paths


def _names_in(metadata: Path) -> list[str] | None:
    """Return the files that metadata name; None where a recorder that was killed wrote none, or a part."""
    try:
        text = read_file(metadata, _MAX_METADATA_BYTES).decode("utf-8")
        names = YAML(typ="safe").load(text)["rosbag2_bagfile_information"]["relative_file_paths"]
    except (OSError, ValueError, YAMLError, LookupError, TypeError):
        return None
    are_names = isinstance(names, list) and all(isinstance(name, str) and name.endswith(BAG_ENDINGS) for name in names)
    return names if are_names else None


def _number(path: Path) -> tuple[int, str]:
    """Return what puts the files of a recording, ``NAME_0.mcap`` and so on, in order."""
    found = re.search(r"_(\d+)\.", path.name)
    return int(found[1]) if found else 0, path.name
