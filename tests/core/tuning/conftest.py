"""Recordings of small images, and searches on them."""

import cv2
import pytest

from long_search import LongSearch
from small_recordings import noisy_press, small_rig
from tactune.core.contact.kernels.threads import get_threads, set_threads
from tactune.core.preset.file import save_preset
from tactune.core.sources.folder import export_folder
from tactune.core.sources.presets import load_preset


@pytest.fixture(autouse=True)
def _threads():
    """Undo what a worker does to its thread and process, which are those of the tests here."""
    kernels, images = get_threads(), cv2.getNumThreads()
    yield
    set_threads(kernels)
    cv2.setNumThreads(images)


@pytest.fixture
def make_recording(tmp_path):
    def make(name="rec", *, seed=0, frames=3, width=64, with_truth=True):
        export_folder(noisy_press(seed, small_rig(width), frames, with_truth), tmp_path / name)
        return f"folder:{tmp_path / name}"

    return make


@pytest.fixture
def recording(make_recording):
    return make_recording()


@pytest.fixture
def tolerance_preset(tmp_path):
    path = tmp_path / "tolerance.json"
    save_preset(load_preset("default").with_value("contact_test", "tolerance"), path)
    return path


@pytest.fixture
def tune(tactune, monkeypatch, tmp_path, tolerance_preset):
    """Run ``tactune tune`` in this process from the tolerance preset, in the folder ``work``."""

    def run(*words):
        (tmp_path / "work").mkdir(exist_ok=True)
        monkeypatch.chdir(tmp_path / "work")
        preset = [] if "-p" in words else ["-p", tolerance_preset]
        jobs = [] if {"--jobs", "--scheduler"} & set(words) else ["--jobs", "1"]
        return tactune("tune", *words, *preset, *jobs)

    return run


@pytest.fixture
def long_search(make_recording, tmp_path, tolerance_preset):
    return LongSearch(make_recording(frames=12), tmp_path, tolerance_preset)
