"""Recordings: frames written while they are taken, on a thread, and any source converted."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from io import FileIO
from pathlib import Path
from typing import Any, Final

from mcap.writer import CompressionType, Writer

from ..errors import ExportError, TactuneError, closed_on_error, counted, writing
from ..model.arrays import Float64Array
from ..model.files import Closing, atomic_path, remove_leftovers, taken, user_path
from ..model.frames import Rig, SensorFrame
from ..model.loading import frame_bytes
from ..model.patch import ContactPatch
from ..model.rig_file import json_text, rig_to_json
from ..preset import Preset
from ..preset.file import preset_json
from ..sources.base import FrameSource, Progress, frames_to_write
from ..sources.ros import messages as ros
from ..sources.ros.messages import Topic
from . import messages

Buffer = bytes | bytearray | memoryview
#: One message: its topic, its time stamp in nanoseconds, and its bytes in pieces.
Message = tuple[str, int, tuple[Buffer, ...]]

#: A chunk ends with its frame, not at a size.
_CHUNK_BYTES: Final = 2**40


class BagWriter:
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
        self.chunks = 0
        self._is_cut_off = False
        with writing(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                self._file = self.path.open("xb", buffering=0)
            except FileExistsError:
                raise taken(self.path) from None
        self._output = _Output(self._file)
        output: Any = self._output
        self._writer: Any = Writer(output, chunk_size=_CHUNK_BYTES, compression=CompressionType.LZ4)
        files = {ros.RIG_NAME: json_text(rig_to_json(rig)).encode(), **(attachments or {})}
        if preset is not None:
            files[ros.PRESET_NAME] = preset_json(preset).encode()
        with closed_on_error(self._discard), writing(self.path):
            self._begin(topics, files, frame_rate_hz)

    def _begin(self, topics: Mapping[str, str], files: Mapping[str, bytes], frame_rate_hz: float) -> None:
        writer = self._writer
        writer.start("ros2", f"tactune {version('tactune')}")
        about = {"format_version": str(ros.FORMAT_VERSION), "frame_rate_hz": repr(float(frame_rate_hz))}
        writer.add_metadata(ros.METADATA_NAME, about)
        for name, data in files.items():
            media_type = "application/json" if name.endswith(".json") else "application/octet-stream"
            writer.add_attachment(0, 0, name, media_type, data)
        kinds = dict.fromkeys(topics.values())
        schemas = {kind: writer.register_schema(kind, "ros2msg", messages.definition(kind).encode()) for kind in kinds}
        self._channels: dict[str, int] = {}
        for topic, kind in topics.items():
            qos = messages.STATIC_QOS if topic in messages.SAID_ONCE else ""
            about = {"offered_qos_profiles": qos, "topic_type_hash": messages.type_hash(kind)}
            self._channels[topic] = writer.register_channel(topic, "cdr", schemas[kind], about)

    @property
    def size(self) -> int:
        return self._output.size

    def write(self, sequence: int, log_time_ns: int, found: Sequence[Message]) -> None:
        """Write messages compressed together, with their index; the operating system has them when this returns."""
        try:
            with writing(self.path):
                for topic, stamp_ns, parts in found:
                    data, number = b"".join(parts), sequence & 0xFFFFFFFF
                    self._writer.add_message(self._channels[topic], log_time_ns, data, max(stamp_ns, 0), number)
                self._writer.flush()
        except ExportError:
            self._is_cut_off = True
            raise
        self.chunks += 1

    def sync(self) -> None:
        with writing(self.path):
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write the summary, by which readers seek, or remove a file without messages; twice is harmless."""
        if self._file.closed:
            return
        if self.chunks == 0:
            self._discard()
            return
        try:
            if not self._is_cut_off:
                with writing(self.path):
                    self._writer.finish()
            self.sync()
        finally:
            self._file.close()

    def _discard(self) -> None:
        self._file.close()
        self.path.unlink(missing_ok=True)


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


class PatchWriter(Closing):
    """Writes patches, as live connections have them, and with ``poses`` those of an object."""

    def __init__(
        self, path: Path | str, rig: Rig, preset: Preset, frame_rate_hz: float, *, poses: bool = False
    ) -> None:
        self._clock = messages.LogClock(1.0 / frame_rate_hz)
        topics = messages.topics_of(preset) | (messages.POSE_TOPICS if poses else {})
        self._bag = BagWriter(path, topics, rig, preset, frame_rate_hz)

    def write(self, patch: ContactPatch, time_s: float, pose: tuple[Float64Array, Float64Array] | None = None) -> None:
        """Write one patch, and the pose of the object: (4, 4) and its covariance, (6, 6)."""
        stamp_ns = messages.nanoseconds(time_s)
        parts = messages.patch_parts(patch, stamp_ns)
        if pose is not None:
            parts |= messages.pose_parts(*pose, stamp_ns)
        found: list[Message] = [(topic, stamp_ns, (data,)) for topic, data in parts.items()]
        with self._kept_told():
            self._bag.write(patch.sequence, self._clock.tick(stamp_ns), found)

    def close(self) -> None:
        """Finish the file, or remove one without a patch."""
        with self._kept_told():
            self._bag.close()

    @contextmanager
    def _kept_told(self) -> Iterator[None]:
        try:
            yield
        except ExportError as error:
            kept = f"; the file holds the {counted(self._bag.chunks, 'frame')} before" if self._bag.chunks else ""
            raise ExportError(f"{error}{kept}") from error


#: Patch and findings of a frame, as messages.
Results = Callable[[SensorFrame], Mapping[str, bytes]]

#: Memory limit of the queue: about two seconds of a full rig; one frame is always accepted.
_QUEUE_BYTES = 256 * 2**20

#: Time between two writes to the disk, which a power failure may lose; a killed process loses the queue only.
_SYNC_EVERY_S = 2.0


@dataclass(frozen=True)
class RecordingStatus:
    """State of a recording; ``dropped`` frames found the queue full or came after an error, a sentence or empty."""

    path: Path
    frames: int
    dropped: int
    bytes: int
    seconds: float
    error: str


class SessionWriter(Closing):
    """Writes frames to a ROS 2 bag in MCAP, as `tactune.core.sources.ros.messages` describes it.

    A thread serialises, compresses and writes; `put` only queues. One frame is one chunk, written at once, so a killed
    process loses the frames in the queue only. Where the disk is full, the file keeps the frames that it has.

    Parameters
    ----------
    path : path of the new file
    rig : Rig
        Every frame must fit it.
    preset : Preset, optional
        Kept in the file.
    frame_rate_hz : float
        The source's rate, for playback.
    untouched : SensorFrame, optional
        A frame of the untouched membrane, kept in the file.
    results : callable, optional
        Returns patch and findings of each frame; called on the writing thread.

    Raises
    ------
    ExportError
        There is such a file already, or it cannot be written.
    """

    def __init__(
        self,
        path: Path | str,
        rig: Rig,
        *,
        preset: Preset | None = None,
        frame_rate_hz: float = 30.0,
        untouched: SensorFrame | None = None,
        results: Results | None = None,
    ) -> None:
        self._rig, self._preset, self._results = rig, preset, results
        self._streams = messages.image_streams(rig)
        self._clock = messages.LogClock(1.0 / frame_rate_hz)
        attachments = {} if untouched is None else {ros.UNTOUCHED_NAME: frame_bytes(untouched)}
        self._bag = BagWriter(path, self._topics(), rig, preset, frame_rate_hz, attachments)
        self._queue: deque[tuple[SensorFrame, int]] = deque()
        self._waiting_bytes = 0
        self._changed = threading.Condition()
        self._closing = False
        self._accepted = self._frames = self._dropped = 0
        self._first_ns = self._last_ns = 0
        self._error = ""
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    def put(self, frame: SensorFrame, *, wait: bool) -> bool:
        """Queue a frame and return whether it will be written; `FrameError` if it does not fit the rig.

        ``wait`` for room where the source can wait; else a frame that finds none is dropped and counted.
        """
        size = self._check(frame)
        with self._changed:
            while wait and not self._has_room(size) and not self._error and not self._closing:
                self._changed.wait()
            if self._error or self._closing or not self._has_room(size):
                self._dropped += 1
                return False
            self._queue.append((frame, size))
            self._accepted += 1
            self._waiting_bytes += size
            self._changed.notify_all()
        return True

    def status(self) -> RecordingStatus:
        with self._changed:
            return RecordingStatus(
                path=self._bag.path,
                frames=self._frames,
                dropped=self._dropped,
                bytes=self._bag.size,
                seconds=(self._last_ns - self._first_ns) * 1e-9,
                error=self._error,
            )

    def close(self) -> RecordingStatus:
        """Write the queued frames, finish the file, or remove one without frames, and return its state."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        return self.status()

    def _topics(self) -> dict[str, str]:
        topics: dict[str, str] = {Topic.FRAME: ros.TEXT, Topic.RIG: ros.TEXT, Topic.STATIC_TRANSFORMS: ros.TRANSFORMS}
        topics |= {**messages.topics_of(self._preset), Topic.FINDINGS: ros.TEXT} if self._results is not None else {}
        for stream in self._streams.values():
            topics[stream.topic] = ros.IMAGE
            if stream.lens is not None:
                topics[stream.topic.camera_info] = ros.CAMERA_INFO
        return topics

    def _check(self, frame: SensorFrame) -> int:
        """Return the size of a frame in bytes; `FrameError` if it does not fit the rig."""
        size = 0
        for topic, image in messages.images_of(frame, self._rig):
            self._streams[topic].check(image, frame.sequence)
            size += image.nbytes
        return size

    def _has_room(self, size: int) -> bool:
        return not self._waiting_bytes or self._waiting_bytes + size <= _QUEUE_BYTES

    def _run(self) -> None:
        self._attempt(self._write_frames)
        with self._changed:  # after an error the queue is not written
            self._dropped += self._accepted - self._frames
            self._queue.clear()
            self._changed.notify_all()
        self._attempt(self._close)

    def _attempt(self, step: Callable[[], None]) -> None:
        """Do a step and keep the first error for `status`: nobody can catch an exception of this thread."""
        try:
            step()
        except Exception as error:
            known = isinstance(error, TactuneError)
            cause = str(error) if known else f"cannot continue writing {self._bag.path} ({error!r})"
            with self._changed:
                self._error = self._error or cause
                self._changed.notify_all()

    def _close(self) -> None:
        self._bag.close()
        if not self._frames:
            raise ExportError(f"no frame arrived for {self._bag.path}, so there is no file; check the source")

    def _write_frames(self) -> None:
        synced_s = time.monotonic()
        while (frame := self._next()) is not None:
            self._write(frame)
            if time.monotonic() - synced_s > _SYNC_EVERY_S:
                self._bag.sync()
                synced_s = time.monotonic()

    def _next(self) -> SensorFrame | None:
        """Wait for a frame; None when the recording is closed and all are written."""
        with self._changed:
            self._changed.wait_for(lambda: self._queue or self._closing)
            if not self._queue:
                return None
            frame, size = self._queue.popleft()
            self._waiting_bytes -= size
            self._changed.notify_all()
            return frame

    def _write(self, frame: SensorFrame) -> None:
        proximity_ns, tactile_ns = map(messages.nanoseconds, (frame.proximity_time_s, frame.tactile_time_s))
        log_ns = self._clock.tick(proximity_ns)
        found: list[Message] = [(Topic.FRAME, proximity_ns, (messages.frame_text(frame),))]
        if not self._frames:
            rig = messages.text(json_text(rig_to_json(self._rig)))
            found.append((Topic.RIG, proximity_ns, (rig,)))
            found.append(
                (Topic.STATIC_TRANSFORMS, proximity_ns, (messages.static_transforms(self._rig, proximity_ns),))
            )
        for topic, image in messages.images_of(frame, self._rig):
            stream = self._streams[topic]
            stamp_ns = tactile_ns if stream.of_tactile else proximity_ns
            found.append((topic, stamp_ns, stream.parts(image, frame.sequence, stamp_ns)))
            if stream.lens is not None:
                found.append((topic.camera_info, stamp_ns, (messages.stamped(stream.lens, stamp_ns),)))
        if self._results is not None:
            found += [(topic, proximity_ns, (data,)) for topic, data in self._results(frame).items()]
        self._bag.write(frame.sequence, log_ns, found)
        with self._changed:
            self._first_ns = self._first_ns if self._frames else log_ns
            self._last_ns = log_ns
            self._frames += 1


def export_mcap(
    source: FrameSource,
    path: Path | str,
    frames: int | None = None,
    *,
    preset: Preset | None = None,
    untouched: SensorFrame | None = None,
    results: Results | None = None,
    progress: Progress | None = None,
    exclusive: bool = False,
) -> int:
    """Write at most ``frames`` of a source, from its present position, whole or not at all; return how many."""
    remove_leftovers(Path(path).parent, Path(path).name)
    with atomic_path(path, exclusive=exclusive) as temporary:
        try:
            with SessionWriter(
                temporary,
                source.rig,
                preset=preset,
                frame_rate_hz=source.frame_rate_hz,
                untouched=source.untouched() if untouched is None else untouched,
                results=results,
            ) as writer:
                for frame in frames_to_write(source, frames, progress):
                    if not writer.put(frame, wait=True):
                        break
            status = writer.status()
            if status.error:
                raise ExportError(status.error)
        except ExportError as error:  # which knows the temporary name only
            raise ExportError(str(error).replace(str(temporary), str(path))) from error
    return status.frames
