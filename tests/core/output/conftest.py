"""Small rigs and frames with distinctive numbers, and a comparison of frames."""

from functools import partial

import pytest

import capture_sources
import folder_scenes
from tactune.core import ContactPipeline, load_preset, open_source
from tactune.core.output.writer import SessionWriter


@pytest.fixture(scope="session")
def make_rig():
    return folder_scenes.make_rig


@pytest.fixture(scope="session")
def rig(make_rig):
    return make_rig()


@pytest.fixture(scope="session")
def make_frame():
    """Make a frame of noise for a rig, different for each seed."""
    return lambda rig, seed=0, **changes: folder_scenes.make_frame(seed, rig, **changes)


@pytest.fixture
def make_frames(rig, make_frame):
    return lambda count: [make_frame(rig, seed) for seed in range(count)]


@pytest.fixture(scope="session")
def record():
    """Write frames to a file, losing none."""

    def write(path, rig, frames, **options):
        with SessionWriter(path, rig, **options) as writer:
            for frame in frames:
                assert writer.put(frame, wait=True)
        status = writer.close()
        assert status.error == ""
        return status

    return write


@pytest.fixture(scope="session")
def same_frame():
    """Whether two frames have the same bits; a recording does not hold the object's true pose."""
    return partial(capture_sources.same_frame, pose=False)


@pytest.fixture(scope="session")
def processed():
    """A frame, its patch and the preset."""
    preset = load_preset("simulator")
    with open_source("sim:cup") as source:
        source.seek(40)
        frame = source.next_frame()
        assert frame is not None
        return frame, ContactPipeline(preset, source.rig).process(frame), preset
