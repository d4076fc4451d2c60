"""The calibration wizard opened from the main window, and what happens to preset and file when it is saved."""

from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from fakes import FakeSource
from hands import CONTROL, LEFT, answer_question, press, show_source
from pairs import moved, with_pairs
from tactune.app.calibration import snapshots
from tactune.core.contact.alignment import tactile_pose
from tactune.core.sources.presets import load_preset


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
    assert wizard.session.state.snapshots[0].name == "Frames 0 to 5"
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


SAVE = 3


def fitted(qtbot, wizard, state):
    wizard.session.edit("all", state)
    qtbot.waitUntil(lambda: wizard.outcome.report is not None and wizard.outcome.pairs == state.complete_pairs)


def careless(state, sigma_px=2.5):
    """The same pairs, clicked carelessly."""
    rng = np.random.default_rng(5)
    for pair in state.pairs:
        state = state.with_pair(moved(pair, *rng.normal(0, sigma_px, 2).tolist()))
    return state


def test_a_worse_calibration_asks_before_it_replaces_a_better_one(open_wizard, scene, frames, feed, document, qtbot):
    wizard = open_wizard()
    fitted(qtbot, wizard, careless(with_pairs(scene, frames, feed), sigma_px=0.3))
    wizard.go_to(SAVE)
    with qtbot.waitSignal(feed.context.saveRequested):
        QTest.mouseClick(wizard.save, LEFT)
    before = document.preset.alignment
    fitted(qtbot, wizard, careless(with_pairs(scene, frames, feed, dots=range(0, 63, 16))))
    assert wizard.steps.button(SAVE).text().endswith("!")
    assert wizard.steps.button(SAVE).toolTip().startswith("! The present alignment is expected to be better")
    QTest.mouseClick(wizard.save, LEFT)
    words = answer_question(qtbot, "Cancel")
    assert "px new" in words and "px present" in words
    assert document.preset.alignment == before
    QTest.keyClick(wizard, Qt.Key.Key_S, CONTROL)
    answer_question(qtbot, "Replace anyway")
    qtbot.waitUntil(lambda: document.preset.alignment != before)


def test_next_and_save_wait_for_what_the_footer_says(open_wizard, scene, frames, feed, document, qtbot):
    wizard = open_wizard()
    QTest.keyClick(wizard, Qt.Key.Key_PageDown, CONTROL)
    assert "No snapshot yet" in wizard.verdict.text() and wizard.stack.currentIndex() == 0
    assert not wizard.next.isEnabled()
    wizard.session.click("proximity", 100.0, 100.0)
    wizard.session.click("tactile", 80.0, 100.0)
    QTest.keyClick(wizard, Qt.Key.Key_4, CONTROL)
    QTest.keyClick(wizard, Qt.Key.Key_S, CONTROL)
    assert "1 pair; 3 pairs more" in wizard.verdict.text() and "Find points" in wizard.verdict.text()
    assert not wizard.save.isEnabled() and document.undo_stack.count() == 0
    fitted(qtbot, wizard, with_pairs(scene, frames, feed))
    qtbot.waitUntil(wizard.save.isEnabled)
    step = wizard.quality.step.text().removeprefix("Next: ")
    assert step and step not in wizard.verdict.text(), "the next step is said once, on the page Quality"


def test_a_file_that_was_not_saved_is_said_and_saved_later(open_wizard, scene, frames, feed, document, qtbot, tmp_path):
    wizard = open_wizard()
    fitted(qtbot, wizard, with_pairs(scene, frames, feed))
    QTest.keyClick(wizard, Qt.Key.Key_S, CONTROL)  # nobody answers the request, as if the dialog were cancelled
    assert "file is not saved yet" in wizard.messages.by_key["saved"].sentence
    feed.context.saveRequested.connect(lambda: document.save(tmp_path / "tiny.json"))
    press(wizard.messages.by_key.get("saved"), "Save preset")
    assert not document.dirty
    assert "tiny.json" in wizard.messages.by_key["saved"].sentence
    assert load_preset(tmp_path / "tiny.json").alignment.calibration is not None
    assert wizard.steps.button(SAVE).text().endswith("✓")
