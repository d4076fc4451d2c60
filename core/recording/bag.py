"""What a session and a file of patches have in common: a new ROS 2 bag that says what it was made with."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

from ..errors import ExportError
from ..model.files import user_path
from ..model.frames import Rig
from ..model.rig_file import json_text, rig_to_json
from ..preset import Preset
from ..preset.file import preset_json
from ..sources.mcap.container import McapWriter, Message
from ..sources.mcap.messages import (
    FORMAT_VERSION,
    METADATA_NAME,
    PRESET_NAME,
    RIG_NAME,
    SAID_ONCE,
    STATIC_QOS,
    definition,
    type_hash,
)


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
        refuses to write; what was written before stays readable.
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
                self._writer = McapWriter(self._file, f"tactune {version('tactune')}")
                about = {"format_version": str(FORMAT_VERSION), "frame_rate_hz": repr(float(frame_rate_hz))}
                self._writer.add_metadata(METADATA_NAME, about)
                for name, data in files.items():
                    media_type = "application/json" if name.endswith(".json") else "application/octet-stream"
                    self._writer.attach(name, media_type, data)
                self._channels = self._add_channels(topics)
        except BaseException:
            self._discard()
            raise

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._writer.size

    def channel(self, topic: str) -> int:
        """Return the number of a topic."""
        return self._channels[topic]

    def write(self, messages: list[Message]) -> None:
        """Write messages as one chunk; the operating system has it when this returns."""
        with self._refusals():
            self._writer.write_chunk(messages)
        self._chunks += 1

    def sync(self) -> None:
        """Have the disk hold what was written."""
        with self._refusals():
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Finish the file, or remove it where it has no messages; twice is harmless."""
        if self._file.closed:
            return
        if self._chunks == 0:
            self._discard()
            return
        try:
            with self._refusals():
                self._writer.finish()
            self.sync()
        finally:
            self._file.close()

    def _add_channels(self, topics: Mapping[str, str]) -> dict[str, int]:
        schemas = {kind: self._writer.add_schema(kind, definition(kind)) for kind in dict.fromkeys(topics.values())}
        channels = {}
        for topic, kind in topics.items():
            qos = STATIC_QOS if topic in SAID_ONCE else ""
            metadata = {"offered_qos_profiles": qos, "topic_type_hash": type_hash(kind)}
            channels[topic] = self._writer.add_channel(topic, schemas[kind], metadata)
        return channels

    def _discard(self) -> None:
        self._file.close()
        self.path.unlink(missing_ok=True)

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise ExportError(f"cannot write {self.path}: {error.strerror or error}; choose another place") from error
