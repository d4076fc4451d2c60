"""Small rigs and frames with distinctive numbers, and a comparison of frames."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

import capture_sources
import folder_scenes
from tactune.core.model.frames import Rig, SensorFrame
from tactune.core.output import RecordingStatus, SessionWriter


@pytest.fixture(scope="session")
def make_rig() -> Callable[..., Rig]:
    return folder_scenes.make_rig


@pytest.fixture(scope="session")
def rig(make_rig: Callable[..., Rig]) -> Rig:
    return make_rig()


@pytest.fixture(scope="session")
def make_frame() -> Callable[..., SensorFrame]:
    """Make a frame of noise for a rig, different for each seed."""
    return lambda rig, seed=0, **changes: folder_scenes.make_frame(seed, rig, **changes)


@pytest.fixture
def make_frames(rig: Rig, make_frame: Callable[..., SensorFrame]) -> Callable[[int], list[SensorFrame]]:
    return lambda count: [make_frame(rig, seed) for seed in range(count)]


@pytest.fixture(scope="session")
def record() -> Callable[..., RecordingStatus]:
    """Write frames to a file, losing none."""

    def write(path: Path, rig: Rig, frames: list[SensorFrame], **options: object) -> RecordingStatus:
        with SessionWriter(path, rig, **options) as writer:  # type: ignore[arg-type]
            for frame in frames:
                assert writer.put(frame, wait=True)
        status = writer.close()
        assert status.error == ""
        return status

    return write


@pytest.fixture(scope="session")
def same_frame() -> Callable[[SensorFrame, SensorFrame], bool]:
    """Whether two frames have the same bits; a recording does not hold the object's true pose."""
    return partial(capture_sources.same_frame, pose=False)
