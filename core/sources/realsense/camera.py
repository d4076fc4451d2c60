"""One camera of the rig on its own thread: reads, notices silence and unplugging, and opens it again."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from threading import Event, Lock, Thread
from typing import Any, Final, Literal, Protocol

from ...errors import SourceError
from ..base import CameraHealth, CameraOption, CameraRole
from .calibration import HEIGHT, RATE_HZ, WIDTH, Calibration
from .devices import DeviceInfo, DeviceQuery, describe
from .driver import load_driver
from .options import SensorOptions, remember, wanted_options
from .session import Image, Kind, Session

PERIOD_S: Final = 1.0 / RATE_HZ
#: A stream that has been silent for so many periods has stalled.
SILENT_S: Final = 10 * PERIOD_S
#: Seconds from one image or attempt to the next attempt to revive a silent camera.
_REVIVE_S: Final = (3.0, 6.0, 12.0, 30.0)
#: A camera that was just opened may need so long for its first image.
_WARM_UP_S: Final = 3.0
_POLL_S: Final = 0.5
_READ_S: Final = 0.05
#: What happened stays in words for so long.
_TOLD_S: Final = 5.0


class Sink(Protocol):
    """Who gets the images, on the cameras' threads."""

    def take_in(self, role: CameraRole, image: Image, arrival_s: float) -> None:
        """Take an image that arrived at ``arrival_s``, seconds on the computer's clock."""

    def opened_anew(self, role: CameraRole) -> None:
        """What comes next is of a camera that has started over."""


class Camera:
    """One camera.

    Parameters
    ----------
    device : the driver's device, which becomes this camera; it is found again by its serial number
    stored : mapping
        Options of the preset.
    query : callable
        Returns the devices that are plugged in.
    sink : Sink
        Gets every image, on this camera's thread.

    Raises
    ------
    SourceError
        It cannot be opened.
    """

    def __init__(
        self,
        role: CameraRole,
        device: Any,
        info: DeviceInfo,
        stored: Mapping[str, float],
        query: DeviceQuery,
        sink: Sink,
    ) -> None:
        self.role: CameraRole = role
        self.info = info
        self._query = query
        self._sink = sink
        self._options_lock = Lock()
        self._wanted = wanted_options(info, stored)
        self._refused: list[str] = []
        self._told = ""
        self._told_until_s = 0.0
        self._problem = ""
        self._last_number: int | None = None
        self._attempts = 0
        self._poll_at_s = 0.0
        self.dropped = 0
        self.alive_s = time.monotonic()
        self._quit = Event()
        self._thread = Thread(target=self._run, name=f"{role} camera", daemon=True)
        self._session: Session | None = None
        self.calibration: Calibration = self._open(device, info).calibration

    def start(self) -> None:
        """Let the images come, from now on."""
        if self._session is not None:
            self._session.flush()
        self._note_opened()
        self._thread.start()

    def close(self) -> None:
        """Stop the camera, and leave it to its fate if the driver does not let go of it."""
        self._quit.set()
        if self._thread.is_alive():
            self._thread.join(3.0)
        else:
            self._let_go()

    def tell(self, sentence: str) -> None:
        """Have a sentence said for a while."""
        self._told, self._told_until_s = sentence, time.monotonic() + _TOLD_S

    def health(self) -> CameraHealth:
        """Say how the camera is doing."""
        now_s = time.monotonic()
        sentences = [self._problem] if self._problem else list(self._refused)
        state: Literal["streaming", "stalled", "missing"] = "streaming"
        if self._session is None:
            state = "missing" if self._problem else "stalled"
        else:
            has_stalled = any(now_s - seen_s > SILENT_S for seen_s in self._seen_s.values())
            silent = [kind for kind, seen_s in self._seen_s.items() if has_stalled and now_s - seen_s > 0.5 * SILENT_S]
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
            return self._options.read() if self._session is not None else ()

    def set_option(self, name: str, value: float) -> None:
        """Change one setting, now and whenever the camera is opened again."""
        with self._options_lock:
            if self._session is None:
                raise SourceError(f"the {self.info.title} is not connected; plug it in, then change {name}")
            self._options.set(name, value)
            remember(self._wanted, name, value)

    def _silence(self, silent: list[Kind]) -> str:
        if len(silent) == 2:
            return f"The {self.info.title} sends nothing; it is started again if that lasts."
        lacking, sent = ("colour", "depth") if silent == ["color"] else ("depth", "colour")
        return f"The {self.info.title} sends {sent} images but no {lacking}."

    # The camera's thread

    def _run(self) -> None:
        while not self._quit.is_set():
            self.alive_s = time.monotonic()
            try:
                if self._session is None:
                    self._find_again()
                else:
                    self._read(self._session)
            except Exception as error:  # whatever it is, a camera that falls silent for good would be worse
                self._lose(f"The {self.info.title} failed ({error}); it is opened again.")
                self._quit.wait(_POLL_S)
        self._let_go()

    def _open(self, device: Any, info: DeviceInfo) -> Session:
        session = Session(device, info)
        with self._options_lock:
            self._options = SensorOptions(self.role, info, session.depth_sensor)
            self._refused = self._options.apply(self._wanted)
        session.start()
        self._note_opened()
        self._session = session
        return session

    def _note_opened(self) -> None:
        now_s = time.monotonic()
        self._seen_s: dict[Kind, float] = {"depth": now_s + _WARM_UP_S, "color": now_s + _WARM_UP_S}
        self._revive_at_s = now_s + _WARM_UP_S + _REVIVE_S[0]
        self._last_number = None

    def _read(self, session: Session) -> None:
        image = session.read(_READ_S)
        arrival_s, now_s = time.time(), time.monotonic()
        if image is not None:
            self._seen_s[image.kind] = now_s
            if self._fits(image):
                self._count_gap(image)
                self._sink.take_in(self.role, image, arrival_s)
        if now_s - self._seen_s["depth"] > SILENT_S and now_s > self._poll_at_s:
            self._poll_at_s = now_s + _POLL_S
            self._check_plugged_in()
        self._revive_if_silent(now_s)

    def _fits(self, image: Image) -> bool:
        if image.pixels.shape[:2] == (HEIGHT, WIDTH):
            return True
        height, width = image.pixels.shape[:2]
        self.tell(
            f"The {self.info.title} sent a {image.kind} image of {width} x {height} pixels instead of "
            f"{WIDTH} x {HEIGHT}; it was left out."
        )
        return False

    def _count_gap(self, image: Image) -> None:
        if image.kind == "depth":
            if self._last_number is not None:
                self.dropped += max(image.number - self._last_number - 1, 0)
            self._last_number = image.number

    def _check_plugged_in(self) -> None:
        if all(_serial(device) != self.info.serial for device in self._query()):
            self._lose(f"The {self.info.title} is unplugged: plug it in again and it goes on by itself.")

    def _revive_if_silent(self, now_s: float) -> None:
        needed: tuple[Kind, ...] = ("depth", "color") if self.role == "proximity" else ("depth",)
        if all(now_s - self._seen_s[kind] <= SILENT_S for kind in needed):
            self._attempts = 0
            self._revive_at_s = now_s + _REVIVE_S[0]
        elif now_s > self._revive_at_s:
            attempts = self._attempts + 1
            self._let_go()
            self._find_again()
            if self._session is not None:
                self.tell(f"The {self.info.title} had stopped sending and was started again.")
            self._attempts = attempts
            self._revive_at_s = time.monotonic() + _REVIVE_S[min(attempts, len(_REVIVE_S) - 1)]

    def _find_again(self) -> None:
        """Open the camera if it is plugged in, else wait a little; say what stands in its place."""
        devices = self._query()
        for device in devices:
            if _serial(device) == self.info.serial:
                self._reopen(device)
                return
        others = [info for info in map(describe, devices) if info.model == self.info.model]
        if others:
            self._problem = (
                f"The {self.info.title} is unplugged and another {others[0].model} with the serial "
                f"{others[0].serial} is connected: plug the former in again, or choose the cameras anew."
            )
        elif self._session is None and not self._problem:
            self._problem = f"The {self.info.title} is unplugged: plug it in again and it goes on by itself."
        self._quit.wait(_POLL_S)

    def _reopen(self, device: Any) -> None:
        self._sink.opened_anew(self.role)
        try:
            session = self._open(device, describe(device))
        except SourceError as error:
            text = str(error)
            self._problem = f"{text[0].upper()}{text[1:]}."
            self._quit.wait(_POLL_S)
            return
        if session.calibration != self.calibration:
            self._lose(f"The {self.info.title} has another calibration than before: open the cameras anew.")
            self._quit.wait(_POLL_S)
            return
        if self._problem:
            self.tell(f"The {self.info.title} is back.")
        self._problem = ""

    def _lose(self, sentence: str) -> None:
        self._let_go()
        self._problem = sentence

    def _let_go(self) -> None:
        with self._options_lock:
            session, self._session = self._session, None
        if session is not None:
            session.close()


def _serial(device: Any) -> str:
    with suppress(RuntimeError):  # unplugged this very moment
        return str(device.get_info(load_driver().camera_info.serial_number))
    return ""
