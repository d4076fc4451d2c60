"""A tiny rig and a tiny recording, so that flows through the whole window take milliseconds."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event

if not any(os.environ.get(name) for name in ("QT_QPA_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY")):
    os.environ["QT_QPA_PLATFORM"] = "offscreen"  # so that a bare pytest works on a machine without a display

import numpy as np
import pyqtgraph as pg
import pytest
from PyQt6.QtWidgets import QApplication

from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.playback import PlaybackState
from tactune.app.worker.processing import FrameProcessor
from tactune.app.worker.results import SourceInfo, Wanted
from tactune.app.worker.threads import wait_for_left
from tactune.app.worker.worker import SourceRequest
from tactune.core.contact.warmup import warm_up_if_needed
from tactune.core.errors import SourceError
from tactune.core.model.frames import DepthCamera, Rig, SensorFrame
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.preset import Preset
from tactune.core.sources.base import FrameSource, SeekableSource

WIDTH, HEIGHT = 64, 48
CONTACT_RGB = (200, 40, 40)
MEMBRANE_RGB = (40, 60, 200)


def tiny_rig(width: int = WIDTH, height: int = HEIGHT, serial: str = "1") -> Rig:
    """Both cameras in one place, so that pixels match one to one."""
    intrinsics = Intrinsics(width=width, height=height, fx=60.0, fy=60.0, cx=(width - 1) / 2, cy=(height - 1) / 2)
    pose = np.eye(4).tolist()
    return Rig(
        proximity=DepthCamera(model="L515", serial=f"p{serial}", intrinsics=intrinsics, depth_unit_m=0.00025),
        tactile=DepthCamera(model="D405", serial=f"t{serial}", intrinsics=intrinsics, depth_unit_m=0.0001),
        T_proximity_tactile=pose,
    )


def tiny_frame(index: int, rig: Rig) -> SensorFrame:
    """A disc that grows with the frame number touches the membrane; elsewhere the object is 20 mm behind it."""
    height, width = rig.proximity.intrinsics.shape
    v, u = np.mgrid[:height, :width]
    touching = np.hypot(u - width / 2, v - height / 2) < 4 + index
    membrane_m = 0.25 + 0.0001 * (u % 5)
    object_m = np.where(touching, membrane_m + 0.002, membrane_m + 0.02)
    color = np.where(touching[..., None], CONTACT_RGB, MEMBRANE_RGB).astype(np.uint8)
    return SensorFrame(
        sequence=index,
        proximity_depth=np.rint(object_m / rig.proximity.depth_unit_m).astype(np.uint16),
        tactile_depth=np.rint(membrane_m / rig.tactile.depth_unit_m).astype(np.uint16),
        proximity_color=color,
        proximity_time_s=index / 30,
        tactile_time_s=index / 30 + 0.002,
    )


class TinySource(SeekableSource):
    """A recording made up on the spot; ``broken`` frames cannot be read."""

    def __init__(self, length: int = 8, rig: Rig | None = None, broken: frozenset[int] = frozenset()) -> None:
        super().__init__("tiny", rig or tiny_rig(), length)
        self.broken = broken
        self.closed = False

    def read(self, index: int) -> SensorFrame:
        if index in self.broken:
            raise SourceError(f"tiny: frame {index} is damaged; skip it")
        return tiny_frame(index, self.rig)

    def close(self) -> None:
        self.closed = True


class HangingSource(TinySource):
    """A recording on a disk that answers no more from frame 3 on."""

    def __init__(self):
        super().__init__()
        self.hangs, self.go_on = Event(), Event()

    def read(self, index):
        if index >= 3:
            self.hangs.set()
            self.go_on.wait(60)
        return super().read(index)


class LiveSource(FrameSource):
    """Frames that come when the test lets them."""

    name = "live"

    def __init__(self) -> None:
        self._rig = tiny_rig()
        self.count = 0
        self.more = Event()
        self.stopped = Event()

    @property
    def rig(self) -> Rig:
        return self._rig

    def next_frame(self) -> SensorFrame | None:
        while not self.more.wait(0.005):
            if self.stopped.is_set():
                return None
        self.more.clear()
        self.count += 1
        return tiny_frame(self.count - 1, self._rig)


@pytest.fixture(scope="session", autouse=True)
def compiled() -> None:
    """Compile the kernels before anything waits for a first frame."""
    warm_up_if_needed(lambda share, words: None)
    rig = tiny_rig()
    info = SourceInfo("tiny", rig, 1, 30.0)
    FrameProcessor().process(info, tiny_frame(0, rig), Preset(), Wanted(), PlaybackState())


@pytest.fixture
def preset() -> Preset:
    return Preset.model_validate({"name": "tiny", "tolerance": {"t": 0.03}, "outliers": {"enabled": False}})


@pytest.fixture
def source() -> Iterator[TinySource]:
    made = TinySource()
    yield made
    made.close()


@pytest.fixture
def settings_file(tmp_path) -> Path:
    return tmp_path / "window.ini"


@pytest.fixture
def make_window(qtbot, preset, tmp_path, settings_file) -> Iterator[Callable[..., MainWindow]]:
    """Open windows that use nothing of the person's own folders, and close them whatever happened."""
    pg.setConfigOptions(mouseRateLimit=-1)
    windows = []

    def make(start: Preset = preset, size: tuple[int, int] = (1280, 800)) -> MainWindow:
        window = MainWindow(
            start, Settings(settings_file), tmp_path / "unsaved", native_dialogs=False, backend="software"
        )
        windows.append(window)
        window.set_theme("light", remember=False)
        window.settings.set("folder/preset", str(tmp_path))
        window.settings.set("folder/export", str(tmp_path))
        window.resize(*size)
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
    wait_for_left(60.0)  # what goes on would take its time from the next test
    for window in windows:
        window.deleteLater()
    QApplication.processEvents()


@pytest.fixture
def window(qtbot, make_window) -> MainWindow:
    """A window that stands still at frame 3 of a recording of 8."""
    made = make_window()
    made.open_request(SourceRequest("tiny", lambda progress: TinySource()))
    qtbot.waitUntil(lambda: made.result is not None)
    made.worker.pause()
    made.worker.seek(3)
    qtbot.waitUntil(lambda: at_rest(made, 3))
    return made


def at_rest(window: MainWindow, index: int) -> bool:
    """Whether the window shows a frame and playback stands still."""
    return window.transport.state.index == index and not window.transport.state.playing
