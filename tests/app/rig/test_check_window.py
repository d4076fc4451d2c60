"""The window that checks the cameras, opened from the main window, on sources with known errors."""

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import FakeSource
from hands import LEFT, show_source
from side_by_side import HEIGHT, PRINT_MASK, WIDTH, WallCameras, counts, wall_source
from tactune.app.rig import gather
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset

DELAY_S = 0.120


def frame(index, rig, proximity_m, tactile_m):
    return SensorFrame(
        sequence=index,
        proximity_depth=counts(proximity_m, rig.proximity),
        tactile_depth=counts(tactile_m, rig.tactile),
        proximity_color=np.zeros((HEIGHT, WIDTH, 3), np.uint8),
        proximity_time_s=index / 30,
        tactile_time_s=index / 30,
    )


def stairs(index, rig):
    """Steps that the tactile camera does not see: both cameras have no surface in common."""
    steps = 0.300 + 0.04 * (np.arange(WIDTH) // 16 % 2) + np.zeros((HEIGHT, 1))
    return frame(index, rig, steps, np.full((HEIGHT, WIDTH), 0.3))


def press(index, rig):
    """A board that presses irregularly; the tactile camera's stamps are late."""

    def board(t):
        return 0.30 - 0.02 * (np.sin(2.4 * t) + 0.55 * np.sin(5.3 * t + 1.0) + 0.3 * np.sin(9.1 * t))

    membrane = min(0.30, board(index / 30 - DELAY_S))
    noise = np.random.default_rng(index).normal(0, 0.0003, (2, HEIGHT, WIDTH))
    return frame(index, rig, board(index / 30) + noise[0], membrane + noise[1])


@pytest.fixture
def open_checks(qtbot, make_window):
    """A main window on a source, with the check window open."""

    def make(source):
        values = {"contact_test": "tolerance", "outliers.enabled": False, **PRINT_MASK}
        main = make_window(Preset().with_values(values))
        show_source(qtbot, main, source)
        QTest.keyClick(main, Qt.Key.Key_F6)
        qtbot.waitUntil(lambda: main.checks.window is not None and main.checks.window.isActiveWindow())
        return main

    return make


def bring(qtbot, main, name):
    tab = getattr(main.checks.window, name)
    main.checks.window.tabs.setCurrentWidget(tab)
    qtbot.waitUntil(tab.isVisible)
    return tab


def wait(qtbot, condition):
    qtbot.waitUntil(condition, timeout=60_000)


# Quality


def test_the_quality_of_a_wall_is_what_was_put_in(open_checks, rig, qtbot):
    main = open_checks(wall_source(rig, 60))
    tab = main.checks.window.quality
    wait(qtbot, lambda: tab.quality is not None)
    near, _ = tab.quality
    assert near.fill_rate == 1.0
    assert near.plane_rms_m == pytest.approx(0.0006, rel=0.1)
    assert "<b>100.0 %</b>" in tab.lines["proximity"].text()
    assert tab.region == (48, 36, 64, 48)

    tab.region_item.edited.emit((60, 36, WIDTH - 60, 48), 1)
    wait(qtbot, lambda: tab.quality[0].region == (60, 36, WIDTH - 60, 48))

    show_source(qtbot, main, FakeSource(1, rig, make=stairs, name="stairs"))  # a single frame is enough
    wait(qtbot, lambda: tab.quality is not None and tab.quality[0].plane_rms_m > 0.01)
    assert "No flat surface" in tab.lines["proximity"].text()


# Noise and bias


def test_noise_and_bias_are_measured_used_and_undone(open_checks, rig, qtbot):
    main = open_checks(wall_source(rig))
    tab = bring(qtbot, main, "noise")
    assert "not measured" in tab.stored.text()
    tab.wanted = 20
    QTest.mouseClick(tab.start, LEFT)
    assert tab.busy and not tab.start.isEnabled()
    wait(qtbot, lambda: tab.found is not None)
    noise = main.document.preset.noise
    assert noise.frames == 20
    assert noise.bias_m == pytest.approx(0.004, abs=3e-4)
    shown = tab.stored.text().splitlines()
    assert shown[0].startswith("Tactile noise 0.3") and shown[1].startswith("Proximity noise 0.6")
    QTest.mouseClick(tab.undo, LEFT)
    assert main.document.preset.noise is None
    assert "not measured" in tab.stored.text()


def test_what_cannot_be_measured_is_said(open_checks, rig, qtbot):
    main = open_checks(wall_source(rig, length=2000, step_m=0.001))  # it does not come back to its first place
    tab = bring(qtbot, main, "noise")
    tab.wanted = 20
    QTest.mouseClick(tab.start, LEFT)
    wait(qtbot, lambda: not tab.busy)
    assert "scene moves" in tab.sentence.text()
    show_source(qtbot, main, FakeSource(2, rig, make=stairs, name="short"))
    QTest.mouseClick(tab.start, LEFT)
    assert not tab.busy and "2 frames" in tab.sentence.text()


def test_one_measurement_at_a_time_and_none_of_another_source(open_checks, rig, qtbot):
    main = open_checks(WallCameras(rig))
    noise, skew = (bring(qtbot, main, name) for name in ("noise", "skew"))
    noise.wanted = 200
    noise.start.click()
    skew.start.click()
    assert noise.busy and not skew.busy
    assert skew.sentence.text() == gather.OTHER_TASK
    show_source(qtbot, main, FakeSource(60, rig, make=stairs, name="other"))
    wait(qtbot, lambda: not noise.busy)
    assert noise.sentence.text() == gather.OTHER_SOURCE
    main.checks.window.close()


# Skew


def test_the_delay_is_measured_shown_and_compensated(open_checks, rig, qtbot):
    main = open_checks(FakeSource(150, rig, make=press, name="press"))
    tab = bring(qtbot, main, "skew")
    QTest.mouseClick(tab.start, LEFT)
    wait(qtbot, lambda: not tab.busy)
    assert tab.found is not None, tab.sentence.text()
    assert main.document.preset.cameras.tactile_delay_s == pytest.approx(DELAY_S, abs=0.006)
    QTest.mouseClick(tab.undo, LEFT)
    assert main.document.preset.cameras.tactile_delay_s == 0.0
