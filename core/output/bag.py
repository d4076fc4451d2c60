"""ROS 2 bags in MCAP: the container, what Tactune puts into every one, and bags of contact patches."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from mcap.writer import CompressionType, Writer

from ..errors import ExportError
from ..model.arrays import Float32Array, Float64Array
from ..model.files import user_path
from ..model.frames import Rig
from ..model.rig_file import json_text, rig_to_json
from ..preset import Preset
from ..preset.file import preset_json
from ..sources.mcap.messages import (
    FORMAT_VERSION,
    METADATA_NAME,
    POINT_CLOUD,
    PRESET_NAME,
    RIG_NAME,
    Topic,
)
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

#: A chunk ends with its frame, not at a size.
_CHUNK_BYTES: Final = 2**40


@dataclass(frozen=True)
class Message:
    """One message of a channel; ``parts`` are its bytes in pieces."""

    channel: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    parts: tuple[Buffer, ...]


class McapWriter:
    """An MCAP file that is being written: metadata, attachments and channels, then chunks, then `finish`.

    LZ4 takes 5 ms for a frame of four 640 x 480 images and leaves 75 % of its bytes.

    Parameters
    ----------
    file : FileIO
        New and unbuffered. The caller closes it.
    metadata : dict of str
        Texts by name.
    files : mapping of name to bytes
        Files to keep inside.
    topics : mapping of topic to message type
        A channel of messages in CDR is made for each.

    Attributes
    ----------
    channels : dict of topic to int
        The number of each channel.

    Raises
    ------
    OSError
        From the constructor and every method: the disk is full, or the operating system refuses otherwise. The file
        then ends with the last complete chunk and must not be written any more.
    """

    def __init__(
        self, file: FileIO, metadata: dict[str, str], files: Mapping[str, bytes], topics: Mapping[str, str]
    ) -> None:
        self._output = _Output(file)
        output: Any = self._output
        self._writer: Any = Writer(output, chunk_size=_CHUNK_BYTES, compression=CompressionType.LZ4)
        self._writer.start("ros2", f"tactune {version('tactune')}")
        self._writer.add_metadata(METADATA_NAME, metadata)
        for name, data in files.items():
            media_type = "application/json" if name.endswith(".json") else "application/octet-stream"
            self._writer.add_attachment(0, 0, name, media_type, data)
        kinds = dict.fromkeys(topics.values())
        schemas = {kind: self._writer.register_schema(kind, "ros2msg", definition(kind).encode()) for kind in kinds}
        self.channels: dict[str, int] = {}
        for topic, kind in topics.items():
            qos = STATIC_QOS if topic in SAID_ONCE else ""
            about = {"offered_qos_profiles": qos, "topic_type_hash": type_hash(kind)}
            self.channels[topic] = self._writer.register_channel(topic, "cdr", schemas[kind], about)

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._output.size

    def write_chunk(self, messages: Sequence[Message]) -> None:
        """Write messages, compressed together, and their index."""
        for message in messages:
            number, data = message.sequence & 0xFFFFFFFF, b"".join(message.parts)
            self._writer.add_message(message.channel, message.log_time_ns, data, message.publish_time_ns, number)
        with self._output.whole():
            self._writer.flush()

    def finish(self) -> None:
        """Write the summary, by which readers seek, and the footer."""
        with self._output.whole():
            self._writer.finish()


class _Output:
    """The file as the library's writer sees it."""

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self.size = 0

    def write(self, data: Buffer) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]
        self.size += len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Do nothing: the file has no buffer."""

    @contextmanager
    def whole(self) -> Iterator[None]:
        """Remove what was written inside where the operating system refuses a part of it."""
        before = self.size
        try:
            yield
        except OSError:
            self._file.seek(before)
            self._file.truncate()
            self.size = before
            raise


class Bag:
    """A new ROS 2 bag in MCAP with the rig and the preset inside.

    Parameters
    ----------
    path : path of the new file
        Its folder is made if missing.
    topics : mapping of topic to message type
        All topics that there will be.
    rig : Rig
    preset : Preset or None
    frame_rate_hz : float
    attachments : mapping of name to bytes
        Further files to keep inside.

    Raises
    ------
    ExportError
        From the constructor: there is such a file already. From every method: the operating system
        refuses to write; what was written before stays readable, and nothing is written any more.
    """

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
        files = {RIG_NAME: json_text(rig_to_json(rig)).encode(), **(attachments or {})}
        if preset is not None:
            files[PRESET_NAME] = preset_json(preset).encode()
        if self.path.exists():
            raise ExportError(f"{self.path} is already there; choose another name or remove it")
        with self._refusals():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("xb", buffering=0)
        try:
            with self._refusals():
                about = {"format_version": str(FORMAT_VERSION), "frame_rate_hz": repr(float(frame_rate_hz))}
                self._writer = McapWriter(self._file, about, files, topics)
        except BaseException:
            self._discard()
            raise

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._writer.size

    def channel(self, topic: str) -> int:
        """Return the channel number of a topic."""
        return self._writer.channels[topic]

    def write(self, messages: list[Message]) -> None:
        """Write messages as one chunk; the operating system has it when this returns."""
        try:
            with self._refusals():
                self._writer.write_chunk(messages)
        except ExportError:
            self._is_cut_off = True
            raise
        self._chunks += 1

    def sync(self) -> None:
        """Wait until the disk has what was written."""
        with self._refusals():
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write the index, or remove a file without messages; twice is harmless."""
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


class PatchWriter:
    """Writes patches on the topic ``/contact/patch``, with the rig and the preset in the file.

    With poses also ``/object/pose`` (``geometry_msgs/PoseWithCovarianceStamped``) and the frame ``object`` in ``/tf``.

    A context manager that finishes the file, also after an error; without a patch it removes it.

    Parameters
    ----------
    path : path of the new file
    rig : Rig
    preset : Preset
    frame_rate_hz : float
    poses : bool
        Whether there will be poses of an object.

    Raises
    ------
    ExportError
        There is such a file already, or it cannot be written.
    """

    def __init__(
        self, path: Path | str, rig: Rig, preset: Preset, frame_rate_hz: float, *, poses: bool = False
    ) -> None:
        self._clock = LogClock(1.0 / frame_rate_hz)
        topics: dict[str, str] = {Topic.PATCH: POINT_CLOUD}
        if poses:
            topics |= POSE_TOPICS
        self._bag = Bag(path, topics, rig, preset, frame_rate_hz)

    def write(
        self,
        points: Float32Array,
        sequence: int,
        time_s: float,
        pose: tuple[Float64Array, Float64Array] | None = None,
    ) -> None:
        """Write one patch, and the pose of the object.

        Parameters
        ----------
        points : float32, shape (N, 3)
            Metres in the proximity camera's depth frame; none make an empty cloud.
        sequence : int
            Number of its frame.
        time_s : float
            The proximity time stamp of its frame.
        pose : (float64 (4, 4), float64 (6, 6)), optional
            ``T_proximity_object`` and its covariance, as `tactune.core.output.messages.pose_with_covariance` takes it.

        Raises
        ------
        ExportError
            The operating system refuses; the patches before stay readable.
        """
        stamp_ns = nanoseconds(time_s)
        log_ns = self._clock.tick(stamp_ns)
        parts: dict[str, bytes] = {Topic.PATCH: point_cloud(points, stamp_ns)}
        if pose is not None:
            parts |= pose_parts(*pose, stamp_ns)
        self._bag.write(
            [
                Message(self._bag.channel(topic), sequence, log_ns, max(stamp_ns, 0), (data,))
                for topic, data in parts.items()
            ]
        )

    def close(self) -> None:
        """Finish the file; twice is harmless."""
        self._bag.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
