"""The software cameras of the RealSense tests in a capture process, commanded through a folder."""

from __future__ import annotations

import json
import queue
import sys
from dataclasses import asdict
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "realsense"))

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
