"""One live camera on a thread of its own: it is opened again when it delivers no images, fails or is unplugged."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from threading import Event, Lock, Thread
from typing import Final, Literal

from ...errors import SourceError, as_sentence, closed_on_error
from ..base import CameraHealth, CameraOption, CameraRole
from .camera import Calibration, Camera, CameraDriver, DeviceInfo, Images

#: Periods without images after which a camera counts as stalled.
SILENT_PERIODS: Final = 10
#: A camera is opened again this long after its last images, seconds.
_REVIVE_S: Final = 3.0
#: Longest wait for the first images of a camera that was just opened.
_WARM_UP_S: Final = 3.0
_RETRY_S: Final = 0.5
_READ_S: Final = 0.05


class CameraThread:
    """One camera on a thread of its own, which finds it again by its serial number and calls ``take`` with images."""

    def __init__(
        self,
        role: CameraRole,
        driver: CameraDriver,
        info: DeviceInfo,
        stored: Mapping[str, float],
        take: Callable[[CameraRole, Images, float], None],
    ) -> None:
        self.role: CameraRole = role
        self.info = info
        self.dropped = 0
        self.alive_s = time.monotonic()
        self._driver, self._take = driver, take
        self._options_lock = Lock()
        self._wanted = dict(stored)
        self._refused: list[str] = []
        self._problem = ""
        self._last_number: int | None = None
        self._quit = Event()
        self._thread = Thread(target=self._run, name=f"{role} camera", daemon=True)
        self._camera: Camera | None = None
        camera = self._open()
        self.calibration: Calibration = camera.calibration
        self.rate_hz = camera.rate_hz
        self.silent_s = SILENT_PERIODS / camera.rate_hz
        self._seen_s = time.monotonic() + _WARM_UP_S

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """Stop the camera; its thread is abandoned if the driver does not return."""
        self._quit.set()
        if self._thread.is_alive():
            self._thread.join(3.0)
        else:
            self._close_camera()

    def health(self) -> CameraHealth:
        state: Literal["streaming", "stalled", "missing"] = "streaming"
        sentences = list(self._refused)
        if self._problem:
            state, sentences = "missing", [self._problem]
        elif time.monotonic() - self._seen_s > self.silent_s:
            state = "stalled"
            what = "images" if self.role == "tactile" or self.calibration.color is None else "images with colour"
            sentences.append(f"The {self.info.title} sends no {what}; it is started again if that lasts.")
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
            self._wanted[name] = value

    # The camera's thread

    def _run(self) -> None:
        while not self._quit.is_set():
            self.alive_s = time.monotonic()
            try:
                if self._camera is None:
                    if self._open().calibration != self.calibration:
                        changed = f"the {self.info.title} has another calibration than before: open the cameras again"
                        raise SourceError(changed)
                    self._problem = ""
                else:
                    self._read(self._camera)
            except Exception as error:  # a driver may raise anything; without this the camera would stay silent
                self._close_camera()
                is_ours = isinstance(error, SourceError)
                self._problem = as_sentence(str(error)) if is_ours else f"The {self.info.title} failed ({error})."
                self._quit.wait(_RETRY_S)
        self._close_camera()

    def _open(self) -> Camera:
        camera = self._driver.open(self.info.serial, self.role)
        with closed_on_error(camera.close):
            order = [option.name for option in camera.options()]
            self._refused = []
            for name in sorted(self._wanted, key=lambda name: order.index(name) if name in order else len(order)):
                try:
                    camera.set_option(name, self._wanted[name])
                except SourceError as error:
                    self._refused.append(as_sentence(str(error)))
            camera.start()
        self._revive_at_s = time.monotonic() + _WARM_UP_S + _REVIVE_S
        self._last_number = None
        self._camera = camera
        return camera

    def _read(self, camera: Camera) -> None:
        images = camera.read(_READ_S)
        now_s = time.monotonic()
        # the mask needs the proximity camera's colour, nothing the tactile camera's
        needs_color = self.role == "proximity" and self.calibration.color is not None
        if images is not None and (images.color is not None or not needs_color):
            if self._last_number is not None:
                self.dropped += max(images.number - self._last_number - 1, 0)
            self._last_number = images.number
            self._seen_s, self._revive_at_s = now_s, now_s + _REVIVE_S
            self._take(self.role, images, now_s)
        elif now_s > self._revive_at_s:
            self._close_camera()

    def _close_camera(self) -> None:
        with self._options_lock:
            camera, self._camera = self._camera, None
        if camera is not None:
            camera.close()
