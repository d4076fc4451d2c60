"""ROS 2 bags in MCAP: what Tactune puts into every one, and bags of contact patches."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from io import FileIO
from pathlib import Path
from typing import Any, Final, Self

from mcap.writer import CompressionType, Writer

from ..errors import ExportError
from ..model.arrays import Float32Array, Float64Array
from ..model.files import taken, user_path
from ..model.frames import Rig
from ..model.rig_file import json_text, rig_to_json
from ..preset import Preset
from ..preset.file import preset_json
from ..sources.mcap.messages import FORMAT_VERSION, METADATA_NAME, POINT_CLOUD, PRESET_NAME, RIG_NAME, Topic
from .messages import (
    POSE_TOPICS,
    SAID_ONCE,
    STATIC_QOS,
    LogClock,
    definition,
    nanoseconds,
    point_cloud,
    pose_parts,
    type_hash,
)

Buffer = bytes | bytearray | memoryview
#: One message: its topic, its time stamp in nanoseconds, and its bytes in pieces.
Message = tuple[str, int, tuple[Buffer, ...]]

#: A chunk ends with its frame, not at a size.
_CHUNK_BYTES: Final = 2**40


class Bag:
    """A new ROS 2 bag in MCAP with the rig and the preset inside. One call of `write` is one chunk."""

    def __init__(
        self,
        path: Path | str,
        topics: Mapping[str, str],
        rig: Rig,
        preset: Preset | None,
        frame_rate_hz: float,
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:
        self.path = user_path(path)
        self._chunks = 0
        self._is_cut_off = False
        with self._refusals():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                self._file = self.path.open("xb", buffering=0)
            except FileExistsError:
                raise taken(self.path) from None
        self._output = _Output(self._file)
        output: Any = self._output
        self._writer: Any = Writer(output, chunk_size=_CHUNK_BYTES, compression=CompressionType.LZ4)
        files = {RIG_NAME: json_text(rig_to_json(rig)).encode(), **(attachments or {})}
        if preset is not None:
            files[PRESET_NAME] = preset_json(preset).encode()
        try:
            with self._refusals():
                self._begin(topics, files, frame_rate_hz)
        except BaseException:
            self._discard()
            raise

    def _begin(self, topics: Mapping[str, str], files: Mapping[str, bytes], frame_rate_hz: float) -> None:
        writer = self._writer
        writer.start("ros2", f"tactune {version('tactune')}")
        about = {"format_version": str(FORMAT_VERSION), "frame_rate_hz": repr(float(frame_rate_hz))}
        writer.add_metadata(METADATA_NAME, about)
        for name, data in files.items():
            media_type = "application/json" if name.endswith(".json") else "application/octet-stream"
            writer.add_attachment(0, 0, name, media_type, data)
        kinds = dict.fromkeys(topics.values())
        schemas = {kind: writer.register_schema(kind, "ros2msg", definition(kind).encode()) for kind in kinds}
        self._channels: dict[str, int] = {}
        for topic, kind in topics.items():
            qos = STATIC_QOS if topic in SAID_ONCE else ""
            about = {"offered_qos_profiles": qos, "topic_type_hash": type_hash(kind)}
            self._channels[topic] = writer.register_channel(topic, "cdr", schemas[kind], about)

    @property
    def size(self) -> int:
        return self._output.size

    def write(self, sequence: int, log_time_ns: int, messages: Sequence[Message]) -> None:
        """Write messages compressed together, with their index; the operating system has them when this returns."""
        try:
            with self._refusals():
                for topic, stamp_ns, parts in messages:
                    data, number = b"".join(parts), sequence & 0xFFFFFFFF
                    self._writer.add_message(self._channels[topic], log_time_ns, data, max(stamp_ns, 0), number)
                self._writer.flush()
        except ExportError:
            self._is_cut_off = True
            raise
        self._chunks += 1

    def sync(self) -> None:
        with self._refusals():
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write the summary, by which readers seek, or remove a file without messages; twice is harmless."""
        if self._file.closed:
            return
        if self._chunks == 0:
            self._discard()
            return
        try:
            if not self._is_cut_off:
                with self._refusals():
                    self._writer.finish()
            self.sync()
        finally:
            self._file.close()

    def _discard(self) -> None:
        self._file.close()
        self.path.unlink(missing_ok=True)

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise ExportError(f"cannot write {self.path}: {error.strerror or error}; choose another place") from error


class _Output:
    """The file as the library's writer sees it, without a buffer that a full disk would leave filled."""

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self.size = 0

    def write(self, data: Buffer) -> None:
        rest = memoryview(data)
        while rest:
            written = self._file.write(rest)
            self.size += written
            rest = rest[written:]

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Do nothing: the file has no buffer."""


class PatchWriter:
    """Writes patches on ``/contact/patch``, and with ``poses`` those of an object on ``/object/pose`` and ``/tf``."""

    def __init__(
        self, path: Path | str, rig: Rig, preset: Preset, frame_rate_hz: float, *, poses: bool = False
    ) -> None:
        self._clock = LogClock(1.0 / frame_rate_hz)
        topics = {Topic.PATCH: POINT_CLOUD, **(POSE_TOPICS if poses else {})}
        self._bag = Bag(path, topics, rig, preset, frame_rate_hz)

    def write(
        self,
        points: Float32Array,
        sequence: int,
        time_s: float,
        pose: tuple[Float64Array, Float64Array] | None = None,
    ) -> None:
        """Write one patch, (N, 3) in metres, and the pose of the object: (4, 4) and its covariance, (6, 6)."""
        stamp_ns = nanoseconds(time_s)
        parts: dict[str, bytes] = {Topic.PATCH: point_cloud(points, stamp_ns)}
        if pose is not None:
            parts |= pose_parts(*pose, stamp_ns)
        messages: list[Message] = [(topic, stamp_ns, (data,)) for topic, data in parts.items()]
        self._bag.write(sequence, self._clock.tick(stamp_ns), messages)

    def close(self) -> None:
        """Finish the file, or remove one without a patch."""
        self._bag.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
