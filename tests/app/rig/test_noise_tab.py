"""The tab "Noise and bias" of the camera checks, used with mouse and keys on sources with known noise."""

from __future__ import annotations

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from hands import CONTROL, LEFT
from side_by_side import PRINT_MASK, Wall, WallCameras
from tactune.app.rig import gathering
from tactune.app.worker.worker import SourceRequest
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset


@pytest.fixture
def open_tab(qtbot, make_window):
    """The tab of a window on a source, brought to the front by its key."""

    def make(source):
        main = make_window(Preset.model_validate({"outliers": {"enabled": False}}).with_values(PRINT_MASK))
        main.open_request(SourceRequest(source.name, lambda _: source))
        qtbot.waitUntil(lambda: main.result is not None)
        QTest.keyClick(main, Qt.Key.Key_F6)
        qtbot.waitUntil(lambda: main.checks.window is not None and main.checks.window.isActiveWindow())
        checks = main.checks.window
        QTest.keyClick(checks, Qt.Key.Key_N, Qt.KeyboardModifier.AltModifier)
        qtbot.waitUntil(checks.noise.isVisible)
        return main, checks.noise

    return make


def test_noise_and_bias_are_measured_used_undone_and_saved(open_tab, rig, qtbot, tmp_path):
    main, tab = open_tab(Wall(rig))
    assert tab.stored.text() == "The rig was not measured: the preset holds no noise and no bias."
    assert not tab.use.isEnabled()
    tab.frames.setValue(20)
    QTest.mouseClick(tab.start, LEFT)
    assert not tab.start.isEnabled()
    qtbot.waitUntil(lambda: not tab.busy and tab.measured is not None)
    tactile, proximity, bias = tab.sentence.text().splitlines()
    assert tactile.startswith("Tactile noise 0.3")
    assert proximity.startswith("Proximity noise 0.6")
    assert bias.startswith("The proximity camera reads 4.0 ± 0.2 mm farther")
    assert main.document.preset.noise is None

    QTest.keyClick(tab.use, Qt.Key.Key_U, CONTROL)
    qtbot.waitUntil(lambda: main.document.preset.noise is not None)
    noise = main.document.preset.noise
    assert noise.frames == 20
    assert noise.bias_m == pytest.approx(0.004, abs=3e-4)
    assert tab.stored.text().splitlines()[:3] == [tactile, proximity, bias]
    assert tab.stored.text().endswith("on 20 frames.")
    assert main.document.undo_stack.undoText() == "Measure noise and bias"
    main.document.save(tmp_path / "mine.json")
    assert load_preset(tmp_path / "mine.json").noise == noise
    main.document.undo_stack.undo()
    assert main.document.preset.noise is None
    assert "not measured" in tab.stored.text()
    main.document.undo_stack.redo()
    assert main.document.preset.noise == noise


def test_keys_measure_and_cancel_and_a_paused_recording_stays_paused(open_tab, rig, qtbot):
    main, tab = open_tab(Wall(rig, length=200))
    main.worker.pause()
    qtbot.waitUntil(lambda: not main.result.playback.running)
    QTest.keyClick(tab, Qt.Key.Key_M, CONTROL)
    qtbot.waitUntil(tab.cancel.isEnabled)
    tab.cancel.setFocus()
    QTest.keyClick(tab.cancel, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: not tab.busy)
    assert tab.start.isEnabled()
    assert tab.measured is None
    qtbot.waitUntil(lambda: not main.context.playback.running)


def test_a_moving_scene_is_refused_with_a_sentence(open_tab, rig, qtbot):
    _, tab = open_tab(Wall(rig, length=2000, step_m=0.001))  # it does not come back to its first place
    QTest.mouseClick(tab.start, LEFT)
    qtbot.waitUntil(lambda: not tab.busy)
    assert tab.sentence.text().startswith("The scene moves: the tactile depth changes in 100 % of the image")
    assert not tab.use.isEnabled()


def test_cameras_that_stop_end_the_measurement(open_tab, rig, qtbot, monkeypatch):
    monkeypatch.setattr(gathering, "PATIENCE_S", 0.5)
    cameras = WallCameras(rig)
    _, tab = open_tab(cameras)
    tab.frames.setValue(200)
    cameras.silent.set()
    QTest.mouseClick(tab.start, LEFT)
    qtbot.waitUntil(lambda: not tab.busy)
    assert "No more frames arrive" in tab.sentence.text()


def test_another_source_makes_the_measurement_void(open_tab, rig, qtbot):
    main, tab = open_tab(Wall(rig))
    tab.frames.setValue(12)
    QTest.mouseClick(tab.start, LEFT)
    qtbot.waitUntil(lambda: tab.measured is not None)
    main.open_request(SourceRequest("other", lambda _: Wall(rig)))
    qtbot.waitUntil(lambda: tab.measured is None)
    assert tab.sentence.text() == "Another source was opened meanwhile: measure again."
    assert not tab.use.isEnabled()


def test_skew_and_noise_are_not_measured_at_once(open_tab, rig, qtbot):
    main, tab = open_tab(WallCameras(rig))
    skew = main.checks.window.skew
    tab.frames.setValue(200)
    QTest.mouseClick(tab.start, LEFT)
    assert tab.busy
    QTest.keyClick(main.checks.window, Qt.Key.Key_S, Qt.KeyboardModifier.AltModifier)
    qtbot.waitUntil(skew.isVisible)
    QTest.mouseClick(skew.start, LEFT)
    assert skew.busy
    assert not tab.busy
    QTest.mouseClick(skew.cancel, LEFT)
