"""A frame and a preset give the same bits in the window, in ``tactune run`` and in a Python script."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from PyQt6.QtWidgets import QApplication

from fakes import FakeSource, at_rest
from tactune.app.cli.main import main
from tactune.app.worker.worker import SourceRequest
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.sources.folder import export_folder
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source
from tactune.core.sources.simulator.simulator_source import SimulatorSource

REAL_PAIR_PRESET = Path(__file__).resolve().parents[1] / "data" / "real_pair.json"


@pytest.fixture(scope="module")
def pressed_cup(tmp_path_factory):
    """Frames without contact, with some, and with much, as a folder that every way can read."""
    folder = tmp_path_factory.mktemp("identical") / "cup"
    simulator = SimulatorSource("cup")
    export_folder(FakeSource(frames=[simulator.read(index) for index in (0, 30, 45)], rig=simulator.rig), folder)
    return folder


def patches_of_the_window(window, folder, qtbot):
    """Step through a recording as a person does and return each patch that the window shows."""
    name = f"folder:{folder}"
    window.open_request(SourceRequest(name, lambda progress: open_source(name, progress)))
    qtbot.waitUntil(lambda: window.result is not None and window.result.source.name == name, timeout=60_000)
    window.worker.pause()
    patches = []
    for index in range(window.result.source.length):
        window.worker.seek(index)
        qtbot.waitUntil(lambda index=index: at_rest(window, index), timeout=60_000)
        patches.append(window.result.patch)
    return patches


def check(window, folder, preset_name, tmp_path, qtbot, monkeypatch):
    seen = patches_of_the_window(window, folder, qtbot)
    monkeypatch.setattr(
        "sys.argv",
        ["tactune", "run", "--source", f"folder:{folder}", "--preset", str(preset_name), "--out", str(tmp_path)],
    )
    assert main() == 0
    with open_source(f"folder:{folder}") as source:
        pipeline = ContactPipeline(load_preset(preset_name), source.rig)
        for number, (frame, shown) in enumerate(zip(source, seen, strict=True)):
            patch = pipeline.process(frame)
            np.testing.assert_array_equal(shown.points, patch.points)
            np.testing.assert_array_equal(shown.provenance, patch.provenance)
            written = np.load(tmp_path / f"patch_{number:06d}.npz")["points"]
            np.testing.assert_array_equal(written, patch.points)
            assert written.dtype == patch.points.dtype
    return seen


def test_on_the_simulator(make_window, pressed_cup, tmp_path, qtbot, monkeypatch):
    window = make_window(load_preset("simulator"))
    seen = check(window, pressed_cup, "simulator", tmp_path / "out", qtbot, monkeypatch)
    assert len(seen[0].points) == 0
    assert len(seen[2].points) > len(seen[1].points) > 100


def test_on_a_real_scene(make_window, shared_data, tmp_path, qtbot, monkeypatch):
    window = make_window(load_preset(REAL_PAIR_PRESET))
    [patch] = check(window, shared_data / "real_pair", REAL_PAIR_PRESET, tmp_path / "out", qtbot, monkeypatch)
    assert len(patch.points) > 100_000


@pytest.mark.parametrize("saved", [False, True])
def test_what_is_copied_gives_the_patch_of_the_window(window, pressed_cup, tmp_path, qtbot, monkeypatch, capsys, saved):
    """Copy as command and as Python, with unsaved values too: a test, a list, and a section that was switched off."""
    if saved:
        window.document.save(tmp_path / "saved one.json")
    changes = {
        "contact_test": "membrane",
        "mask.hue": (10, 20),
        "mask.enabled": False,
        "region.rectangle": (0, 0, 400, 300),
    }
    assert window.document.edit_many(changes | {"region.enabled": True})
    seen = patches_of_the_window(window, pressed_cup, qtbot)
    assert any(len(patch.points) for patch in seen)
    actions, clipboard = window.actions_, QApplication.clipboard()

    actions.copy_command.trigger()
    words = shlex.split(clipboard.text())
    assert (str(tmp_path / "saved one.json") in words) == saved
    monkeypatch.setattr("sys.argv", [*words, "--json"])
    capsys.readouterr()
    assert main() == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    actions.copy_python.trigger()
    exec(clipboard.text(), {})
    printed = capsys.readouterr().out.splitlines()
    for patch, line, text in zip(seen, lines, printed, strict=True):
        assert (line["points"], line["area_mm2"]) == (len(patch.points), patch.area_mm2)
        assert text == f"{patch.sequence} {len(patch.points)} {patch.area_mm2} {patch.centroid_m}"
