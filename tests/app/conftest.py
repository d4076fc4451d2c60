"""Windows that show the tiny recording."""

import json
import time

import pyqtgraph as pg
import pytest
from PyQt6.QtWidgets import QApplication, QDialog

from fakes import FakeCameras, FakeSource, tiny_frame, tiny_rig
from hands import show_source
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.playback import PlaybackState
from tactune.app.worker.processing import FrameProcessor
from tactune.app.worker.results import SourceInfo, Wanted
from tactune.app.worker.threads import wait_for_abandoned
from tactune.core.preset import Preset
from tactune.core.warmup import warm_up_if_needed
from watched_worker import Watched


@pytest.fixture(scope="session", autouse=True)
def compiled():
    """Compile the kernels before anything waits for a first frame; at the end wait for threads, or Python aborts."""
    pg.setConfigOptions(mouseRateLimit=-1)
    warm_up_if_needed(lambda share, words: None)
    rig = tiny_rig()
    info = SourceInfo("tiny", rig, 1, 30.0)
    FrameProcessor().process(info, tiny_frame(0, rig), Preset(), Wanted(), PlaybackState())
    yield
    wait_for_abandoned(60.0)


@pytest.fixture(scope="session")
def preset():
    """A preset with the tolerance test. For the membrane test the disc's 2 mm are a gap, not a bias."""
    values = {"tolerance.t": 0.03, "outliers.enabled": False, "membrane.bias": False}
    return Preset(name="tiny", contact_test="tolerance").with_values(values)


@pytest.fixture
def source():
    made = FakeSource()
    yield made
    made.close()


@pytest.fixture
def settings_file(tmp_path):
    return tmp_path / "window.json"


def open_window(qtbot, folder, settings_file, start, size):
    settings = Settings(settings_file)
    if not settings.text("theme"):
        settings.set("theme", "light")
        settings.set("window/mode", "tune")
    window = MainWindow(start, settings, folder / "unsaved", native_dialogs=False)
    window.settings.set("folder/preset", str(folder))
    window.settings.set("folder/export", str(folder))
    if size is not None:
        window.resize(*size)
    window.show()
    qtbot.waitExposed(window)
    activate(qtbot, window)
    return window


def activate(qtbot, window):
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)


def close_window(window):
    if window.worker.isRunning():
        window.close_without_asking()
        end = time.monotonic() + 60.0
        while window.worker.isRunning() and time.monotonic() < end:  # a recording is finished first
            QApplication.processEvents()
    wait_for_abandoned(60.0)  # what goes on would take its time from the next test
    window.deleteLater()
    QApplication.processEvents()


class SharedWindow:
    """One main window for the tests of a module; one that a test left with other windows open is replaced."""

    def __init__(self, folder):
        self._folder, self._opened = folder, 0
        self._window = None
        self._others = 0
        self._settings = {}

    def ready(self, qtbot, tmp_path, preset):
        window = self._window
        if window is not None:
            _forget_analyses(window)
        if window is not None and not self._reusable(window):
            self.close()
            window = self._window
        if window is None:
            self._opened += 1
            folder = self._folder / str(self._opened)
            folder.mkdir()
            window = self._window = open_window(qtbot, folder, folder / "window.json", preset, (1280, 800))
            window.remember_layout()
            self._others, self._settings = _others(window), self._remembered(window)
        else:
            self._reset(window, preset)
            activate(qtbot, window)
        for key in ("folder/preset", "folder/export"):
            window.settings.set(key, str(tmp_path))
        return window

    def close(self):
        if self._window is not None:
            close_window(self._window)
        self._window = None

    def _reusable(self, window):
        busy = window.recording.running or window.status.publishing.isVisible() or window.context.trim
        return not busy and window.worker.isRunning() and _others(window) == self._others

    def _remembered(self, window):
        window.settings.sync()
        return json.loads((self._folder / str(self._opened) / "window.json").read_text())

    def _reset(self, window, preset):
        """Bring a window back to how it opens: layout, messages, preset, playback."""
        window.context.comparison.end()
        window.eyedropper.use("off")
        window.views.back()
        for key in list(window.messages.by_key):
            window.messages.clear(key)
        window.document.new(preset)
        for key in self._remembered(window).keys() | self._settings.keys():
            window.settings.set(key, self._settings.get(key, ""))
        window.restore_layout()
        window.strip.point_at(-1, -1)
        window.strip.reset_view()
        window.views.setFocus()
        window.actions_.loop.setChecked(True)
        window.worker.set_loop(True)
        window.worker.set_speed(1.0)


def _forget_analyses(window):
    """Close the window of the analyses, and what its tabs remember."""
    window.analysis.close()
    if window.analysis.window is not None:
        window.analysis.window.deleteLater()
        window.analysis.window = None


def _others(window):
    """The dialogs of a window, and the windows that are seen: tests leave some behind."""
    shown = [each for each in QApplication.topLevelWidgets() if each.isVisible()]
    return len(window.findChildren(QDialog)) + len(shown)


@pytest.fixture(scope="module")
def shared(qapp, tmp_path_factory):
    holder = SharedWindow(tmp_path_factory.mktemp("window"))
    yield holder
    holder.close()


@pytest.fixture
def make_window(qtbot, shared, preset, tmp_path, settings_file):
    """Open windows that use nothing of the person's own folders, and close them whatever happened."""
    shared.close()
    windows = []

    def make(start=preset, size=(1280, 800)):
        window = open_window(qtbot, tmp_path, settings_file, start, size)
        windows.append(window)
        return window

    yield make
    for window in windows:
        close_window(window)


@pytest.fixture
def own_window(qtbot, make_window):
    """A window of this test alone, standing still at frame 3 of a recording of 8."""
    made = make_window()
    show_source(qtbot, made, FakeSource(), 3)
    return made


@pytest.fixture
def window(request, qtbot, shared, tmp_path, preset):
    """The window of the module at frame 3 of a recording of 8; tests that open more windows get one of their own."""
    if "make_window" in request.fixturenames:
        return request.getfixturevalue("own_window")
    shown = shared.ready(qtbot, tmp_path, preset)
    show_source(qtbot, shown, FakeSource(), 3)
    return shown


@pytest.fixture
def cameras(window, qtbot):
    """Live cameras in the window; their first frame is shown."""
    made = FakeCameras()
    made.release()
    show_source(qtbot, window, made)
    return made


@pytest.fixture
def watched(qtbot, preset):
    made = Watched(preset)
    yield made
    made.worker.shut_down()
    assert made.worker.isFinished()
