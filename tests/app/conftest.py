"""Windows that show the tiny recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pyqtgraph as pg
import pytest
from PyQt6.QtWidgets import QApplication

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
def compiled() -> Iterator[None]:
    """Compile the kernels before anything waits for a first frame; at the end wait for threads, or Python aborts."""
    warm_up_if_needed(lambda share, words: None)
    rig = tiny_rig()
    info = SourceInfo("tiny", rig, 1, 30.0)
    FrameProcessor().process(info, tiny_frame(0, rig), Preset(), Wanted(), PlaybackState())
    yield
    wait_for_abandoned(60.0)


@pytest.fixture
def preset() -> Preset:
    """A preset with the tolerance test. For the membrane test the disc's 2 mm are a gap, not a bias."""
    values = {"tolerance.t": 0.03, "outliers.enabled": False, "membrane.bias": False}
    return Preset(name="tiny", contact_test="tolerance").with_values(values)


@pytest.fixture
def source() -> Iterator[FakeSource]:
    made = FakeSource()
    yield made
    made.close()


@pytest.fixture
def settings_file(tmp_path) -> Path:
    return tmp_path / "window.json"


@pytest.fixture
def make_window(qtbot, preset, tmp_path, settings_file, monkeypatch) -> Iterator[Callable[..., MainWindow]]:
    """Open windows that use nothing of the person's own folders, and close them whatever happened."""
    pg.setConfigOptions(mouseRateLimit=-1)
    windows = []

    def make(start: Preset = preset, size: tuple[int, int] | None = (1280, 800)) -> MainWindow:
        window = MainWindow(start, Settings(settings_file), tmp_path / "unsaved", native_dialogs=False)
        windows.append(window)
        window.set_theme("light", remember=False)
        window.settings.set("folder/preset", str(tmp_path))
        window.settings.set("folder/export", str(tmp_path))
        if size is not None:
            window.resize_to(*size)
        window.show()
        qtbot.waitExposed(window)
        window.activateWindow()
        qtbot.waitUntil(window.isActiveWindow)
        return window

    yield make
    for window in windows:
        if window.worker.isRunning():
            window.close_without_asking()
            qtbot.waitUntil(window.worker.isFinished)  # a recording is finished first
    wait_for_abandoned(60.0)  # what goes on would take its time from the next test
    for window in windows:
        window.deleteLater()
    QApplication.processEvents()


@pytest.fixture
def window(qtbot, make_window) -> MainWindow:
    """A window that stands still at frame 3 of a recording of 8."""
    made = make_window()
    show_source(qtbot, made, FakeSource(), 3)
    return made


@pytest.fixture
def cameras(window, qtbot) -> FakeCameras:
    """Live cameras in the window; their first frame is shown."""
    made = FakeCameras()
    made.release()
    show_source(qtbot, window, made)
    return made


@pytest.fixture
def watched(qtbot, preset) -> Iterator[Watched]:
    made = Watched(preset)
    yield made
    made.worker.shut_down()
    assert made.worker.isFinished()
