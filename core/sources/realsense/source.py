"""Two live RealSense cameras as one source of frames."""

from __future__ import annotations

import atexit
import time
from typing import Final

from ...errors import SourceError
from ...model.frames import Rig, SensorFrame
from ...preset import CamerasSection
from ..base import CameraOption, CameraRole, FrameSource, Health, Progress
from .assembler import Assembler
from .calibration import RATE_HZ
from .camera import PERIOD_S, SILENT_S, Camera
from .devices import DeviceQuery, choose, describe, hardware
from .driver import load_driver
from .session import Image

_ANY_CAMERAS: Final = CamerasSection()
#: A driver call that takes longer than this will not come back.
_HUNG_S: Final = 8.0


class RealSenseSource(FrameSource):
    """An L515 and a D405 (or another D400 camera), paired by time.

    Frames are numbered from 0 and carry the cameras' time stamps on the computer's clock, the tactile
    camera's less ``cameras.tactile_delay_s``. While a camera stalls or is missing no frames come; `health`
    says so, and frames go on by themselves when it is back.

    Parameters
    ----------
    cameras : CamerasSection, optional
        Which devices they are, their options and the delay of the tactile one.
    devices : callable, optional
        Returns the devices that are plugged in, as the driver's objects; without it the driver is asked.
    progress : callable, optional
        Told the share done, 0 to 1, and what is being done.

    Raises
    ------
    MissingExtraError
        The driver is not installed.
    SourceError
        The driver cannot be loaded, or the cameras cannot be found or opened; the message says what to do.
    """

    def __init__(
        self,
        cameras: CamerasSection = _ANY_CAMERAS,
        devices: DeviceQuery | None = None,
        progress: Progress | None = None,
    ) -> None:
        serials = (cameras.proximity.serial, cameras.tactile.serial)
        self.name = f"realsense:{','.join(serials)}" if all(serials) else "realsense:"
        self._assembler = Assembler(PERIOD_S, cameras.tactile_delay_s)
        self._cameras: dict[CameraRole, Camera] = {}
        self._sequence = 0
        query = devices or hardware(load_driver())
        tell = progress or (lambda share, words: None)
        tell(0.0, "looking for cameras")
        connected = [(describe(device), device) for device in query()]
        chosen = choose([info for info, _ in connected], cameras, self.name)
        try:
            for share, (role, info) in zip((0.2, 0.6), chosen.items(), strict=True):
                tell(share, f"opening the {info.title}")
                device = next(device for known, device in connected if known is info)
                stored = getattr(cameras, role).options
                self._cameras[role] = Camera(role, device, info, stored, query, self)
        except SourceError as error:
            self.close()
            raise SourceError(f"{self.name} {error}") from error
        except BaseException:
            self.close()
            raise
        proximity, tactile = self._cameras["proximity"].calibration, self._cameras["tactile"].calibration
        self._rig = Rig(proximity=proximity.depth, tactile=tactile.depth, proximity_color=proximity.color_camera)
        self._last_frame_s = time.monotonic()
        atexit.register(self.close)  # Python must not end while a thread is inside the driver: that aborts
        for camera in self._cameras.values():
            camera.start()

    @property
    def rig(self) -> Rig:
        """The rig that the cameras state; how they stand to each other a calibration must bring."""
        return self._rig

    @property
    def frame_rate_hz(self) -> float:
        """The rate at which both cameras take images."""
        return float(RATE_HZ)

    def wait(self, timeout_s: float) -> bool:
        """Wait for a pair of images, at most ``timeout_s``.

        Raises
        ------
        SourceError
            The driver does not come back; only a new process helps.
        """
        self._refuse_hung_driver()
        return self._assembler.wait(timeout_s)

    def next_frame(self) -> SensorFrame | None:
        """Return the next pair, waiting for it as long as it takes; None once the source is closed."""
        while (pair := self._assembler.take()) is None:
            if self._assembler.closed:
                return None
            self.wait(1.0)
        self._last_frame_s = time.monotonic()
        tactile = pair.tactile
        color = tactile.color
        if color is not None:
            color = self._cameras["tactile"].calibration.color_on_depth(color, tactile.depth)
        assert pair.proximity.color is not None  # without one it is no pair
        frame = SensorFrame(
            sequence=self._sequence,
            proximity_depth=pair.proximity.depth,
            tactile_depth=tactile.depth,
            proximity_color=pair.proximity.color,
            tactile_color=color,
            proximity_time_s=pair.proximity_time_s,
            tactile_time_s=pair.tactile_time_s,
        )
        self._sequence += 1
        return frame

    def options(self) -> tuple[CameraOption, ...]:
        """Return the settings of both cameras, as they report them now."""
        return tuple(option for camera in self._cameras.values() for option in camera.options())

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        """Change one setting of a camera, now and whenever it is plugged in again."""
        if camera not in self._cameras:
            raise SourceError(f"{self.name}: there is no {camera} camera")
        self._cameras[camera].set_option(name, value)

    def health(self) -> Health:
        """Say which camera streams, has stalled or is missing, and what was lost."""
        cameras = tuple(camera.health() for camera in self._cameras.values())
        return Health(
            ok=all(camera.state == "streaming" for camera in cameras),
            message=" ".join(camera.message for camera in cameras if camera.message),
            dropped=self._assembler.dropped + sum(camera.dropped for camera in self._cameras.values()),
            stale=time.monotonic() - self._last_frame_s > SILENT_S,
            cameras=cameras,
            unmatched=self._assembler.unmatched,
        )

    def close(self) -> None:
        """Stop both cameras."""
        atexit.unregister(self.close)
        self._assembler.close()
        for camera in self._cameras.values():
            camera.close()

    def take_in(self, role: CameraRole, image: Image, arrival_s: float) -> None:
        """Take an image from a camera, on its thread."""
        camera = self._cameras[role]
        sentence = self._assembler.add(role, image, arrival_s)
        if sentence:
            camera.tell(f"The {camera.info.title}'s {sentence}")

    def opened_anew(self, role: CameraRole) -> None:
        """Note that a camera starts over."""
        self._assembler.restart(role)

    def _refuse_hung_driver(self) -> None:
        for camera in self._cameras.values():
            if not self._assembler.closed and time.monotonic() - camera.alive_s > _HUNG_S:
                raise SourceError(f"{self.name} the driver does not come back from the {camera.info.title}")
