"""The capture process dies or hangs: the window stays responsive, reports it and continues."""

import os
import signal
from functools import partial

import numpy as np
import pytest
from PyQt6.QtWidgets import QApplication

from capture_sources import capture_pid, open_troubled
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.reading import SourceRequest
from tactune.core.preset import Preset
from tactune.core.sources.capture.source import ProcessSource
from tactune.core.sources.registry import open_source
from tactune.widgets.basics.messages import Message


class Watched:
    """A window on a source in a process of its own."""

    def __init__(self, window, folder, opener):
        self.window = window
        self.folder = folder
        self._opener = opener
        self.source = None
        self.states = []
        self.ends = []
        window.worker.stateChanged.connect(self.states.append)
        window.worker.recordingEnded.connect(self.ends.append)
        window.open_request(SourceRequest("watched", self._open))

    def _open(self, progress):
        self.source = ProcessSource(partial(self._opener, self.folder), progress)
        return self.source

    def start_recording(self, qtbot):
        """Start a recording and return its path when it has some frames."""
        path = self.folder / "session.mcap"
        recorder = self.window.worker.recorder
        self.window.worker.start_recording(path)
        qtbot.waitUntil(lambda: (status := recorder.status()) is not None and status.frames > 10)
        return path

    def sentences(self):
        """All that the window says above its views at present."""
        return " ".join(message.sentence for message in self.window.findChildren(Message))


@pytest.fixture
def watch(qtbot, tmp_path):
    """Open a window on a source, wait for its first frame, and close it in the end."""
    preset = Preset.model_validate({"name": "tiny", "outliers": {"enabled": False}})
    window = MainWindow(preset, Settings(tmp_path / "window.json"), tmp_path, native_dialogs=False)

    def make(opener):
        window.show()
        made = Watched(window, tmp_path, opener)
        qtbot.waitUntil(lambda: window.result is not None)
        return made

    yield make
    if window.worker.isRunning():
        window.close_without_asking()
        qtbot.waitUntil(lambda: not window.worker.isRunning())
    window.deleteLater()
    QApplication.processEvents()


def test_the_window_stays_responsive_says_it_and_goes_on(qtbot, watch):
    watched = watch(open_troubled)
    window, what = watched.window, "ended with status -9"
    path = watched.start_recording(qtbot)
    os.kill(capture_pid(), signal.SIGKILL)
    qtbot.waitUntil(lambda: any(state.stale and what in state.health.message for state in watched.states))
    qtbot.waitUntil(lambda: what in watched.sentences())
    qtbot.waitUntil(lambda: not watched.states[-1].stale)
    shown = window.result.processed
    qtbot.waitUntil(lambda: window.result.processed > shown + 10)
    window.worker.stop_recording()
    qtbot.waitUntil(lambda: bool(watched.ends))
    (end,) = watched.ends
    assert (end.reason, end.status.error, end.status.dropped) == ("", "", 0)
    with open_source(str(path)) as recording:
        frames = list(recording)
    assert len(frames) == end.status.frames > 10
    assert np.all(np.diff([frame.proximity_time_s for frame in frames]) > 0)
