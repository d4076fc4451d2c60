"""Two live cameras, of one maker or two, as one source of frames."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from threading import Condition
from typing import Final

from ...errors import SourceError, closed_on_error
from ...model.frames import Rig, SensorFrame, Shot
from ...preset import CamerasSection
from ..base import CameraOption, CameraRole, FrameSource, Health, Progress
from ..capture.process_source import ProcessSource
from .camera import CameraDriver, Images
from .camera_thread import CameraThread
from .drivers import SCHEME, camera_drivers, choose, connected_devices
from .pairing import Pairer, Timed

_ANY_CAMERAS: Final = CamerasSection()
#: A driver call that takes longer than this counts as hung.
HUNG_S: Final = 8.0
#: Longest queue of frames: two seconds, because a busy computer can delay the reader.
_MAX_WAITING: Final = 60
#: How long images wait for the other camera, which may deliver late.
_PATIENCE_S: Final = 1.0
_ROLES: Final[tuple[CameraRole, ...]] = ("proximity", "tactile")


def open_in_process(rest: str, progress: Progress | None, cameras: CamerasSection | None) -> FrameSource:
    """Open ``PROXIMITY,TACTILE``, serial numbers, or ``,TACTILE`` alone; else those of the preset, or by model."""
    chosen, roles = cameras or CamerasSection(), _ROLES
    if rest:
        serials = [serial.strip() for serial in rest.split(",")]
        if len(serials) != 2 or not serials[1]:
            raise SourceError(
                f"cameras:{rest}: give both serial numbers, as in cameras:f0090001,130322270002, or none, or "
                "cameras:,130322270002 for a tactile camera only"
            )
        roles = _ROLES if serials[0] else _ROLES[1:]
        for role, serial in zip(_ROLES, serials, strict=True):
            chosen = chosen.model_copy(update={role: getattr(chosen, role).model_copy(update={"serial": serial})})
    return ProcessSource(partial(open_cameras, chosen, roles=roles), progress)


def open_cameras(cameras: CamerasSection, progress: Progress, *, roles: Sequence[CameraRole]) -> FrameSource:
    """Open the cameras of all installed drivers; picklable."""
    drivers, problems = camera_drivers()
    name = "" if "proximity" in roles else f"{SCHEME}:,{cameras.tactile.serial}"
    return CameraSource(drivers, cameras, progress, problems, name=name, roles=roles)


class CameraSource(FrameSource):
    """A proximity and a tactile camera, paired by time; or a tactile camera only.

    Frames are numbered from 0 and carry the cameras' time stamps on the computer's clock; the tactile camera's
    are reduced by ``cameras.tactile_delay_s``. While a camera stalls or is missing there are no frames and `health`
    says why; frames continue by themselves when it is back. The two cameras may have different drivers; ``problems``
    are sentences about drivers that cannot be used; ``roles`` are those of the cameras to open; ``name`` is that of the
    source if it is not ``cameras:``.
    """

    def __init__(
        self,
        drivers: Sequence[CameraDriver],
        cameras: CamerasSection = _ANY_CAMERAS,
        progress: Progress | None = None,
        problems: Sequence[str] = (),
        *,
        name: str = "",
        roles: Sequence[CameraRole] = ("proximity", "tactile"),
    ) -> None:
        serials = (cameras.proximity.serial, cameras.tactile.serial)
        self.name = name or (f"{SCHEME}:{','.join(serials)}" if all(serials) else f"{SCHEME}:")
        self._feeds: dict[CameraRole, CameraThread] = {}
        self._sequence = self._lost = 0
        self._latest_s: dict[CameraRole, float] = {}
        self._ready: deque[tuple[Timed[Images], Timed[Images]]] = deque()
        self._changed = Condition()
        self._closed = False
        tell = progress or (lambda share, words: None)
        tell(0.0, "looking for cameras")
        connected, failures = connected_devices(drivers)
        hint = "; ".join(filter(None, [*(driver.hint() for driver in drivers), *failures, *problems]))
        chosen = choose([info for _, info in connected], cameras, hint, roles)
        try:
            with closed_on_error(self._close_feeds):
                for share, (role, info) in zip((0.2, 0.6), chosen.items(), strict=False):
                    tell(share, f"opening the {info.title}")
                    driver = next(driver for driver, known in connected if known is info)
                    self._feeds[role] = CameraThread(role, driver, info, getattr(cameras, role).options, self._add)
        except SourceError as error:
            raise SourceError(f"{self.name.rstrip(':')}: {error}") from error
        self.frame_rate_hz = next(iter(self._feeds.values())).rate_hz
        self._delay_s = cameras.tactile_delay_s
        self._pairer: Pairer[Images] = Pairer(1.0 / self.frame_rate_hz, _PATIENCE_S + abs(self._delay_s))
        tactile = self._feeds["tactile"].calibration
        #: As the cameras report it, without the pose between them: that comes from a calibration.
        self.rig = Rig.of_one_camera(tactile.depth)
        if "proximity" in self._feeds:
            proximity = self._feeds["proximity"].calibration
            self.rig = Rig(proximity=proximity.depth, tactile=tactile.depth, proximity_color=proximity.color_camera)
        self._last_frame_s = time.monotonic()
        for feed in self._feeds.values():
            feed.start()

    def wait(self, timeout_s: float) -> bool:
        """Wait for a pair of images, at most ``timeout_s``; `SourceError` if a driver hangs."""
        for feed in self._feeds.values():
            if not self._closed and time.monotonic() - feed.alive_s > HUNG_S:
                raise SourceError(f"{self.name.rstrip(':')}: the driver does not come back from the {feed.info.title}")
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._ready) or self._closed, timeout_s)

    def next_frame(self) -> SensorFrame | None:
        """Wait for the next pair of images and return it; None once the source is closed."""
        while not self.wait(1.0):
            pass
        with self._changed:
            if self._closed:
                return None
            first, second = self._ready.popleft()
        self._last_frame_s = time.monotonic()
        depth, color = second.item.depth, second.item.color
        if color is not None:
            color = self._feeds["tactile"].calibration.color_on_depth(color, depth)
        proximity = Shot(first.item.depth, first.item.color, first.time_s) if self.rig.has_proximity else None
        self._sequence += 1
        return SensorFrame.of_shots(self.rig, self._sequence - 1, proximity, Shot(depth, color, second.time_s))

    def options(self) -> tuple[CameraOption, ...]:
        return tuple(option for feed in self._feeds.values() for option in feed.options())

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        self._feeds[camera].set_option(name, value)

    def health(self) -> Health:
        cameras = tuple(feed.health() for feed in self._feeds.values())
        stale = time.monotonic() - self._last_frame_s > max(feed.silent_s for feed in self._feeds.values())
        ok, said = all(camera.state == "streaming" for camera in cameras), [camera.message for camera in cameras]
        latest_s = [*self._latest_s.values()]
        apart_s = max(latest_s, default=0.0) - min(latest_s, default=0.0)
        if ok and stale and apart_s > _PATIENCE_S / 2:  # else frames are late, or nobody reads them
            ok = False
            said.append(
                f"Both cameras send images, but their time stamps are {apart_s:.3g} s apart, so none belong together: "
                "set the clocks of the computers or drivers that stamp them."
            )
        return Health(
            ok=ok,
            message=" ".join(filter(None, said)),
            dropped=self._lost + sum(feed.dropped for feed in self._feeds.values()),
            stale=stale,
            cameras=cameras,
            unmatched=self._pairer.unmatched,
        )

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._close_feeds()

    def _add(self, role: CameraRole, images: Images, arrival_s: float) -> None:
        with self._changed:
            if not self.rig.has_proximity:
                alone = Timed(images.time_s, arrival_s, images)
                self._ready.append((alone, alone))
            else:
                time_s = images.time_s - (self._delay_s if role == "tactile" else 0.0)
                self._latest_s[role] = time_s
                self._pairer.add(Timed(time_s, arrival_s, images), second=role == "tactile")
            self._ready += self._pairer.take(arrival_s)
            while len(self._ready) > _MAX_WAITING:
                self._ready.popleft()
                self._lost += 1
            self._changed.notify_all()

    def _close_feeds(self) -> None:
        for feed in self._feeds.values():
            feed.close()
