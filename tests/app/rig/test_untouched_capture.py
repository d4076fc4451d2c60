"""Capturing the untouched frame in the window, by mouse and keys."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from threading import Event

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import FakeSource, at_rest, tiny_frame
from hands import type_into
from tactune.app.worker.threads import wait_for_abandoned
from tactune.app.worker.worker import SourceRequest
from tactune.core.calibration.snapshots import content_hash
from tactune.core.model.frames import SensorFrame
from tactune.core.rig.untouched import average_untouched, load_untouched

CONTROL = Qt.KeyboardModifier.ControlModifier
SHIFT = Qt.KeyboardModifier.ShiftModifier


class Endless(FakeSource):
    """A live source at 200 Hz."""

    def __init__(self) -> None:
        super().__init__(live=True)

    def next_frame(self) -> SensorFrame | None:
        time.sleep(0.005)
        return super().next_frame()


class Moving(FakeSource):
    """From its fifth frame on, number 504 of its cameras, the whole membrane is pushed in by 8 mm."""

    def read(self, index: int) -> SensorFrame:
        frame = tiny_frame(index, self.rig)
        pushed = (frame.tactile_depth - (80 if index >= 4 else 0)).astype(np.uint16)
        return replace(frame, sequence=500 + index, tactile_depth=pushed)


def open_capture(qtbot, window):
    QTest.keyClick(window, Qt.Key.Key_R, CONTROL | SHIFT)
    opened = window.untouched.window
    qtbot.waitUntil(opened.isActiveWindow)
    return opened


def capture(qtbot, window, frames=5):
    """Open the window, type a number of frames, click on Capture and wait."""
    opened = open_capture(qtbot, window)
    type_into(opened.frames, str(frames), Qt.Key.Key_Tab)
    QTest.mouseClick(opened.take, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: not opened.capture.busy)
    return opened


def open_source(qtbot, window, source):
    window.open_request(SourceRequest("other", lambda progress: source))
    qtbot.waitUntil(lambda: window.result is not None and window.result.source.name == source.name)


def test_the_next_frames_become_the_untouched_frame_as_one_step(qtbot, window):
    opened = capture(qtbot, window, 5)
    record = window.document.preset.untouched
    assert record.frames == 5
    assert "Captured 5 frames" in opened.sentence.text()
    assert "mm after" in opened.sentence.text()
    qtbot.waitUntil(lambda: at_rest(window, 3))  # where it stood before
    kept = load_untouched(record, window.document.untouched_home)
    assert np.array_equal(kept.tactile_depth, tiny_frame(3, window.result.source.rig).tactile_depth)
    assert kept.sequence == 3
    QTest.keyClick(opened, Qt.Key.Key_Z, CONTROL)
    qtbot.waitUntil(lambda: window.document.preset.untouched is None)
    assert window.document.undo_stack.redoText() == "Capture untouched frame"
    window.document.undo_stack.redo()
    assert window.document.preset.untouched == record


def test_the_untouched_frame_is_shown_beside_the_present_frame(qtbot, window):
    opened = open_capture(qtbot, window)
    assert not opened.save.isEnabled()
    capture(qtbot, window)
    keeper = window.untouched.keeper
    qtbot.waitUntil(lambda: keeper.frame is not None)
    assert content_hash(keeper.frame) == window.document.preset.untouched.sha256
    assert opened.save.isEnabled()


def test_a_touch_meanwhile_is_refused_in_words(qtbot, window):
    source = Moving()
    source.name = "moving"
    open_source(qtbot, window, source)
    window.worker.pause()
    window.worker.seek(2)
    qtbot.waitUntil(lambda: at_rest(window, 2))
    opened = capture(qtbot, window, 6)
    said = opened.sentence.text()
    assert re.match(
        r"The membrane moved while the untouched frame was captured: frame [5-8] differs from frame 3 ", said
    )
    assert window.document.preset.untouched is None
    qtbot.waitUntil(lambda: at_rest(window, 2))


def test_where_a_recording_ends_what_came_is_taken(qtbot, window):
    window.worker.set_loop(False)
    opened = capture(qtbot, window, 7)
    assert "because the source has no more" in opened.sentence.text()
    assert 1 <= window.document.preset.untouched.frames <= 5


@pytest.fixture
def gated(qtbot, window):
    """The window at rest on frame 4 of a source that the test can hold back."""
    source = FakeSource(name="gated")
    open_source(qtbot, window, source)
    window.worker.pause()
    window.worker.seek(3)
    qtbot.waitUntil(lambda: at_rest(window, 3))
    return source


def pause_capturing(qtbot, window, source, frames=6):
    """Begin to capture, and pause the main window once some frames, but not all, are taken."""
    opened = open_capture(qtbot, window)
    opened.frames.setValue(frames)
    source.hold(2)
    QTest.mouseClick(opened.take, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: opened.capture.taken >= 2)
    QTest.keyClick(window, Qt.Key.Key_Space)
    source.release()
    qtbot.waitUntil(lambda: "Paused after" in opened.sentence.text())
    assert opened.capture.busy and window.document.preset.untouched is None
    return opened


@pytest.mark.parametrize("by", ["button", "main window"])
def test_a_pause_of_the_main_window_makes_capturing_wait(qtbot, window, gated, by):
    opened = pause_capturing(qtbot, window, gated)
    gated.hold(1)
    if by == "button":
        QTest.mouseClick(opened.go_on, Qt.MouseButton.LeftButton)
    else:
        QTest.keyClick(window, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: not opened.go_on.isVisible())
    assert "do not touch the membrane" in opened.sentence.text()
    gated.release()
    qtbot.waitUntil(lambda: not opened.capture.busy)
    assert window.document.preset.untouched.frames == 6
    qtbot.waitUntil(lambda: at_rest(window, 3))


def test_what_came_before_a_pause_can_be_used(qtbot, window, gated):
    opened = pause_capturing(qtbot, window, gated)
    taken = opened.capture.taken
    assert taken < 6
    QTest.mouseClick(opened.use_taken, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: not opened.capture.busy)
    assert window.document.preset.untouched.frames == taken
    assert not opened.use_taken.isVisible()


def test_capturing_can_be_cancelled_in_a_pause(qtbot, window, gated):
    opened = pause_capturing(qtbot, window, gated)
    QTest.keyClick(opened, Qt.Key.Key_Escape)
    assert "do not touch the membrane" not in opened.sentence.text()
    qtbot.waitUntil(lambda: not opened.capture.busy)
    assert "cancelled" in opened.sentence.text() and not opened.go_on.isVisible()
    assert window.document.preset.untouched is None


def test_stepping_in_a_pause_takes_a_frame_and_says_so(qtbot, window, gated):
    opened = pause_capturing(qtbot, window, gated, 8)
    taken = opened.capture.taken
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_Period)
    qtbot.waitUntil(lambda: f"Paused after {taken + 1} frames" in opened.sentence.text())
    assert opened.go_on.isVisible()


def test_once_no_more_frames_are_taken_the_membrane_may_be_touched(qtbot, window, gated, monkeypatch):
    go_on = Event()

    def slow(frames):
        came = list(frames)
        go_on.wait(60)
        return average_untouched(came)

    monkeypatch.setattr("tactune.app.rig.untouched_capture.average_untouched", slow)
    opened = pause_capturing(qtbot, window, gated)
    QTest.mouseClick(opened.use_taken, Qt.MouseButton.LeftButton)
    assert "may be touched again" in opened.sentence.text() and not opened.use_taken.isVisible()
    qtbot.waitUntil(lambda: opened.progress.text() == "Averaging")
    go_on.set()
    qtbot.waitUntil(lambda: not opened.capture.busy)
    go_on.clear()
    opened.frames.setValue(2)
    QTest.mouseClick(opened.take, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: "may be touched again" in opened.sentence.text())  # enough came without a pause, too
    go_on.set()
    qtbot.waitUntil(lambda: not opened.capture.busy)


@pytest.mark.parametrize("start", [0, 4])
def test_a_recording_shorter_than_it_states_ends_where_no_frame_comes(qtbot, window, start):
    source = FakeSource(name="truncated", ends_at=5)
    open_source(qtbot, window, source)
    window.worker.pause()
    window.worker.seek(start)
    qtbot.waitUntil(lambda: at_rest(window, start))
    opened = open_capture(qtbot, window)
    opened.frames.setValue(7)
    QTest.mouseClick(opened.take, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: opened.go_on.isVisible() or not opened.capture.busy)
    if opened.capture.busy:
        assert "Paused after 5 frames" in opened.sentence.text()
        QTest.mouseClick(opened.go_on, Qt.MouseButton.LeftButton)
        qtbot.waitUntil(lambda: not opened.capture.busy)
    assert window.document.preset.untouched.frames == 5 - start
    assert "because the source has no more" in opened.sentence.text()


@pytest.mark.parametrize("length", [1, 3])
def test_a_short_recording_is_taken_once(qtbot, window, length):
    source = FakeSource(length)
    source.name = "short"
    open_source(qtbot, window, source)
    opened = capture(qtbot, window, 15)
    assert window.document.preset.untouched.frames == length
    assert f"Captured {length} frame" in opened.sentence.text()


def test_escape_stops_capturing_and_then_closes(qtbot, window):
    open_source(qtbot, window, Endless())
    opened = open_capture(qtbot, window)
    opened.frames.setValue(1000)
    QTest.keyClick(opened, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: opened.capture.busy)
    qtbot.waitUntil(lambda: "Frame 3" in opened.progress.text())
    QTest.keyClick(opened, Qt.Key.Key_Escape)
    qtbot.waitUntil(lambda: not opened.capture.busy)
    assert "cancelled" in opened.sentence.text()
    assert window.document.preset.untouched is None
    assert opened.take.isEnabled()
    QTest.keyClick(opened, Qt.Key.Key_Escape)
    assert window.untouched.window is None


def test_another_source_ends_capturing(qtbot, window):
    open_source(qtbot, window, Endless())
    opened = open_capture(qtbot, window)
    opened.frames.setValue(1000)
    QTest.mouseClick(opened.take, Qt.MouseButton.LeftButton)
    open_source(qtbot, window, FakeSource())
    qtbot.waitUntil(lambda: not opened.capture.busy)
    assert "another source was opened" in opened.sentence.text()


def test_without_a_source_the_window_says_so(qtbot, make_window):
    window = make_window()
    QTest.keyClick(window, Qt.Key.Key_R, CONTROL | SHIFT)
    assert any("open a source first" in sentence for sentence in window.messages.sentences())


def test_the_recheck_compares_the_membrane_with_the_untouched_frame(qtbot, window):
    capture(qtbot, window).close()
    qtbot.waitUntil(lambda: at_rest(window, 3))
    window.actions_.recheck.trigger()
    check = window.calibration.recheck
    qtbot.waitUntil(lambda: "as in the untouched frame" in check.membrane.text())
    assert check.membrane_drift.verdict == "fine"
    assert check.sentence.text().startswith("Frame 4 has no tactile colour image")
    window.document.undo_stack.undo()
    QTest.mouseClick(check.again, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: "has no untouched frame" in check.membrane.text())


def test_the_simulator_takes_its_object_away(qtbot, make_window):
    window = make_window()
    window.open_source("sim:cup?press=medium&sensor=datasheet")
    qtbot.waitUntil(lambda: window.result is not None, timeout=300_000)
    pressed = window.result.frame
    opened = open_capture(qtbot, window)
    assert "simulator removes its object" in opened.advice.text()
    QTest.mouseClick(opened.take, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: window.document.preset.untouched is not None, timeout=300_000)
    kept = load_untouched(window.document.preset.untouched, window.document.untouched_home)
    middle = (slice(200, 280), slice(280, 360))
    assert np.median(kept.tactile_depth[middle]) > np.median(pressed.tactile_depth[middle]) + 100


def test_closing_does_not_wait_for_what_is_still_being_computed(qtbot, window, monkeypatch):
    begun, go_on = Event(), Event()

    def stuck(frames):
        begun.set()
        go_on.wait(60)
        return average_untouched(frames)

    monkeypatch.setattr("tactune.app.rig.untouched_capture.average_untouched", stuck)
    opened = open_capture(qtbot, window)
    QTest.mouseClick(opened.take, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(begun.is_set)
    QTest.mouseClick(opened.leave, Qt.MouseButton.LeftButton)
    assert window.untouched.window is None
    assert not wait_for_abandoned(0.0)
    go_on.set()
    assert wait_for_abandoned(60.0)
    assert window.document.preset.untouched is None
