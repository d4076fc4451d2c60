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

from patience import load_factor
from software_cameras import FAULTS, Command, Fault, FolderCommands, open_software_cameras
from tactune.core.errors import SourceError
from tactune.core.model.frames import SensorFrame
from tactune.core.recording.writer import SessionWriter
from tactune.core.sources.base import Health
from tactune.core.sources.capture import ProcessSource
from tactune.core.sources.registry import open_source

#: Longest recovery on an idle machine, tries of it, and when waiting gives up, in seconds.
PROMISED_S, ATTEMPTS, ALLOWED_S = 3.0, 3, 60.0


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

    def until(self, holds: Callable[[Health], bool]) -> float:
        """Record until the health is so; return how long it took."""
        began_s = time.monotonic()
        while not holds(self.source.health()):
            assert time.monotonic() - began_s < ALLOWED_S, f"still {self.source.health()}"
            self._record_one()
        return time.monotonic() - began_s

    def go_through(self, fault: Fault) -> tuple[float, float]:
        """Harm, mend and go on; return after how long it was told, and then mended."""
        self.do(fault.harm)
        told_s = self.until(lambda health: fault.words in health.message)
        if fault.mend is not None:
            self.do(fault.mend)
        return told_s, self.until(is_well)

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


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_told_and_mended_and_the_recording_stays_whole(
    nothing_left: None, tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str
) -> None:
    told_of = FAULTS[fault]
    path = tmp_path / "session.mcap"
    with (
        ProcessSource(partial(open_software_cameras, tmp_path)) as source,
        SessionWriter(path, source.rig) as writer,
    ):
        session = Session(tmp_path, source, writer)
        session.record(15)
        assert source.health().message == ""
        for _ in range(ATTEMPTS):
            session.until(lambda health: health.message == "")
            told_s, mended_s = session.go_through(told_of)
            recovered_s = mended_s if told_of.mend is not None else told_s + mended_s
            if recovered_s < PROMISED_S * load_factor():
                break
        session.record(15)
        status = writer.close()
    with capsys.disabled():
        print(f"\n{fault}: told after {told_s:.1f} s, mended after {mended_s:.1f} s", end=" ")  # noqa: T201
    assert recovered_s < PROMISED_S * load_factor()
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


def test_no_camera_is_told_at_once(nothing_left: None, tmp_path: Path) -> None:
    began_s = time.monotonic()
    with pytest.raises(SourceError, match=r"^realsense:f0090001,130322270002: .*not connected|^realsense:.* connected"):
        open_source("realsense:f0090001,130322270002")
    assert (
        time.monotonic() - began_s < 12.0 * load_factor()
    )  # the driver itself would search for 15 s; on a quiet machine it takes 1 s
