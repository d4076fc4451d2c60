"""The step that measures noise and bias, on sources with known errors."""

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import FakeSource
from hands import CONTROL, LEFT, show_source
from side_by_side import HEIGHT, PRINT_MASK, WIDTH, WallCameras, counts, wall_source
from tactune.app.calibration import gather
from tactune.app.rig.set_up_steps import NoiseStep
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset


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


@pytest.fixture
def open_checks(qtbot, make_window):
    """A main window on a source, with that step chosen by its key."""

    def make(source):
        values = {"contact_test": "tolerance", "outliers.enabled": False, **PRINT_MASK}
        main = make_window(Preset().with_values(values))
        show_source(qtbot, main, source)
        QTest.keyClick(main, Qt.Key.Key_F6)
        qtbot.waitUntil(main.set_up.noise.work.start.hasFocus)
        return main

    return make


def wait(qtbot, condition):
    qtbot.waitUntil(condition, timeout=60_000)


def test_noise_and_bias_are_measured_used_and_undone(open_checks, rig, qtbot):
    main = open_checks(wall_source(rig))
    tab = main.set_up.noise.work
    tab.wanted = 20
    QTest.mouseClick(tab.start, LEFT)
    assert tab.busy and not tab.start.isEnabled()
    wait(qtbot, lambda: tab.found is not None)
    noise = main.document.preset.noise
    assert noise.frames == 20
    assert noise.bias_m == pytest.approx(0.004, abs=3e-4)
    assert main.set_up.noise.state.text() == "Noise 0.3 mm tactile, 0.6 mm proximity."
    QTest.keyClick(main, Qt.Key.Key_Z, CONTROL)
    assert main.document.preset.noise is None


def test_what_cannot_be_measured_is_said(open_checks, rig, qtbot):
    main = open_checks(wall_source(rig, length=2000, step_m=0.001))  # it does not come back to its first place
    tab = main.set_up.noise.work
    tab.wanted = 20
    QTest.mouseClick(tab.start, LEFT)
    wait(qtbot, lambda: not tab.busy)
    assert "scene moves" in tab.sentence.text()
    show_source(qtbot, main, FakeSource(2, rig, make=stairs, name="short"))
    QTest.mouseClick(tab.start, LEFT)
    assert not tab.busy and "2 frames" in tab.sentence.text()


def test_one_measurement_at_a_time_and_none_of_another_source(open_checks, rig, qtbot):
    main = open_checks(WallCameras(rig))
    noise, other = main.set_up.noise.work, NoiseStep(main.context)
    qtbot.addWidget(other)
    noise.wanted = 200
    noise.start.click()
    other.start.click()
    assert noise.busy and not other.busy
    assert other.sentence.text() == gather.OTHER_TASK
    show_source(qtbot, main, FakeSource(60, rig, make=stairs, name="other"))
    wait(qtbot, lambda: not noise.busy)
    assert noise.sentence.text() == gather.OTHER_SOURCE
