"""Fake sources on a tiny rig, so that flows through the whole window take milliseconds."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from threading import Condition, Event, Thread
from typing import TYPE_CHECKING

import numpy as np

from rigs import one_place_rig
from tactune.core.errors import SourceError
from tactune.core.model.frames import Rig, SensorFrame
from tactune.core.sources.base import CameraHealth, CameraOption, CameraRole, FrameSource, Health

if TYPE_CHECKING:
    from pytestqt.qtbot import QtBot

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


class FakeSource(FrameSource):
    """A recording, or with ``live`` cameras, whose frames are made on the spot.

    Parameters
    ----------
    length : int
        Number of frames; a live source never ends.
    rig : Rig, optional
        By default a tiny one of 64 x 48 pixels.
    broken : collection of int
        Frames that cannot be read.
    make : callable
        Makes frame ``index`` for the rig.
    frames : sequence of SensorFrame, optional
        The frames themselves, instead of ``length`` and ``make``.
    hold : int, optional
        Number of frames that are let through; reading more waits for `release`.
    hangs : bool
        A held live source says that it is ready and then does not return, as a hanging driver.
    untouched : SensorFrame, optional
        What `FrameSource.untouched` returns.
    ends_at : int, optional
        A recording that states more frames than it has ends here.
    """

    def __init__(
        self,
        length: int = 8,
        rig: Rig | None = None,
        broken: Collection[int] = frozenset(),
        *,
        make: Callable[[int, Rig], SensorFrame] = tiny_frame,
        frames: Sequence[SensorFrame] | None = None,
        name: str = "tiny",
        live: bool = False,
        hold: int | None = None,
        hangs: bool = False,
        rate_hz: float = 30.0,
        untouched: SensorFrame | None = None,
        ends_at: int | None = None,
    ) -> None:
        self.name = name
        self.broken = broken
        self.closed = False
        #: Set while a read waits for `release`.
        self.waiting = Event()
        self._rig = rig or tiny_rig()
        self._make = make if frames is None else lambda index, rig: frames[index]
        self._length = length if frames is None else len(frames)
        self._live, self._hangs = live, hangs
        self._rate_hz = rate_hz
        self._untouched = untouched
        self._ends_at = ends_at
        self._position = 0
        self._changed = Condition()
        self._allowed = hold

    # What the test does

    def hold(self, after: int = 0) -> None:
        """Let ``after`` more frames through; reading more waits."""
        with self._changed:
            self._allowed = after

    def release(self, count: int | None = None) -> None:
        """Let ``count`` more frames through, or all."""
        with self._changed:
            self._allowed = None if count is None or self._allowed is None else self._allowed + count
            self._changed.notify_all()

    # What the program asks

    @property
    def rig(self) -> Rig:
        return self._rig

    @property
    def length(self) -> int | None:
        return None if self._live else self._length

    @property
    def frame_rate_hz(self) -> float:
        return self._rate_hz

    @property
    def position(self) -> int:
        return self._position

    def wait(self, timeout_s: float) -> bool:
        if not self._live or self._hangs:
            return True
        with self._changed:
            return self._changed.wait_for(self._may_read, timeout_s)

    def next_frame(self) -> SensorFrame | None:
        if not self._live and self._position >= min(self._length, self._ends_at or self._length):
            return None
        frame = self.read(self._position)
        self._position += 1
        return frame

    def read(self, index: int) -> SensorFrame:
        with self._changed:
            if not self._may_read():
                self.waiting.set()
                self._changed.wait_for(self._may_read, 120)
                self.waiting.clear()
            if self._allowed:
                self._allowed -= 1
        if index in self.broken:
            raise SourceError(f"{self.name}: frame {index} is damaged; skip it")
        return self._make(index, self._rig)

    def seek(self, index: int) -> None:
        if self._live:
            super().seek(index)
        if not 0 <= index < self._length:
            raise SourceError(f"{self.name}: there is no frame {index}; frames run from 0 to {self._length - 1}")
        self._position = index

    def untouched(self) -> SensorFrame | None:
        return self._untouched

    def close(self) -> None:
        self.closed = True
        self.release()

    def _may_read(self) -> bool:
        return self._allowed is None or self._allowed > 0


OPTIONS = (
    CameraOption("proximity", "laser_power", "Power of the infrared laser.", 0, 100, 1, 70, 70, "%"),
    CameraOption(
        "proximity", "visual_preset", "Set of settings.", 0, 5, 1, 0, 0, choices=((0, "Custom"), (5, "Short range"))
    ),
    CameraOption("tactile", "exposure", "Exposure time of the stereo images.", 1, 165_000, 1, 8500, 8500, "µs"),
    CameraOption("tactile", "enable_auto_exposure", "Choose the exposure time by itself.", 0, 1, 1, 1, 1),
    CameraOption(
        "tactile", "temperature", "Temperature of the projector.", -40, 125, 0.5, 0, 31.5, "°C", read_only=True
    ),
)


def _short_press(index: int, rig: Rig) -> SensorFrame:
    return replace(tiny_frame(index % 20, rig), sequence=index)


class FakeCameras(FakeSource):
    """Live cameras with the faults of real ones; a frame for each `release`, or by itself after `run`."""

    def __init__(self, rig: Rig | None = None) -> None:
        super().__init__(rig=rig, make=_short_press, name="cameras", live=True, hold=0)
        self.given: list[SensorFrame] = []
        self.error = ""
        self.ended = False
        self.waits = 0
        self.faults: dict[CameraRole, str] = {}
        self.values = {(option.camera, option.name): option.value for option in OPTIONS}
        self.refuses: set[str] = set()
        self._stopped = Event()

    # What the test does to the cameras

    def release(self, count: int | None = 1) -> None:
        super().release(count)

    def give(self, qtbot: QtBot, count: int) -> None:
        """Release frames and wait until all are taken."""
        self.release(count)
        qtbot.waitUntil(lambda: self._allowed == 0)

    def run(self, rate_hz: float = 30.0) -> None:
        def expose() -> None:
            while not self._stopped.wait(1.0 / rate_hz):
                if not self.faults:
                    self.release()

        Thread(target=expose, daemon=True).start()

    def fail(self, sentence: str) -> None:
        with self._changed:
            self.error = sentence
            self._changed.notify_all()

    def end(self) -> None:
        with self._changed:
            self.ended = True
            self._changed.notify_all()

    # What the application asks of them

    def wait(self, timeout_s: float) -> bool:
        self.waits += 1
        return super().wait(timeout_s)

    def next_frame(self) -> SensorFrame | None:
        if self.error:
            raise SourceError(self.error)
        if self.ended:
            return None
        return super().next_frame()

    def read(self, index: int) -> SensorFrame:
        frame = super().read(index)
        self.given.append(frame)
        return frame

    def health(self) -> Health:
        def camera(role: CameraRole, model: str, serial: str) -> CameraHealth:
            return CameraHealth(role, self.faults.get(role, "streaming"), model, serial)

        return Health(
            ok=not self.faults,
            stale=bool(self.faults),
            cameras=(camera("proximity", "L515", "f001"), camera("tactile", "D405", "d002")),
        )

    def options(self) -> tuple[CameraOption, ...]:
        return tuple(
            replace(option, value=self.values[option.camera, option.name])
            for option in OPTIONS
            if self.faults.get(option.camera) != "missing"
        )

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        if name in self.refuses:
            raise SourceError(f"the {camera} camera refuses {name} = {value:g}: switch auto exposure off first")
        self.values[camera, name] = value

    def close(self) -> None:
        self._stopped.set()
        super().close()

    def _may_read(self) -> bool:
        return super()._may_read() or bool(self.error) or self.ended


def at_rest(window: MainWindow, index: int) -> bool:
    """Whether the window shows a frame and playback stands still."""
    return window.transport.state.index == index and not window.transport.state.playing
