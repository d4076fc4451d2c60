"""The recorder between the reading thread and the file."""

from threading import Event

import pytest

from fakes import tiny_frame, tiny_rig
from tactune.app.worker.recorder import Recorder
from tactune.core.output.writer import RecordingStatus
from tactune.core.preset import Preset


class FakeWriter:
    """A file that accepts frames until a test stops it."""

    def __init__(self, path):
        self.path = path
        self.frames, self.dropped = [], 0
        self.error = None
        self.may_close = Event()
        self.may_close.set()
        self.closed = False

    def put(self, frame, *, wait):
        assert not self.closed
        if self.error is not None:
            raise self.error
        self.frames.append(frame.sequence)
        return True

    def status(self):
        return RecordingStatus(self.path, len(self.frames), self.dropped, 1000 * len(self.frames), 1.0, "")

    def close(self):
        self.may_close.wait(60.0)
        self.closed = True
        return self.status()


@pytest.fixture
def made():
    return []


@pytest.fixture
def ends():
    return []


@pytest.fixture
def recorder(made, ends):
    def open_writer(path, rig, **options):
        made.append(FakeWriter(path))
        return made[-1]

    recorder = Recorder(ends.append, open_writer)
    yield recorder
    recorder.close()


def request(tmp_path):
    return tmp_path / "a.mcap", tiny_rig(), Preset(), 30.0


def frame(index):
    return tiny_frame(index, tiny_rig())


def test_stopping_does_not_wait_for_the_disk(recorder, made, ends, tmp_path):
    recorder.start(*request(tmp_path))
    recorder.put(frame(0))
    made[0].may_close.clear()
    recorder.stop("another source was opened")
    assert not recorder.running
    assert ends == []
    made[0].may_close.set()
    recorder.close()
    assert ends[0].reason == "another source was opened"


def test_another_error_ends_the_recording_with_a_reason(recorder, made, ends, tmp_path):
    recorder.start(*request(tmp_path))
    recorder.put(frame(0))
    made[0].error = RuntimeError("broken")
    recorder.put(frame(1))
    assert not recorder.running
    recorder.close()
    assert ends[0].reason == "Frame 2 could not be recorded (RuntimeError: broken)."
    assert ends[0].status.frames == 1


def test_a_watcher_that_fails_is_told_and_neither_reading_nor_recording_ends(recorder, made, tmp_path):
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
    assert told == ["Frame 2 could not be used (RuntimeError: broken)."]
    assert made[0].frames == [0, 1, 2]
