"""What a session and a file of patches have in common: a new MCAP file that says what it was made with."""

from __future__ import annotations

import os
from importlib.metadata import version
from pathlib import Path
from typing import Final

from ..errors import ExportError
from ..frames import Rig
from ..paths import user_path
from ..preset import Preset
from ..preset_file import preset_json
from ..rig_file import json_text, rig_to_json
from .container import McapWriter, Message
from .messages import STATIC_QOS, definition, type_hash

#: Names inside the file.
METADATA_NAME: Final = "tactune"
RIG_NAME: Final = "rig.json"
PRESET_NAME: Final = "preset.json"
REFERENCE_NAME: Final = "reference.npz"

#: Grows when an older reader could not read a recording any more.
FORMAT_VERSION: Final = 1


class Bag:
    """A new ROS 2 bag with the rig and the preset inside; its topics must be added before messages.

    Parameters
    ----------
    path : path of the new file
        Its folder is made if missing.
    rig : Rig
    preset : Preset, optional
    frame_rate_hz : float

    Raises
    ------
    ExportError
        There is such a file already, or it cannot be written.
    """

    def __init__(self, path: Path | str, rig: Rig, preset: Preset | None, frame_rate_hz: float) -> None:
        self.path = user_path(path)
        self._types: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("xb", buffering=0)
        except FileExistsError as error:
            raise ExportError(f"{self.path} is already there; choose another name or remove it") from error
        except OSError as error:
            raise self.refusal(error) from error
        try:
            self._writer = McapWriter(self._file, f"tactune {version('tactune')}")
            about = {"format_version": str(FORMAT_VERSION), "frame_rate_hz": repr(float(frame_rate_hz))}
            self._writer.add_metadata(METADATA_NAME, about)
            self.attach(RIG_NAME, json_text(rig_to_json(rig)).encode())
            if preset is not None:
                self.attach(PRESET_NAME, preset_json(preset).encode())
        except OSError as error:
            self.discard()
            raise self.refusal(error) from error

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._writer.size

    def attach(self, name: str, data: bytes) -> None:
        """Write a small file into the file."""
        self._writer.attach(name, "application/json" if name.endswith(".json") else "application/octet-stream", data)

    def add_topic(self, topic: str, message_type: str, *, once: bool = False) -> None:
        """Declare a topic; one with a message for all listeners, ``once``, is kept for those who come later."""
        if message_type not in self._types:
            self._types[message_type] = self._writer.add_schema(message_type, definition(message_type))
        qos = STATIC_QOS if once else ""
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": type_hash(message_type)}
        self._channels[topic] = self._writer.add_channel(topic, self._types[message_type], metadata)

    def channel(self, topic: str) -> int:
        """Return the number of a topic."""
        return self._channels[topic]

    def write(self, messages: list[Message]) -> None:
        """Write messages as one chunk; the system has it when this returns."""
        self._writer.write_chunk(messages)

    def sync(self) -> None:
        """Have the disk hold what was written."""
        os.fsync(self._file.fileno())

    def finish(self) -> None:
        """Write what lets readers seek at once."""
        self._writer.finish()
        self.sync()

    def close(self) -> None:
        """Close the file; twice is harmless."""
        self._file.close()

    def discard(self) -> None:
        """Close and remove the file."""
        self.close()
        self.path.unlink(missing_ok=True)

    def refusal(self, error: OSError) -> ExportError:
        """Say that the operating system refuses to write."""
        return ExportError(f"cannot write {self.path}: {error.strerror or error}; choose another place")
