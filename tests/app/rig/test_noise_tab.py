"""The tab "Noise and bias" of the camera checks, used with mouse and keys on sources with known noise."""

from __future__ import annotations

import time
from threading import Event

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from hands import CONTROL, LEFT
from side_by_side import HEIGHT, WIDTH, counts
from tactune.app.rig import noise_tab
from tactune.app.worker.worker import SourceRequest
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset
from tactune.core.sources.base import FrameSource, Health, SeekableSource
from tactune.core.sources.presets import load_preset

BIAS_M = 0.004
PRINT = (214, 40, 160)
MASK = {"mask.enabled": True, "mask.hue": (145, 175), "mask.saturation": (110, 255), "mask.value": (60, 255)}


def wall(rig, index, step_m=0.0):
    """A wall with prints 300 mm away and known noise; the proximity camera reads 4 mm too far."""
    near, far = np.random.default_rng(index).normal(0, (0.0006, 0.0003), (HEIGHT, WIDTH, 2)).transpose(2, 0, 1)
    color = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
    color[30:50, 50:70] = color[70:90, 80:100] = color[60:80, 40:60] = PRINT
    depth_m = 0.300 + step_m * index
    return SensorFrame(index, counts(depth_m + BIAS_M + near, rig.proximity), counts(depth_m + far, rig.tactile), color)


class Wall(SeekableSource):
    """A recording of the wall."""

    def __init__(self, rig, length=30, step_m=0.0):
        super().__init__("wall", rig, length)
        self._step_m = step_m

    def read(self, index):
        return wall(self.rig, index, self._step_m)


class Cameras(FrameSource):
    """Live cameras in front of the wall; silent ones give no more frames."""

    name = "cameras"

    def __init__(self, rig):
        self._rig, self._count = rig, 0
        self.silent = Event()

    @property
    def rig(self):
        return self._rig

    def wait(self, timeout_s):
        time.sleep(0.015)
        return not self.silent.is_set()

    def next_frame(self):
        self._count += 1
        return wall(self._rig, self._count)

    def health(self):
        return Health()

    def close(self):
        pass


@pytest.fixture
def open_tab(qtbot, make_window):
    """The tab of a window on a source, brought to the front by its key."""

    def make(source):
        main = make_window(Preset.model_validate({"outliers": {"enabled": False}}).with_values(MASK))
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
    assert bias.startswith("The proximity camera reads 4.0 +- 0.2 mm farther")
    assert main.document.preset.noise is None

    QTest.keyClick(tab.use, Qt.Key.Key_U, CONTROL)
    qtbot.waitUntil(lambda: main.document.preset.noise is not None)
    noise = main.document.preset.noise
    assert noise.frames == 20
    assert noise.bias_m == pytest.approx(BIAS_M, abs=3e-4)
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
    monkeypatch.setattr(noise_tab, "PATIENCE_S", 0.5)
    cameras = Cameras(rig)
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
    main, tab = open_tab(Cameras(rig))
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
