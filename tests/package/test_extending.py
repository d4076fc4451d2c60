"""The examples of docs/guide/extending.md, installed as a package and run."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fakes import FakeSource
from rigs import save_rig
from tactune.app.analysis.tab import TABS, TabKind
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.reading import SourceRequest
from tactune.core.errors import SourceError
from tactune.core.lab.methods import make_method, method_names
from tactune.core.model.plugins import added_by_others
from tactune.core.preset import Preset
from tactune.core.sources.cameras.drivers import camera_drivers
from tactune.core.sources.registry import open_source, source_kinds
from tactune.core.sources.simulator.scene import simulator_rig

EXAMPLES = Path(__file__).parents[2] / "docs" / "guide" / "extending.md"
BROKEN = {
    "gone": ("tactune.sources", "no_such_module:KIND", "ModuleNotFoundError: No module named 'no_such_module'"),
    "odd": ("tactune.sources", "tactune.core.errors:SourceError", "is no SourceKind"),
    "lost": ("tactune.cameras", "no_such_module:Driver", "ModuleNotFoundError"),
    "strange": ("tactune.cameras", "tactune.core.errors:SourceError", "is no CameraDriver"),
    "worn": ("tactune.tabs", "no_such_module:TAB", "ModuleNotFoundError"),
}


def install(source, target):
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(target), str(source)], check=True, capture_output=True)
    return target


@pytest.fixture(scope="module")
def acme(tmp_path_factory):
    """Install what the page says, and return the folder that it went to."""
    source = tmp_path_factory.mktemp("acme")
    files = re.findall(r"`([\w./]+)`:\n\n```\w+\n(.*?)```", EXAMPLES.read_text(), re.DOTALL)
    assert files[0][0] == "pyproject.toml"
    for name, text in files:
        assert sum(bool(line.strip()) for line in text.splitlines()) <= 30, f"{name} is no short example"
        path = source / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return install(source, tmp_path_factory.mktemp("site"))


@pytest.fixture
def found(acme, monkeypatch):
    """Let this process, and those that it starts, find the package."""
    monkeypatch.syspath_prepend(str(acme))
    monkeypatch.setenv("PYTHONPATH", str(acme))
    added_by_others.cache_clear()
    yield
    monkeypatch.undo()
    added_by_others.cache_clear()


@pytest.fixture
def broken(tmp_path, monkeypatch):
    """Let this process find a package whose entry points cannot be loaded; yields its folder."""
    metadata = tmp_path / "rotten-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: rotten\nVersion: 1.0\n")
    groups = {group for group, _, _ in BROKEN.values()}
    text = "".join(
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, (of, value, _) in BROKEN.items() if of == group)
        for group in groups
    )
    (metadata / "entry_points.txt").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    added_by_others.cache_clear()
    yield tmp_path
    monkeypatch.undo()
    added_by_others.cache_clear()


def test_the_source_is_run_by_scheme_and_by_path(found, tactune, tmp_path):
    rig = simulator_rig()
    save_rig(rig, tmp_path / "rig.json")
    depth = np.full((2, *rig.proximity.intrinsics.shape), 1200, np.uint16)
    color = np.zeros((2, *rig.proximity_color_shape, 3), np.uint8)
    np.savez(tmp_path / "two.npz", proximity_depth=depth, tactile_depth=depth, proximity_color=color)
    for name in (f"npz:{tmp_path / 'two.npz'}", str(tmp_path / "two.npz")):
        done = tactune("run", "--source", name, "--preset", "simulator", "--json")
        assert [json.loads(line)["sequence"] for line in done.out.splitlines()] == [0, 1], done.err
    (tmp_path / "two.npz").write_bytes(b"nothing")
    assert "cannot be read" in tactune("run", "-s", tmp_path / "two.npz", "--json").sentence


def test_the_cameras_are_listed_and_recorded(found, tactune, tmp_path):
    listed = tactune("devices")
    assert "serial acme1" in listed.out and "serial acme2" in listed.out, listed.err
    assert tactune("convert", "cameras:", tmp_path / "three", "--frames", 3).status == 0
    with open_source(str(tmp_path / "three")) as recording:
        assert (recording.length, recording.rig.proximity.model, recording.rig.tactile.model) == (3, "A2", "A1")


def test_the_method_stands_beside_our_own(found):
    source = FakeSource(length=1)
    frame = source.next_frame()
    assert frame is not None
    assert {"nearest", "mechanics"} <= set(method_names())
    patch = make_method("nearest", Preset(), source.rig, frame)(frame)
    assert len(patch.points) == np.count_nonzero(patch.mask) > 0


def test_the_tab_stands_in_the_analysis_menu(found, qtbot, tmp_path):
    preset = Preset.model_validate({"outliers": {"enabled": False}})
    window = MainWindow(preset, Settings(tmp_path / "window.json"), tmp_path, False)
    qtbot.addWidget(window)
    window.show()
    window.open_request(SourceRequest("tiny", lambda progress: FakeSource()))
    action = window.analysis.actions["area"]
    assert (action.text(), action.shortcut().toString()) == ("Patch &area…", "F11")
    action.trigger()
    tab = window.analysis.window.made["area"]
    qtbot.waitUntil(lambda: tab.largest_mm2 > 0 and tab.label.text().startswith("Frame "))
    window.close_without_asking()


def test_a_broken_entry_point_is_one_sentence_and_breaks_nothing_else(broken):
    assert [kind.scheme for kind in source_kinds()][:2] == ["sim", "folder"]
    for name in ("gone", "odd"):
        with pytest.raises(
            SourceError, match=rf"entry point '{name}' \(tactune.sources\) of the package rotten"
        ) as told:
            open_source(f"{name}:x")
        assert BROKEN[name][2] in str(told.value)
        assert "\n" not in str(told.value)
    with pytest.raises(SourceError, match=r"'avi:x' is no source.* sim:.*package rotten"):
        open_source("avi:x")
    drivers, problems = camera_drivers()
    assert [driver.title for driver in drivers] == ["Orbbec", "RealSense"]
    assert sorted(name for name in BROKEN for problem in problems if f"'{name}'" in problem) == ["lost", "strange"]
    assert list(added_by_others(TABS, TabKind)[1]) == ["worn"]
    with pytest.raises(SourceError, match=r"finds no camera.*package rotten"):
        open_source("cameras:1,2").close()
