"""The calibration wizard and the check for drift, opened from the main window."""

from dataclasses import replace

import pytest
from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from fakes import FakeSource
from hands import show_source, type_path
from pairs import with_pairs
from tactune.app.calibration import snapshots
from tactune.core.contact.alignment import tactile_pose
from tactune.core.sources.presets import load_preset

CONTROL = Qt.KeyboardModifier.ControlModifier


@pytest.fixture
def window(qtbot, make_window, scene, frames):
    """A window that plays two inflation levels by turns."""
    made = make_window()
    levels = list(frames.values())
    source = FakeSource(6, scene.rig, make=lambda index, _: replace(levels[index % 2], sequence=index))
    show_source(qtbot, made, source)
    return made


def test_snapshots_come_from_the_present_source(window, qtbot):
    window.worker.pause()
    window.worker.seek(2)
    qtbot.waitUntil(lambda: not window.transport.state.playing)
    qtbot.waitUntil(lambda: window.result.frame.sequence == 2)
    QTest.keyClick(window, Qt.Key.Key_K, CONTROL)
    wizard = window.calibration.wizard
    assert wizard is not None and wizard.isVisible()

    wizard.frames.take.click()
    qtbot.waitUntil(lambda: bool(wizard.session.state.snapshots))
    assert wizard.session.state.snapshots[0].averaged == 1, "the next frame is of another press"
    qtbot.waitUntil(lambda: window.result.frame.sequence == 2)
    qtbot.waitUntil(lambda: not window.transport.state.playing)

    window.actions_.calibrate.trigger()
    assert window.calibration.wizard is wizard
    wizard.close()
    assert window.calibration.wizard is None
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    assert not window.document.edit("tolerance.t", -5.0)
    window.document.edit("tolerance.t", 0.02)
    window.actions_.calibrate.trigger()
    assert len(window.calibration.wizard.session.state.snapshots) == 1


def test_a_snapshot_of_a_playing_recording_has_all_its_frames(window, qtbot, monkeypatch):
    monkeypatch.setattr(snapshots, "MOVED_LIMIT_M", 1.0)
    window.worker.pause()
    window.worker.seek(0)
    qtbot.waitUntil(lambda: window.result.frame.sequence == 0 and not window.transport.state.playing)
    window.actions_.calibrate.trigger()
    wizard = window.calibration.wizard
    wizard.frames.take.click()
    qtbot.waitUntil(lambda: bool(wizard.session.state.snapshots))
    assert wizard.session.state.snapshots[0].name == "Frames 1 to 6"
    assert wizard.session.state.snapshots[0].averaged == 6
    window.worker.play()
    qtbot.waitUntil(lambda: window.transport.state.playing)
    with qtbot.waitSignal(wizard.frames.step.ended):
        wizard.frames.take.click()
    qtbot.waitUntil(lambda: window.transport.state.playing)


def test_six_actions_lead_from_the_window_to_a_good_preset(window, scene, qtbot, tmp_path):
    window.document.save(tmp_path / "tiny.json")
    QTest.keyClick(window, Qt.Key.Key_K, CONTROL)
    wizard = window.calibration.wizard
    press = lambda button: QTest.mouseClick(button, Qt.MouseButton.LeftButton)
    press(wizard.frames.take)
    qtbot.waitUntil(lambda: bool(wizard.session.state.snapshots))
    press(wizard.next)
    press(wizard.points.finder.search)
    qtbot.waitUntil(lambda: wizard.outcome.report is not None and not wizard.fitter.job.busy)
    press(wizard.steps.button(3))
    press(wizard.save)
    qtbot.waitUntil(lambda: not window.document.dirty)
    saved = load_preset(tmp_path / "tiny.json")
    assert saved.alignment.calibration.verdict.startswith("Good")
    assert scene.alignment_error_px(tactile_pose(saved.alignment, scene.rig)) < 0.5
    window.actions_.check_drift.trigger()
    check = window.watch.window
    qtbot.waitUntil(lambda: check.found is not None)
    assert check.found.state == "good"


def test_the_wizard_saves_the_preset_through_the_window(window, scene, frames, feed, qtbot, tmp_path):
    window.actions_.calibrate.trigger()
    wizard = window.calibration.wizard
    wizard.session.edit("all", with_pairs(scene, frames, feed))
    qtbot.waitUntil(lambda: wizard.outcome.report is not None and not wizard.fitter.job.busy)
    QTest.keyClick(wizard, Qt.Key.Key_4, CONTROL)
    QTest.mouseClick(wizard.save, Qt.MouseButton.LeftButton)
    type_path(qtbot, tmp_path / "new.json")
    qtbot.waitUntil(lambda: not window.document.dirty)
    assert load_preset(tmp_path / "new.json").alignment.calibration is not None
