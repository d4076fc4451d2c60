"""The steps that capture the untouched frame and measure noise and bias, by mouse and keys."""

from dataclasses import replace
from threading import Event

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import FakeCameras, FakeSource, at_rest, tiny_frame
from hands import CONTROL, CONTROL_SHIFT, LEFT, show_source
from side_by_side import HEIGHT, PRINT_MASK, WIDTH, counts, rig, wall_source
from tactune.app.calibration import measuring_step
from tactune.app.rig import untouched
from tactune.app.rig.set_up_steps import NoiseStep
from tactune.app.worker.threads import wait_for_abandoned
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset
from tactune.core.rig.untouched import average_untouched

__all__ = ["rig"]


def open_capture(qtbot, window):
    """Choose the step by its key and return its work; its button has the focus."""
    QTest.keyClick(window, Qt.Key.Key_R, CONTROL_SHIFT)
    opened = window.set_up.untouched.work
    qtbot.waitUntil(opened.start.hasFocus)
    return opened


def capture(qtbot, window, frames=5):
    opened = open_capture(qtbot, window)
    opened.wanted = frames
    QTest.mouseClick(opened.start, LEFT)
    qtbot.waitUntil(lambda: not opened.busy, timeout=60_000)
    return opened


def test_the_next_frames_become_the_untouched_frame_as_one_step(qtbot, window):
    window.worker.playbackChanged.emit(replace(window.result.playback, index=2))  # results overtake such a change
    capture(qtbot, window, 5)
    record = window.document.preset.untouched
    assert record.frames == 5
    assert window.set_up.untouched.state.text() == "Captured, mean of 5 frames."
    qtbot.waitUntil(lambda: at_rest(window, 3))  # where it stood before
    qtbot.waitUntil(lambda: window.result.untouched is not None)
    kept = window.result.untouched.tactile_depth
    assert np.array_equal(kept, tiny_frame(3, window.result.source.rig).tactile_depth)
    QTest.keyClick(window, Qt.Key.Key_Z, CONTROL)
    qtbot.waitUntil(lambda: window.document.preset.untouched is None)
    window.document.undo_stack.redo()
    assert window.document.preset.untouched == record


def test_where_a_recording_has_no_more_frames_what_came_is_taken(qtbot, window, monkeypatch):
    monkeypatch.setattr(measuring_step, "PATIENCE_S", 600.0)
    show_source(qtbot, window, FakeSource(8, name="short", ends_at=5), 0)
    opened = open_capture(qtbot, window)
    opened.wanted = 15
    QTest.mouseClick(opened.start, LEFT)
    qtbot.waitUntil(lambda: "5 frames" in opened.progress.text())
    monkeypatch.setattr(measuring_step, "PATIENCE_S", 0.0)
    qtbot.waitUntil(lambda: not opened.busy)
    assert window.document.preset.untouched.frames == 5
    assert "no more" in opened.sentence.text()


def test_capturing_is_cancelled_and_ends_with_its_source(qtbot, window):
    cameras = FakeCameras()
    cameras.release()
    show_source(qtbot, window, cameras)
    cameras.run()
    opened = open_capture(qtbot, window)
    opened.wanted = 1000
    QTest.keyClick(opened.start, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: opened.busy)
    QTest.mouseClick(opened.cancel, LEFT)
    assert not opened.busy and opened.start.isEnabled()
    assert window.document.preset.untouched is None
    opened.start.click()
    show_source(qtbot, window, FakeSource(name="other"))  # ends capturing, too
    qtbot.waitUntil(lambda: not opened.busy and cameras.closed)
    assert opened.sentence.text() == measuring_step.OTHER_SOURCE


def test_closing_does_not_wait_for_what_is_still_being_computed(qtbot, window, monkeypatch):
    begun, go_on = Event(), Event()

    def stuck(frames):
        begun.set()
        go_on.wait(60)
        return average_untouched(frames)

    monkeypatch.setattr(untouched, "average_untouched", stuck)
    opened = open_capture(qtbot, window)
    opened.wanted = 2
    QTest.mouseClick(opened.start, LEFT)
    qtbot.waitUntil(begun.is_set)
    window.set_up.close()
    assert not wait_for_abandoned(0.0)
    go_on.set()
    assert wait_for_abandoned(60.0)
    assert window.document.preset.untouched is None


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
    main = open_checks(wall_source(rig, live=True))
    noise, other = main.set_up.noise.work, NoiseStep(main.context)
    qtbot.addWidget(other)
    noise.wanted = 200
    noise.start.click()
    other.start.click()
    assert noise.busy and not other.busy
    assert other.sentence.text() == measuring_step.OTHER_TASK
    show_source(qtbot, main, FakeSource(60, rig, make=stairs, name="other"))
    wait(qtbot, lambda: not noise.busy)
    assert noise.sentence.text() == measuring_step.OTHER_SOURCE
