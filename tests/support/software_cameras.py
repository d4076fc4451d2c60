"""The software cameras of the RealSense tests in a capture process, controlled through a folder."""

from __future__ import annotations

import json
import queue
import signal
from dataclasses import asdict, dataclass
from pathlib import Path

from software_rig import Command, open_software_rig
from tactune.core.preset import CamerasSection
from tactune.core.sources.base import FrameSource, Progress


class FolderCommands:
    """A queue of commands that also a process finds which was started later; picklable."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._count = 0

    def put(self, command: Command) -> None:
        self._count += 1
        draft = self._folder / "draft"
        draft.write_text(json.dumps(asdict(command)))
        draft.rename(self._folder / f"{self._count:03d}.command")

    def get_nowait(self) -> Command:
        waiting = sorted(self._folder.glob("*.command"))
        if not waiting:
            raise queue.Empty
        command = Command(**json.loads(waiting[0].read_text()))
        waiting[0].unlink()
        return command


def open_software_cameras(folder: Path, progress: Progress) -> FrameSource:
    return open_software_rig(FolderCommands(folder), CamerasSection())


@dataclass(frozen=True)
class Fault:
    """What goes wrong, by what words a person learns of it, and what mends it, where it does not mend itself."""

    harm: Command | signal.Signals
    words: str
    mend: Command | None = None


FAULTS = {
    "tactile stops": Fault(Command("stop", "tactile"), "sends no images", Command("go", "tactile")),
    "proximity stops": Fault(Command("stop", "proximity"), "sends no images", Command("go", "proximity")),
    "stutters": Fault(Command("stutter", "tactile", 1.5), "sends no images"),
    "depth only": Fault(
        Command("streams", "proximity", text="depth"),
        "sends no images with colour",
        Command("streams", "proximity", text="depth color"),
    ),
    "tactile removed": Fault(Command("remove", "tactile"), "is not connected", Command("add", "tactile")),
    "proximity removed": Fault(Command("remove", "proximity"), "is not connected", Command("add", "proximity")),
    "killed": Fault(signal.SIGKILL, "ended with status -9"),
    "stopped": Fault(signal.SIGSTOP, "has given no sign of life"),
    "driver hangs": Fault(Command("hang", "tactile", 30.0), "has given no sign of life"),
}
