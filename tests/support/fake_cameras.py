"""Two fake live cameras with the faults of real ones."""

from __future__ import annotations

from dataclasses import replace
from threading import Condition, Event, Thread, current_thread

from pytestqt.qtbot import QtBot

from tactune.core.errors import SourceError
from tactune.core.model.frames import Rig, SensorFrame
from tactune.core.sources.base import CameraHealth, CameraOption, CameraRole, FrameSource, Health
from tiny_sensor import tiny_frame, tiny_rig

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


class FakeCameras(FrameSource):
    """Gives a frame for each `release`, or by itself after `run`; everything may be called from any thread."""

    name = "cameras"

    def __init__(self, rig: Rig | None = None) -> None:
        self._rig = rig or tiny_rig()
        self._changed = Condition()
        self._ready = 0
        self.given: list[SensorFrame] = []
        self.error = ""
        self.ended = False
        self.closed = Event()
        self.waits = self.looks = 0
        self.timeouts_s: set[float] = set()
        self.callers: set[Thread] = set()
        self.faults: dict[CameraRole, str] = {}
        self.dropped = self.unmatched = 0
        self.message = ""
        self.values = {(option.camera, option.name): option.value for option in OPTIONS}
        self.refuses: set[str] = set()
        self._shutter: Thread | None = None

    @property
    def rig(self) -> Rig:
        return self._rig

    # What the test does to the cameras

    def release(self, count: int = 1) -> None:
        with self._changed:
            self._ready += count
            self._changed.notify_all()

    def give(self, qtbot: QtBot, count: int) -> None:
        """Release frames and wait until all are taken."""
        with self._changed:
            wanted = len(self.given) + self._ready + count
        self.release(count)
        qtbot.waitUntil(lambda: len(self.given) >= wanted)

    def run(self, rate_hz: float = 30.0) -> None:
        def expose() -> None:
            while not self.closed.wait(1.0 / rate_hz):
                if not self.faults:
                    self.release()

        self._shutter = Thread(target=expose, daemon=True)
        self._shutter.start()

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
        with self._changed:
            self.waits += 1
            self.timeouts_s.add(timeout_s)
            self.callers.add(current_thread())
            return self._changed.wait_for(lambda: bool(self._ready or self.error or self.ended), timeout_s)

    def next_frame(self) -> SensorFrame | None:
        with self._changed:
            self.callers.add(current_thread())
            if self.error:
                raise SourceError(self.error)
            if self.ended:
                return None
            self._changed.wait_for(lambda: bool(self._ready))
            self._ready -= 1
            frame = replace(tiny_frame(len(self.given) % 20, self._rig), sequence=len(self.given))
            self.given.append(frame)
            return frame

    def health(self) -> Health:
        self.looks += 1
        self.callers.add(current_thread())

        def camera(role: CameraRole, model: str, serial: str) -> CameraHealth:
            return CameraHealth(role, self.faults.get(role, "streaming"), model, serial)

        return Health(
            ok=not self.faults,
            message=self.message,
            dropped=self.dropped,
            stale=bool(self.faults),
            cameras=(camera("proximity", "L515", "f001"), camera("tactile", "D405", "d002")),
            unmatched=self.unmatched,
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
        self.closed.set()
