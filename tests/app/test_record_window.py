"""Recording in the window by its key, and the recorder between the reading thread and the file."""

from threading import Event

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import FakeSource, tiny_frame, tiny_rig
from hands import answer_question, press, show_source
from tactune.app.window import recording
from tactune.app.worker.recorder import Recorder
from tactune.app.worker.worker import NOT_LIVE
from tactune.core.output.writer import SessionWriter
from tactune.core.preset import Preset
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


def told(window):
    message = window.messages.by_key.get("recording")
    return "" if message is None else message.sentence


def frames_of(path):
    with open_source(f"mcap:{path}") as source:
        return list(source)


def recorded(folder):
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
    qtbot.waitUntil(lambda: window.worker.recorder.status().frames == 40)
    press_record(window)
    qtbot.waitUntil(lambda: not window.recording.running)
    assert not window.recording.isVisible()
    assert not window.actions_.record.isChecked()
    [path] = folder.iterdir()
    assert_same(frames_of(path), cameras.given[1:])
    assert told(window).startswith(f"Recorded {path.name}: ")
    assert "40 frames" in told(window)
    assert window.settings.recent("sources")[0] == f"mcap:{path}"
    press(window.messages.by_key.get("recording"), "Open recording")
    qtbot.waitUntil(lambda: window.result is not None and window.result.source.length == 40)


def test_a_second_request_before_the_first_was_answered_changes_nothing(window, cameras, qtbot, folder):
    started = []
    window.worker.recordingStarted.connect(started.append)
    folder.mkdir()
    window.worker.start_recording(folder / "first.mcap")
    window.worker.start_recording(folder / "second.mcap")
    qtbot.waitUntil(lambda: window.recording.running)
    cameras.give(qtbot, 3)
    press_record(window)
    qtbot.waitUntil(lambda: not window.recording.running)
    assert started == [folder / "first.mcap"]
    assert [path.name for path in folder.iterdir()] == ["first.mcap"]


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


class HeldWriter(SessionWriter):
    """A file that takes frames until a test stops it, and is finished when the test says so."""

    def __init__(self, *words, **options):
        super().__init__(*words, **options)
        self.fault, self.may_close = None, Event()

    def put(self, frame, *, wait):
        if self.fault is not None:
            raise self.fault
        return super().put(frame, wait=wait)

    def close(self):
        self.may_close.wait(60.0)
        return super().close()


@pytest.fixture
def made():
    return []


@pytest.fixture
def ends():
    return []


@pytest.fixture
def recorder(made, ends):
    keep = lambda *words, **options: made.append(HeldWriter(*words, **options)) or made[-1]
    recorder = Recorder(lambda *end: ends.append(end), keep)
    yield recorder
    made[0].may_close.set()
    recorder.close()


def request(tmp_path):
    return tmp_path / "a.mcap", tiny_rig(), Preset(), 30.0


def frame(index):
    return tiny_frame(index, tiny_rig())


def test_stopping_does_not_wait_for_the_disk(recorder, made, ends, tmp_path):
    recorder.start(*request(tmp_path))
    recorder.put(frame(0))
    recorder.stop("another source was opened")
    assert recorder.status() is None
    assert ends == []
    made[0].may_close.set()
    recorder.close()
    assert ends[0][1] == "another source was opened"


def test_another_error_ends_the_recording_with_a_reason(recorder, made, ends, tmp_path):
    recorder.start(*request(tmp_path))
    recorder.put(frame(0))
    made[0].fault = RuntimeError("broken")
    recorder.put(frame(1))
    assert recorder.status() is None
    made[0].may_close.set()
    recorder.close()
    [(status, reason)] = ends
    assert reason == "Frame 1 could not be recorded (RuntimeError: broken)." and status.frames == 1


def test_a_watcher_that_fails_is_told_and_neither_reading_nor_recording_ends(recorder, made, ends, tmp_path):
    seen, told = [], []

    def see(shown):
        seen.append(shown.sequence)
        if shown.sequence == 1:
            raise RuntimeError("broken")

    recorder.start(*request(tmp_path))
    recorder.watch(see, told.append)
    for index in range(3):
        recorder.put(frame(index))
    assert seen == [0, 1]
    assert told == ["Frame 1 could not be used (RuntimeError: broken)."]
    made[0].may_close.set()
    recorder.stop("")
    recorder.close()
    assert ends[0][0].frames == 3
