"""Two live RealSense cameras as one source of frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...frames import Rig, SensorFrame
from ...preset import CamerasSection
from ..base import CameraOption, CameraRole, FrameSource, Health, Progress

_ANY_CAMERAS = CamerasSection()


class RealSenseSource(FrameSource):
    """An L515 and a D405 (or another D400 camera), paired by time.

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

    name = "realsense:"

    def __init__(
        self,
        cameras: CamerasSection = _ANY_CAMERAS,
        devices: Callable[[], list[Any]] | None = None,
        progress: Progress | None = None,
    ) -> None:
        raise NotImplementedError

    @property
    def rig(self) -> Rig:
        """The rig that the cameras state, without a pose between them."""
        raise NotImplementedError

    def wait(self, timeout_s: float) -> bool:
        """Wait for a pair of images, at most ``timeout_s``."""
        raise NotImplementedError

    def next_frame(self) -> SensorFrame | None:
        """Return the next pair, waiting for it as long as it takes; None once the source is closed."""
        raise NotImplementedError

    def options(self) -> tuple[CameraOption, ...]:
        """Return the settings of both cameras, as they report them now."""
        raise NotImplementedError

    def set_option(self, camera: CameraRole, name: str, value: float) -> None:
        """Change one setting of a camera."""
        raise NotImplementedError

    def health(self) -> Health:
        """Say which camera streams, has stalled or is missing, and what was lost."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop both cameras."""
        raise NotImplementedError
