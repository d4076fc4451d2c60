"""A tiny rig and a tiny recording, so that flows through the whole window take milliseconds."""

from __future__ import annotations

from threading import Event
from typing import TYPE_CHECKING

import numpy as np

from rigs import one_place_rig
from tactune.core.errors import SourceError
from tactune.core.model.frames import Rig, SensorFrame
from tactune.core.sources.base import FrameSource, SeekableSource

if TYPE_CHECKING:
    from tactune.app.window.main_window import MainWindow

WIDTH, HEIGHT = 64, 48
CONTACT_RGB = (200, 40, 40)
MEMBRANE_RGB = (40, 60, 200)


def tiny_rig(width: int = WIDTH, height: int = HEIGHT, serial: str = "1") -> Rig:
    return one_place_rig(width, height, 60.0, serial=serial)


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
        self.asked, self.stopped = Event(), Event()

    @property
    def rig(self) -> Rig:
        return self._rig

    def next_frame(self) -> SensorFrame | None:
        self.asked.set()
        while not self.more.wait(0.005):
            if self.stopped.is_set():
                return None
        self.more.clear()
        self.count += 1
        return tiny_frame(self.count - 1, self._rig)


def at_rest(window: MainWindow, index: int) -> bool:
    """Whether the window shows a frame and playback stands still."""
    return window.transport.state.index == index and not window.transport.state.playing
