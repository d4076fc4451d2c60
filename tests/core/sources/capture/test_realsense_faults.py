"""Faults of cameras and of the capture process during a recording, through the class that opens the hardware."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyrealsense2", reason="the camera driver is not installed", exc_type=ImportError)

from software_cameras import FAULTS, Command, Fault, FolderCommands, open_software_cameras
from tactune.core.errors import SourceError
from tactune.core.model.frames import SensorFrame
from tactune.core.output.writer import SessionWriter
from tactune.core.sources.base import Health
from tactune.core.sources.capture import ProcessSource
from tactune.core.sources.registry import open_source

#: Faults of the ordinary run; the window meets those of the process there, the live source those of the cameras.
ORDINARY = ("stutters", "tactile removed", "killed")
#: When waiting gives up, in seconds.
ALLOWED_S = 60.0


class Session:
    """Two software cameras in a process of their own, recorded into a file."""

    def __init__(self, folder: Path, source: ProcessSource, writer: SessionWriter) -> None:
        self.source = source
        self.frames: list[SensorFrame] = []
        self._writer = writer
        self._commands = FolderCommands(folder)

    def do(self, what: Command | signal.Signals) -> None:
        """Command the cameras, or send the process a signal."""
        if isinstance(what, Command):
            self._commands.put(what)
        else:
            assert self.source.capture_pid is not None
            os.kill(self.source.capture_pid, what)

    def until(self, holds: Callable[[Health], bool]) -> None:
        """Record until the health is so."""
        deadline_s = time.monotonic() + ALLOWED_S
        while not holds(self.source.health()):
            assert time.monotonic() < deadline_s, f"still {self.source.health()}"
            self._record_one()

    def go_through(self, fault: Fault) -> None:
        """Harm, wait until it is told, mend and wait until all is well."""
        self.do(fault.harm)
        self.until(lambda health: fault.words in health.message)
        if fault.mend is not None:
            self.do(fault.mend)
        self.until(is_well)

    def record(self, count: int) -> None:
        """Record this number of further frames."""
        wanted = len(self.frames) + count
        deadline_s = time.monotonic() + ALLOWED_S
        while len(self.frames) < wanted:
            assert time.monotonic() < deadline_s, f"no frames: {self.source.health()}"
            self._record_one()

    def _record_one(self) -> None:
        if self.source.wait(0.02):
            frame = self.source.next_frame()
            assert frame is not None
            self._writer.put(frame, wait=True)
            self.frames.append(frame)


def is_well(health: Health) -> bool:
    return not health.stale and all(camera.state == "streaming" for camera in health.cameras)


@pytest.mark.parametrize(
    "fault", [name if name in ORDINARY else pytest.param(name, marks=pytest.mark.long) for name in FAULTS]
)
def test_a_fault_is_told_and_mended_and_the_recording_stays_whole(
    nothing_left: None, tmp_path: Path, fault: str
) -> None:
    path = tmp_path / "session.mcap"
    with (
        ProcessSource(partial(open_software_cameras, tmp_path)) as source,
        SessionWriter(path, source.rig) as writer,
    ):
        session = Session(tmp_path, source, writer)
        session.record(15)
        assert source.health().message == ""
        session.go_through(FAULTS[fault])
        session.record(15)
        status = writer.close()
    assert (status.error, status.dropped, status.frames) == ("", 0, len(session.frames))
    with open_source(str(path)) as recording:
        kept = list(recording)
    assert len(kept) == len(session.frames)
    assert np.all(np.diff([frame.sequence for frame in kept]) > 0)
    assert np.all(np.diff([frame.proximity_time_s for frame in kept]) > 0)
    assert all(abs(frame.skew_s) < 0.05 for frame in kept)
    for one, other in zip(kept, session.frames, strict=True):
        assert np.array_equal(one.proximity_depth, other.proximity_depth)
        assert np.array_equal(one.tactile_depth, other.tactile_depth)
        assert np.array_equal(one.proximity_color, other.proximity_color)


def test_no_camera_is_told(nothing_left: None) -> None:
    with pytest.raises(SourceError, match=r"^realsense:f0090001,130322270002: .*not connected|^realsense:.* connected"):
        open_source("realsense:f0090001,130322270002")
