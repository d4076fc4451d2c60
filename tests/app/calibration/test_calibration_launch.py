"""The calibration wizard and the re-check, opened from the main window."""

from dataclasses import replace

import pytest
from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from hands import type_path
from pairs import with_pairs
from tactune.app.calibration import snapshots
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.worker import SourceRequest
from tactune.core.contact.alignment import tactile_pose
from tactune.core.preset import Preset
from tactune.core.sources.base import SeekableSource
from tactune.core.sources.presets import load_preset

CONTROL = Qt.KeyboardModifier.ControlModifier


class TinySource(SeekableSource):
    """Two inflation levels by turns."""

    def __init__(self, scene, frames):
        super().__init__("tiny", scene.rig, 6)
        self._scene, self._frames = scene, list(frames.values())

    def read(self, index):
        return replace(self._frames[index % 2], sequence=index)


@pytest.fixture
def window(qtbot, tmp_path, scene, frames):
    made = MainWindow(Preset(name="tiny"), Settings(tmp_path / "w.json"), tmp_path / "data", native_dialogs=False)
    made.resize(1100, 700)
    made.show()
    made.activateWindow()
    qtbot.waitUntil(made.isActiveWindow, timeout=15000)
    yield made
    made.close_without_asking()
    made.deleteLater()
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)


def test_snapshots_come_from_the_present_source(window, scene, frames, qtbot):
    window.open_request(SourceRequest("tiny", lambda progress: TinySource(scene, frames)))
    qtbot.waitUntil(lambda: window.result is not None, timeout=15000)
    window.worker.pause()
    window.worker.seek(2)
    qtbot.waitUntil(lambda: not window.transport.state.playing, timeout=15000)
    qtbot.waitUntil(lambda: window.result.frame.sequence == 2, timeout=15000)
    QTest.keyClick(window, Qt.Key.Key_K, CONTROL)
    wizard = window.calibration.wizard
    assert wizard is not None and wizard.isVisible()

    wizard.frames.take.click()
    qtbot.waitUntil(lambda: bool(wizard.session.state.snapshots), timeout=15000)
    assert wizard.session.state.snapshots[0].averaged == 1, "the next frame is of another press"
    qtbot.waitUntil(lambda: window.result.frame.sequence == 2, timeout=15000)
    qtbot.waitUntil(lambda: not window.transport.state.playing, timeout=15000)

    window.actions_.calibrate.trigger()
    assert window.calibration.wizard is wizard
    wizard.close()
    assert window.calibration.wizard is None
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    assert not window.document.edit("tolerance.t", -5.0)
    window.document.edit("tolerance.t", 0.02)
    window.actions_.calibrate.trigger()
    assert len(window.calibration.wizard.session.state.snapshots) == 1


def test_a_snapshot_of_a_playing_recording_has_all_its_frames(window, scene, frames, qtbot, monkeypatch):
    monkeypatch.setattr(snapshots, "MOVED_LIMIT_M", 1.0)
    window.open_request(SourceRequest("tiny", lambda progress: TinySource(scene, frames)))
    qtbot.waitUntil(lambda: window.result is not None, timeout=15000)
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
    with qtbot.waitSignal(wizard.collector.taken, timeout=15000):
        wizard.frames.take.click()
    qtbot.waitUntil(lambda: window.transport.state.playing)


def test_six_actions_lead_from_the_window_to_a_good_preset(window, scene, frames, qtbot, tmp_path):
    window.open_request(SourceRequest("tiny", lambda progress: TinySource(scene, frames)))
    qtbot.waitUntil(lambda: window.result is not None, timeout=15000)
    window.document.save(tmp_path / "tiny.json")
    QTest.keyClick(window, Qt.Key.Key_K, CONTROL)
    wizard = window.calibration.wizard
    press = lambda button: QTest.mouseClick(button, Qt.MouseButton.LeftButton)
    press(wizard.frames.take)
    qtbot.waitUntil(lambda: bool(wizard.session.state.snapshots), timeout=15000)
    press(wizard.next)
    press(wizard.points.finder.search)
    qtbot.waitUntil(lambda: wizard.outcome.report is not None and not wizard.fitter.busy, timeout=30000)
    press(wizard.steps.button(3))
    press(wizard.save)
    qtbot.waitUntil(lambda: not window.document.dirty)
    saved = load_preset(tmp_path / "tiny.json")
    assert saved.alignment.calibration.verdict.startswith("Good")
    assert scene.alignment_error_px(tactile_pose(saved.alignment, scene.rig)) < 0.5
    window.actions_.recheck.trigger()
    check = window.calibration.recheck
    qtbot.waitUntil(lambda: check.drift is not None, timeout=15000)
    assert "no need to calibrate again" in check.sentence.text()


def test_the_wizard_saves_the_preset_through_the_window(window, scene, frames, feed, qtbot, tmp_path):
    window.open_request(SourceRequest("tiny", lambda progress: TinySource(scene, frames)))
    qtbot.waitUntil(lambda: window.result is not None, timeout=15000)
    window.actions_.calibrate.trigger()
    wizard = window.calibration.wizard
    wizard.session.edit("all", with_pairs(scene, frames, feed))
    qtbot.waitUntil(lambda: wizard.outcome.report is not None and not wizard.fitter.busy)
    QTest.keyClick(wizard, Qt.Key.Key_4, CONTROL)
    QTest.mouseClick(wizard.save, Qt.MouseButton.LeftButton)
    type_path(qtbot, tmp_path / "new.json")
    qtbot.waitUntil(lambda: not window.document.dirty)
    assert load_preset(tmp_path / "new.json").alignment.calibration is not None
