"""Recordings with a known contact, written as folders that every command can read."""

import pytest

from small_recordings import growing_press, small_rig
from tactune.core.sources.folder import export_folder


@pytest.fixture
def make_recording(tmp_path):
    """Write a recording of four frames; the first has no contact, the last 24 x 24 pixels of it."""

    def make(name="recording", *, serial="1", width=64, with_truth=True):
        export_folder(growing_press(small_rig(width, serial), 4, with_truth), tmp_path / name)
        return tmp_path / name

    return make


@pytest.fixture
def recording(make_recording):
    return make_recording()
