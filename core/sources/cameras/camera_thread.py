"""Reads one camera of the rig on its own thread; detects stalls and unplugging, and reopens the camera."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from threading import Event, Lock, Thread
from typing import Final, Literal

from ...errors import SourceError, as_sentence
from ..base import CameraHealth, CameraOption, CameraRole
from .camera import Calibration, Camera, CameraDriver, DeviceInfo, Image, Kind

#: Periods without an image after which a stream counts as stalled.
SILENT_PERIODS: Final = 10
#: A stalled camera is reopened this long after its last image, and again in such intervals, seconds.
_REVIVE_S: Final = 4.0
#: Longest wait for the first image of a camera that was just opened.
_WARM_UP_S: Final = 3.0
_POLL_S: Final = 0.5
_READ_S: Final = 0.05
#: Time that a sentence about an event stays in the health message, seconds.
_TOLD_S: Final = 5.0


class CameraThread:
    """One camera of the rig on a thread of its own; the device is found again by its serial number.

    Parameters
    ----------
    stored : mapping
        Camera options of the preset.
    take_image : callable
        Called with the role, every image and its arrival, seconds on the computer's clock, on this camera's thread.
    note_reopened : callable
        Called with the role where the next image comes from a camera that was opened again.
    """

    def __init__(
        self,
        role: CameraRole,
        driver: CameraDriver,
        info: DeviceInfo,
        stored: Mapping[str, float],
        take_image: Callable[[CameraRole, Image, float], None],
        note_reopened: Callable[[CameraRole], None],
    ) -> None:
        self.role: CameraRole = role
        self.info = info
        self._driver = driver
        self._take_image, self._note_reopened = take_image, note_reopened
        self._options_lock = Lock()
        self._wanted = dict(stored)
        self._refused: list[str] = []
        self._told = ""
        self._told_until_s = 0.0
        self._problem = ""
        self._last_number: int | None = None
        self._poll_at_s = 0.0
        self.dropped = 0
        self.alive_s = time.monotonic()
        self._quit = Event()
        self._thread = Thread(target=self._run, name=f"{role} camera", daemon=True)
        self._camera: Camera | None = None
        camera = self._open()
        self.calibration: Calibration = camera.calibration
        self.rate_hz = camera.rate_hz
        self.silent_s = SILENT_PERIODS / camera.rate_hz

    def start(self) -> None:
        """Read images, beginning with the next one."""
        if self._camera is not None:
            self._camera.flush()
        self._note_opened()
        self._thread.start()

    def close(self) -> None:
        """Stop the camera; its thread is abandoned if the driver does not return."""
        self._quit.set()
        if self._thread.is_alive():
            self._thread.join(3.0)
        else:
            self._close_camera()

    def tell(self, sentence: str) -> None:
        """Show a sentence in the health message for a few seconds."""
        self._told, self._told_until_s = sentence, time.monotonic() + _TOLD_S

    def health(self) -> CameraHealth:
        """Return the state of the camera."""
        now_s = time.monotonic()
        sentences = [self._problem] if self._problem else list(self._refused)
        state: Literal["streaming", "stalled", "missing"] = "streaming"
        if self._camera is None:
            state = "missing" if self._problem else "stalled"
        else:
            silences_s = {kind: now_s - seen_s for kind, seen_s in self._seen_s.items()}
            has_stalled = any(silence_s > self.silent_s for silence_s in silences_s.values())
            silent = [kind for kind, each_s in silences_s.items() if has_stalled and each_s > 0.5 * self.silent_s]
            if "depth" in silent or (silent and self.role == "proximity"):
                state = "stalled"
            if silent:
                sentences.append(self._silence(silent))
        if now_s < self._told_until_s:
            sentences.append(self._told)
        return CameraHealth(self.role, state, self.info.model, self.info.serial, " ".join(sentences))

    def options(self) -> tuple[CameraOption, ...]:
        """Return the settings; none while the camera is missing."""
        with self._options_lock:
            return self._camera.options() if self._camera is not None else ()

    def set_option(self, name: str, value: float) -> None:
        """Change one setting; it is set again whenever the camera is reopened."""
        with self._options_lock:
            if self._camera is None:
                raise SourceError(f"the {self.info.title} is not connected; plug it in, then change {name}")
            self._camera.set_option(name, value)
            for other in self._camera.reset_by(name):
                self._wanted.pop(other, None)
            self._wanted[name] = value

    def _silence(self, silent: list[Kind]) -> str:
        if len(silent) == len(self._seen_s):
            return f"The {self.info.title} sends nothing; it is started again if that lasts."
        lacking, sent = ("colour", "depth") if silent == ["color"] else ("depth", "colour")
        return f"The {self.info.title} sends {sent} images but no {lacking}."

    # The camera's thread

    def _run(self) -> None:
        while not self._quit.is_set():
            self.alive_s = time.monotonic()
            try:
                if self._camera is None:
                    self._find_again()
                else:
                    self._read(self._camera)
            except Exception as error:  # a driver may raise anything; without this the camera would stay silent
                self._lose(f"The {self.info.title} failed ({error}); it is opened again.")
                self._quit.wait(_POLL_S)
        self._close_camera()

    def _open(self) -> Camera:
        camera = self._driver.open(self.info.serial, self.role)
        try:
            with self._options_lock:
                self._refused = camera.apply_options({**camera.defaults, **self._wanted})
            camera.start()
        except BaseException:
            camera.close()
            raise
        self._kinds: tuple[Kind, ...] = ("depth",) if camera.calibration.color is None else ("depth", "color")
        self._note_opened()
        self._camera = camera
        return camera

    def _note_opened(self) -> None:
        now_s = time.monotonic()
        self._seen_s: dict[Kind, float] = dict.fromkeys(self._kinds, now_s + _WARM_UP_S)
        self._revive_at_s = now_s + _WARM_UP_S + _REVIVE_S
        self._last_number = None

    def _read(self, camera: Camera) -> None:
        images = camera.read(_READ_S)
        arrival_s, now_s = time.time(), time.monotonic()
        for image in images:
            if image.kind not in self._kinds:
                continue
            self._seen_s[image.kind] = now_s
            if image.kind == "depth":
                if self._last_number is not None:
                    self.dropped += max(image.number - self._last_number - 1, 0)
                self._last_number = image.number
            self._take_image(self.role, image, arrival_s)
        if now_s - self._seen_s["depth"] > self.silent_s and now_s > self._poll_at_s:
            self._poll_at_s = now_s + _POLL_S
            if self.info.serial not in self._driver.serials():
                self._lose(self._unplugged)
        needed = self._kinds if self.role == "proximity" else ("depth",)
        if all(now_s - self._seen_s[kind] <= self.silent_s for kind in needed):
            self._revive_at_s = now_s + _REVIVE_S
        elif now_s > self._revive_at_s:
            self._close_camera()
            self._find_again()
            if self._camera is not None:
                self.tell(f"The {self.info.title} had stopped sending and was started again.")

    @property
    def _unplugged(self) -> str:
        return f"The {self.info.title} is unplugged: plug it in again and it continues automatically."

    def _find_again(self) -> None:
        """Open the camera if it is connected, else wait a little."""
        if self.info.serial in self._driver.serials():
            self._reopen()
        else:
            self._problem = self._problem or self._unplugged
            self._quit.wait(_POLL_S)

    def _reopen(self) -> None:
        self._note_reopened(self.role)
        try:
            camera = self._open()
        except SourceError as error:
            self._problem = as_sentence(str(error))
            self._quit.wait(_POLL_S)
            return
        if camera.calibration != self.calibration:
            self._lose(f"The {self.info.title} has another calibration than before: open the cameras again.")
            self._quit.wait(_POLL_S)
            return
        if self._problem:
            self.tell(f"The {self.info.title} is back.")
        self._problem = ""

    def _lose(self, sentence: str) -> None:
        self._close_camera()
        self._problem = sentence

    def _close_camera(self) -> None:
        with self._options_lock:
            camera, self._camera = self._camera, None
        if camera is not None:
            camera.close()
