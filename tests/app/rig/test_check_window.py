"""The window that checks the cameras, opened from the main window, on sources with known errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from PyQt6.QtCore import QEvent
from PyQt6.QtGui import QGuiApplication
from PyQt6.QtWidgets import QApplication

from hands import show_source
from side_by_side import HEIGHT, WIDTH, Wall, WallCameras, counts
from tactune.app.rig import gathering, skew_tab
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.core.errors import FrameError
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset
from tactune.core.sources.base import FrameSource, SeekableSource

DELAY_S = 0.120


class Stairs(Wall):
    """Steps that the tactile camera does not see: both cameras have no surface in common."""

    def read(self, index):
        steps = 0.300 + 0.04 * (np.arange(WIDTH) // 16 % 2) + np.zeros((HEIGHT, 1))
        return frame(index, self.rig, steps, np.full((HEIGHT, WIDTH), 0.3), index / 30, index / 30)


class Press(SeekableSource):
    """A board that presses irregularly; the tactile camera's stamps are late."""

    def __init__(self, rig):
        super().__init__("press", rig, 150)

    def read(self, index):
        def board(t):
            return 0.30 - 0.02 * (np.sin(2.4 * t) + 0.55 * np.sin(5.3 * t + 1.0) + 0.3 * np.sin(9.1 * t))

        near_s = index / 30
        shape = (HEIGHT, WIDTH)
        membrane = min(0.30, board(near_s - DELAY_S))
        noise = np.random.default_rng(index).normal(0, 0.0003, (2, *shape))
        return frame(index, self.rig, board(near_s) + noise[0], membrane + noise[1], near_s, near_s)


def frame(index, rig, proximity_m, tactile_m, proximity_s, tactile_s):
    return SensorFrame(
        sequence=index,
        proximity_depth=counts(proximity_m, rig.proximity),
        tactile_depth=counts(tactile_m, rig.tactile),
        proximity_color=np.zeros((HEIGHT, WIDTH, 3), np.uint8),
        proximity_time_s=proximity_s,
        tactile_time_s=tactile_s,
    )


Open = Callable[[FrameSource], MainWindow]


@pytest.fixture
def open_checks(qtbot, tmp_path) -> Iterator[Open]:
    """A main window on a source, with the check window open."""
    windows = []

    def make(source: FrameSource) -> MainWindow:
        preset = Preset(name="tiny", contact_test="tolerance").with_value("outliers.enabled", False)
        main = MainWindow(preset, Settings(tmp_path / "window.json"), tmp_path, native_dialogs=False)
        windows.append(main)
        main.show()
        show_source(qtbot, main, source)
        main.actions_.check_cameras.trigger()
        qtbot.waitUntil(main.checks.window.isVisible)
        return main

    yield make
    for main in windows:
        main.close_without_asking()
        main.deleteLater()
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    QApplication.processEvents()


def wait(qtbot, condition):
    qtbot.waitUntil(condition, timeout=30000)


def test_the_quality_of_a_wall_is_what_was_put_in(open_checks, rig, qtbot):
    main = open_checks(Wall(rig, 60))
    tab = main.checks.window.quality
    wait(qtbot, lambda: tab.quality is not None and tab.quality.proximity.frames == 40)
    quality = tab.quality
    assert quality.proximity.fill_rate == 1.0
    assert quality.proximity.temporal_noise_m == pytest.approx(0.0006, rel=0.05)
    assert quality.tactile.distance_m == pytest.approx(0.300, abs=1e-4)
    assert quality.bias.bias_m == pytest.approx(0.004, abs=1e-4)
    assert "<b>100.0 %</b>" in tab.lines["proximity"].text()
    assert "add +4.0 mm" in tab.lines["bias"].text()
    assert tab.region == (48, 36, 64, 48)

    tab.copy.click()
    noise_mm = 1e3 * quality.proximity.temporal_noise_m  # not every frame is measured where the machine is busy
    assert f"Temporal noise: {noise_mm:.2f} mm" in QGuiApplication.clipboard().text()


def test_another_source_replaces_the_numbers_and_a_single_frame_is_enough(open_checks, rig, qtbot):
    main = open_checks(Wall(rig, 60))
    tab = main.checks.window.quality
    wait(qtbot, lambda: tab.quality is not None and tab.quality.proximity.frames > 1)
    assert "add +4.0 mm" in tab.lines["bias"].text()
    show_source(qtbot, main, Stairs(rig, length=1))
    wait(qtbot, lambda: tab.quality is not None and tab.quality.proximity.frames == 1)
    assert "add +4.0 mm" not in tab.lines["bias"].text()


def test_a_bias_that_says_nothing_is_not_printed_bold(open_checks, rig, qtbot):
    tab = open_checks(Stairs(rig)).checks.window.quality
    wait(qtbot, lambda: tab.quality is not None)
    text = tab.lines["bias"].text()
    assert "mm" in text and "not known" in text
    assert "<b>" not in text
    assert "<b>" in tab.lines["proximity"].text()


def test_the_region_follows_entries_and_the_true_distance_gives_the_accuracy(open_checks, rig, qtbot):
    main = open_checks(Wall(rig, 60))
    tab = main.checks.window.quality
    wait(qtbot, lambda: tab.quality is not None)
    tab.entries["Left"].setValue(60)
    tab.entries["Width"].setValue(500)
    assert tab.region == (60, 36, WIDTH - 60, 48)
    tab.true_distance.setValue(297.0)
    wait(qtbot, lambda: tab.quality.proximity.region == tab.region and tab.quality.tactile.z_accuracy > 0)
    assert tab.quality.tactile.z_accuracy == pytest.approx(0.003 / 0.297, rel=0.1)
    tab.centre.click()
    assert tab.region == (48, 36, 64, 48)


def test_a_closed_window_takes_no_frames(open_checks, rig, qtbot):
    main = open_checks(Wall(rig, 60))
    checks = main.checks.window
    wait(qtbot, lambda: checks.quality.quality is not None and checks.quality.quality.proximity.frames == 40)
    checks.close()
    before, shown = checks.quality.quality, []
    main.context.frameShown.connect(lambda: shown.append(1))
    wait(qtbot, lambda: len(shown) >= 30)
    assert checks.quality.quality is before
    main.actions_.check_cameras.trigger()
    wait(qtbot, lambda: checks.quality.quality not in (before, None))
    assert checks.quality.quality.proximity.frames < 30


def test_the_delay_is_measured_shown_and_compensated_with_undo(open_checks, rig, qtbot):
    main = open_checks(Press(rig))
    tab = main.checks.window.skew
    tab.seconds.setValue(5)
    tab.start.click()
    assert not tab.start.isEnabled()
    wait(qtbot, lambda: not tab.busy)
    assert tab.skew is not None, tab.sentence.text()
    assert tab.skew.delay_s == pytest.approx(DELAY_S, abs=0.005)
    assert "later" in tab.sentence.text()
    assert tab.compensate.isVisibleTo(tab)
    tab.compensate.click()
    assert main.document.preset.cameras.tactile_delay_s == pytest.approx(DELAY_S, abs=0.005)
    main.document.undo_stack.undo()
    assert main.document.preset.cameras.tactile_delay_s == 0.0


def test_a_still_scene_and_a_cancelled_measurement_leave_everything(open_checks, rig, qtbot):
    main = open_checks(Wall(rig, 60))
    tab = main.checks.window.skew
    tab.start.click()
    tab.cancel.click()
    assert tab.start.isEnabled()
    assert not tab.busy
    tab.seconds.setValue(2)
    tab.start.click()
    wait(qtbot, lambda: not tab.busy)
    assert tab.skew is None
    assert "too little motion" in tab.sentence.text()
    assert not tab.compensate.isVisibleTo(tab)


def test_a_source_that_stops_ends_the_measurement(open_checks, rig, qtbot, monkeypatch):
    monkeypatch.setattr(gathering, "PATIENCE_S", 0.5)
    cameras = WallCameras(rig)
    tab = open_checks(cameras).checks.window.skew
    tab.start.click()
    cameras.silent.set()
    wait(qtbot, lambda: not tab.busy)
    assert "No more frames arrive" in tab.sentence.text()


def test_a_frame_that_cannot_be_used_ends_the_measurement_and_the_cameras_go_on(open_checks, rig, qtbot, monkeypatch):
    main = open_checks(WallCameras(rig))
    tab = main.checks.window.skew

    def refuse(_):
        raise FrameError("this frame has no depth")

    monkeypatch.setattr(skew_tab.Sample, "of", refuse)
    tab.start.click()
    wait(qtbot, lambda: not tab.busy)
    assert tab.sentence.text() == "This frame has no depth."
    shown = main.result.frame.sequence
    wait(qtbot, lambda: main.result.frame.sequence > shown + 3)
