"""Recording in the window by its key: the file's contents and the messages."""

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import FakeSource
from hands import answer_question, press, show_source
from tactune.app.window import recording
from tactune.app.worker.worker import NOT_LIVE
from tactune.core.sources.registry import open_source


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "recordings"


@pytest.fixture
def window(window, folder):
    window.settings.set("folder/recordings", str(folder))
    return window


def press_record(window):
    QTest.keyClick(window, Qt.Key.Key_F9)


def begin(window, qtbot):
    press_record(window)
    qtbot.waitUntil(lambda: window.recording.running)


def end(window, qtbot):
    press_record(window)
    qtbot.waitUntil(lambda: not window.recording.running)


def told(window):
    message = window.messages.by_key.get("recording")
    return "" if message is None else message.sentence


def frames_of(path):
    with open_source(f"mcap:{path}") as source:
        return list(source)


def recorded(folder):
    """The frames of the only recording in a folder."""
    (path,) = folder.iterdir()
    return frames_of(path)


def assert_same(read, given):
    assert [frame.sequence for frame in read] == [frame.sequence for frame in given] != []
    for one, other in zip(read, given, strict=True):
        for name in ("proximity_depth", "tactile_depth", "proximity_color"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert one.proximity_time_s == pytest.approx(other.proximity_time_s, abs=1e-9)


def test_the_key_records_every_frame_and_the_file_plays_them(window, cameras, qtbot, folder):
    window.actions_.run.trigger()
    begin(window, qtbot)
    assert window.actions_.record.isChecked()
    assert window.recording.isVisible()
    cameras.give(qtbot, 40)
    end(window, qtbot)
    assert not window.recording.isVisible()
    assert not window.actions_.record.isChecked()
    [path] = folder.iterdir()
    assert_same(frames_of(path), cameras.given[1:])
    assert told(window).startswith(f"Recorded {path.name}: ")
    assert "40 frames" in told(window)
    assert window.settings.recent("sources")[0] == f"mcap:{path}"
    press(window.messages.by_key.get("recording"), "Open recording")
    qtbot.waitUntil(lambda: window.result is not None and window.result.source.length == 40)


def test_closing_the_window_finishes_the_file(window, cameras, qtbot, folder):
    begin(window, qtbot)
    cameras.give(qtbot, 30)
    qtbot.waitUntil(lambda: window.worker.recorder.status().frames == 30)
    window.close()
    qtbot.waitUntil(lambda: not window.isVisible())
    assert window.worker.isFinished()
    assert_same(recorded(folder), cameras.given[1:])


def test_a_disk_that_fills_up_ends_the_recording_in_time(window, cameras, qtbot, monkeypatch, folder):
    begin(window, qtbot)
    cameras.give(qtbot, 4)
    monkeypatch.setattr(recording, "free_bytes", lambda folder: 1_000_000)
    qtbot.waitUntil(lambda: not window.recording.running)
    assert "It ended because only 1.0 MB are free" in told(window)
    assert len(recorded(folder)) == 4


def test_a_recording_is_not_recorded_and_the_tip_says_why(window, cameras, qtbot, folder):
    record = window.actions_.record
    assert record.isEnabled()
    show_source(qtbot, window, FakeSource(length=8), 3)
    assert not record.isEnabled() and record.toolTip() == NOT_LIVE
    press_record(window)
    assert not record.isChecked() and not folder.exists()


def test_what_is_edited_while_a_recording_is_finished_is_asked_about(window, cameras, qtbot):
    begin(window, qtbot)
    window.document.edit("tolerance.t", 0.011)
    window.close()
    answer_question(qtbot, "discard")
    window.document.edit("tolerance.t", 0.012)
    cameras.give(qtbot, 1)
    answer_question(qtbot, "cancel")
    assert window.isVisible() and not window.recording.running
