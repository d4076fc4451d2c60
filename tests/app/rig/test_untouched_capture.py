"""Capturing the untouched frame in the window, by mouse and keys."""

from dataclasses import replace
from threading import Event

import numpy as np
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import FakeCameras, FakeSource, at_rest, tiny_frame
from hands import CONTROL, CONTROL_SHIFT, LEFT, show_source
from tactune.app.calibration import gather
from tactune.app.rig import untouched
from tactune.app.worker.threads import wait_for_abandoned
from tactune.core.calibration.snapshots import content_hash
from tactune.core.rig.untouched import average_untouched, load_untouched


def open_capture(qtbot, window):
    """Choose the step by its key and return its work; its button has the focus."""
    QTest.keyClick(window, Qt.Key.Key_R, CONTROL_SHIFT)
    opened = window.set_up.untouched.work
    qtbot.waitUntil(opened.start.hasFocus)
    return opened


def capture(qtbot, window, frames=5):
    """Click on Capture and wait."""
    opened = open_capture(qtbot, window)
    opened.wanted = frames
    QTest.mouseClick(opened.start, LEFT)
    qtbot.waitUntil(lambda: not opened.busy, timeout=60_000)
    return opened


def test_the_next_frames_become_the_untouched_frame_as_one_step(qtbot, window):
    capture(qtbot, window, 5)
    record = window.document.preset.untouched
    assert record.frames == 5
    assert window.set_up.untouched.state.text() == "Captured, mean of 5 frames."
    qtbot.waitUntil(lambda: at_rest(window, 3))  # where it stood before
    kept = load_untouched(record, window.document.untouched_home)
    assert np.array_equal(kept.tactile_depth, tiny_frame(3, window.result.source.rig).tactile_depth)
    keeper = window.untouched
    qtbot.waitUntil(lambda: keeper.frame is not None)
    assert content_hash(keeper.frame) == record.sha256
    QTest.keyClick(window, Qt.Key.Key_Z, CONTROL)
    qtbot.waitUntil(lambda: window.document.preset.untouched is None)
    window.document.undo_stack.redo()
    assert window.document.preset.untouched == record


def test_a_touch_meanwhile_is_refused_in_words(qtbot, window):
    def moving(index, rig):
        """From its fifth frame on, the whole membrane is pushed in by 8 mm."""
        frame = tiny_frame(index, rig)
        pushed = (frame.tactile_depth - (80 if index >= 4 else 0)).astype(np.uint16)
        return replace(frame, sequence=500 + index, tactile_depth=pushed)

    show_source(qtbot, window, FakeSource(make=moving, name="moving"), 2)
    opened = capture(qtbot, window, 6)
    assert "moved while" in opened.sentence.text()
    assert window.document.preset.untouched is None
    qtbot.waitUntil(lambda: at_rest(window, 2))


def test_where_a_recording_has_no_more_frames_what_came_is_taken(qtbot, window, monkeypatch):
    monkeypatch.setattr(gather, "PATIENCE_S", 600.0)
    show_source(qtbot, window, FakeSource(8, name="short", ends_at=5), 0)
    opened = open_capture(qtbot, window)
    opened.wanted = 15
    QTest.mouseClick(opened.start, LEFT)
    qtbot.waitUntil(lambda: "5 frames" in opened.progress.text())
    monkeypatch.setattr(gather, "PATIENCE_S", 0.0)
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
    qtbot.waitUntil(lambda: not opened.busy)
    assert opened.sentence.text() == gather.OTHER_SOURCE


def test_the_check_for_drift_compares_the_membrane_with_the_untouched_frame(qtbot, window):
    capture(qtbot, window)
    qtbot.waitUntil(lambda: at_rest(window, 3))
    window.actions_.check_drift.trigger()
    check = window.watch.window
    qtbot.waitUntil(lambda: check.found is not None and check.found.state == "good")
    window.document.undo_stack.undo()
    QTest.mouseClick(check.again, LEFT)
    qtbot.waitUntil(lambda: "has no untouched frame" in check.sentence.text())


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
