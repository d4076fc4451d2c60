"""Two live cameras, of one maker or two, as one source of frames."""

from __future__ import annotations

import atexit
import time
from collections.abc import Sequence
from typing import Final

import numpy as np

from ...errors import SourceError
from ...model.frames import Rig, SensorFrame
from ...preset import CamerasSection
from ..base import CameraOption, CameraRole, FrameSource, Health, Progress
from .camera import CameraDriver, Image
from .camera_thread import CameraThread
from .drivers import camera_drivers, choose, connected_devices
from .pairing import Assembler

_ANY_CAMERAS: Final = CamerasSection()
#: A driver call that takes longer than this counts as hung.
HUNG_S: Final = 8.0


def open_cameras(driver: str, cameras: CamerasSection, progress: Progress) -> FrameSource:
    """Open the cameras of one driver, or of all installed ones where ``driver`` is empty; picklable."""
    drivers, problems = camera_drivers(driver)
    return CameraSource(drivers, cameras, progress, scheme=driver or "cameras", problems=problems)


class CameraSource(FrameSource):
    """A proximity and a tactile camera, paired by time.

    Frames are numbered from 0 and carry the cameras' time stamps on the computer's clock; the tactile camera's
    are reduced by ``cameras.tactile_delay_s``. While a camera stalls or is missing there are no frames and `health`
    says why; frames continue by themselves when it is back. The two cameras may have different drivers. Messages begin
    with ``scheme``; ``problems`` are sentences about drivers that cannot be used.
    """

    def __init__(
        self,
        drivers: Sequence[CameraDriver],
        cameras: CamerasSection = _ANY_CAMERAS,
        progress: Progress | None = None,
        *,
        scheme: str = "cameras",
        problems: Sequence[str] = (),
    ) -> None:
        serials = (cameras.proximity.serial, cameras.tactile.serial)
        self.name = f"{scheme}:{','.join(serials)}" if all(serials) else f"{scheme}:"
        self._feeds: dict[CameraRole, CameraThread] = {}
        self._sequence = 0
        tell = progress or (lambda share, words: None)
        tell(0.0, "looking for cameras")
        connected, failures = connected_devices(drivers)
        hint = "; ".join(filter(None, [*(driver.hint() for driver in drivers), *failures, *problems]))
        what = f"{drivers[0].title} camera" if len(drivers) == 1 else "camera"
        chosen = choose([info for _, info in connected], cameras, self.name, what=what, hint=hint)
        try:
            for share, (role, info) in zip((0.2, 0.6), chosen.items(), strict=True):
                tell(share, f"opening the {info.title}")
                driver = next(driver for driver, known in connected if known is info)
                self._feeds[role] = CameraThread(
                    role, driver, info, getattr(cameras, role).options, self._add_image, self._forget_images
                )
            self._check_rates()
        except SourceError as error:
            self._close_feeds()
            raise SourceError(f"{self.name} {error}") from error
        except BaseException:
            self._close_feeds()
            raise
        without_color = [role for role, feed in self._feeds.items() if feed.calibration.color is None]
        self._assembler = Assembler(1.0 / self._feeds["proximity"].rate_hz, cameras.tactile_delay_s, without_color)
        proximity, tactile = self._feeds["proximity"].calibration, self._feeds["tactile"].calibration
        self._rig = Rig(proximity=proximity.depth, tactile=tactile.depth, proximity_color=proximity.color_camera)
        self._last_frame_s = time.monotonic()
        atexit.register(self.close)  # ending Python while a thread is inside a driver would abort the process
        for feed in self._feeds.values():
            feed.start()

    @property
    def rig(self) -> Rig:
        """The rig as the cameras report it, without the pose between them: that comes from a calibration."""
        return self._rig

    @property
    def frame_rate_hz(self) -> float:
        """The rate at which both cameras take images."""
        return self._feeds["proximity"].rate_hz

    def wait(self, timeout_s: float) -> bool:
        """Wait for a pair of images, at most ``timeout_s``; `SourceError` if a driver hangs."""
        for feed in self._feeds.values():
            if not self._assembler.closed and time.monotonic() - feed.alive_s > HUNG_S:
                raise SourceError(f"{self.name} the driver does not come back from the {feed.info.title}")
        return self._assembler.wait(timeout_s)

    def next_frame(self) -> SensorFrame | None:
        """Wait for the next pair of images and return it; None once the source is closed."""
        while (pair := self._assembler.take()) is None:
            if self._assembler.closed:
                return None
            self.wait(1.0)
        self._last_frame_s = time.monotonic()
        tactile, color = pair.tactile, pair.tactile.color
        if color is not None:
            color = self._feeds["tactile"].calibration.color_on_depth(color, tactile.depth)
        proximity_color = pair.proximity.color
        if proximity_color is None:
            proximity_color = np.zeros((*self._rig.proximity_color_shape, 3), np.uint8)
        frame = SensorFrame(
            sequence=self._sequence,
            proximity_depth=pair.proximity.depth,
            tactile_depth=tactile.depth,
            proximity_color=proximity_color,
            tactile_color=color,
            proximity_time_s=pair.proximity_time_s,
            tactile_time_s=pair.tactile_time_s,
        )
        self._sequence += 1
        return frame

    def options(self) -> tuple[CameraOption, ...]:
        """Return the settings of both cameras, as they report them now."""
        return tuple(option for feed in self._feeds.values() for option in feed.options())

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        """Change one setting of a camera; it is set again whenever the camera is reopened."""
        if camera not in self._feeds:
            raise SourceError(f"{self.name}: there is no {camera} camera")
        self._feeds[camera].set_option(name, value)

    def health(self) -> Health:
        """Return the state of both cameras and how many images were lost."""
        cameras = tuple(feed.health() for feed in self._feeds.values())
        return Health(
            ok=all(camera.state == "streaming" for camera in cameras),
            message=" ".join(camera.message for camera in cameras if camera.message),
            dropped=self._assembler.dropped + sum(feed.dropped for feed in self._feeds.values()),
            stale=time.monotonic() - self._last_frame_s > max(feed.silent_s for feed in self._feeds.values()),
            cameras=cameras,
            unmatched=self._assembler.unmatched,
        )

    def close(self) -> None:
        """Stop both cameras."""
        atexit.unregister(self.close)
        self._assembler.close()
        self._close_feeds()

    def _add_image(self, role: CameraRole, image: Image, arrival_s: float) -> None:
        """Take an image from a camera, on its thread."""
        if self._assembler.add(role, image, arrival_s):
            feed = self._feeds[role]
            feed.tell(f"The {feed.info.title}'s clock is not the computer's; images are timed by their arrival.")

    def _forget_images(self, role: CameraRole) -> None:
        self._assembler.restart(role)

    def _check_rates(self) -> None:
        first, second = self._feeds.values()
        if first.rate_hz != second.rate_hz:
            raise SourceError(
                f"the {first.info.title} takes {first.rate_hz:g} images a second and the {second.info.title} "
                f"{second.rate_hz:g}; set both cameras to the same rate"
            )

    def _close_feeds(self) -> None:
        for feed in self._feeds.values():
            feed.close()
