"""The interface of camera drivers: a `CameraDriver` lists and opens devices, a `Camera` delivers images.

Threads, pairing, reopening and all messages are shared by all makers: see `pairing` and `camera_thread`. A
package adds a driver by an entry point in the group ``tactune.cameras`` that names a subclass of `CameraDriver`;
``docs/guide/extending.md`` has an example.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from ...errors import SourceError
from ...model.arrays import Uint8Array, Uint16Array
from ...model.clouds import deproject, valid_depth
from ...model.frames import ColorCamera, DepthCamera, Matrix4, Rig, rigid_transform
from ...model.intrinsics import Distortion, Intrinsics
from ..base import CameraOption, CameraRole

_NO_DISTORTION = {"distortion": Distortion.NONE}
_SAME_FRAME = rigid_transform(np.eye(4))


@dataclass(frozen=True, eq=False)
class Images:
    """What one camera saw at one moment, copied out of the driver.

    Attributes
    ----------
    number : int
        The camera's number of the depth image. Gaps count as dropped images.
    depth : uint16, shape (H, W)
        Raw counts.
    color : uint8, shape (H, W, 3), or None
        RGB; None if the camera has no colour or lost the image. The proximity camera's images are skipped then.
    time_s : float
        When the depth image was taken, by the computer's clock, as `time.time`. A driver that cannot tell gives the
        time of arrival.
    """

    number: int
    depth: Uint16Array
    color: Uint8Array | None
    time_s: float


@dataclass(frozen=True)
class Calibration:
    """Factory calibration of one camera.

    Attributes
    ----------
    depth : DepthCamera
        Lens of the depth image and the length of one count.
    color : Intrinsics or None
        Lens of the colour image; None if the camera has no colour.
    T_color_depth : 4 x 4
        Transforms points from the depth frame to the colour frame, metres.
    """

    depth: DepthCamera
    color: Intrinsics | None = None
    T_color_depth: Matrix4 = _SAME_FRAME

    @property
    def color_is_aligned(self) -> bool:
        """Whether colour and depth pixels are the same rays."""
        if self.color is None:
            return True
        lenses = (self.depth.intrinsics, self.color)
        depth, color = (lens if lens.has_distortion else lens.model_copy(update=_NO_DISTORTION) for lens in lenses)
        return depth == color and np.allclose(self.T_color_depth, np.eye(4), atol=1e-9)

    @property
    def color_camera(self) -> ColorCamera | None:
        """The colour camera as a rig states it; None where colour is aligned to depth."""
        if self.color is None or self.color_is_aligned:
            return None
        return ColorCamera(intrinsics=self.color, T_color_depth=self.T_color_depth)

    def color_on_depth(self, color: Uint8Array, depth: Uint16Array) -> Uint8Array:
        """Align a colour image to the depth image; pixels without depth or colour become black."""
        if self.color_is_aligned:
            return color
        pixels = np.flatnonzero(valid_depth(depth))
        rig = Rig(proximity=self.depth, tactile=self.depth, proximity_color=self.color_camera)
        aligned = np.zeros((*depth.shape, 3), np.uint8)
        points = deproject(depth, self.depth, pixels)
        from ...contact.pixels import colors_at  # not above: it loads the compiler, recordings do without

        aligned.reshape(-1, 3)[pixels], _ = colors_at(points, pixels, color, rig)
        return aligned


@dataclass(frozen=True)
class DeviceInfo:
    """A connected device.

    Attributes
    ----------
    model : str
        Such as ``"L515"``, without the maker's name.
    serial : str
        Unique among all connected devices.
    role : {"proximity", "tactile"} or None
        Default role if the preset names no serial number. None: used only if its serial number is named.
    usb : str
        USB version of the connection, such as ``"3.2"``; empty if unknown.
    problem : str
        Why it cannot be used; empty if it can.
    """

    model: str
    serial: str
    role: CameraRole | None = None
    firmware: str = ""
    usb: str = ""
    problem: str = ""

    @property
    def title(self) -> str:
        """Model and serial number."""
        return f"{self.model} (serial {self.serial})"


class Camera(ABC):
    """One opened camera.

    One thread calls `start`, then `read` again and again, then `close`. `options` and `set_option` may be called
    from other threads meanwhile, one at a time.

    Parameters
    ----------
    info : DeviceInfo
    role : {"proximity", "tactile"}
    calibration : Calibration
    rate_hz : float
        Rate of the images; both cameras of a rig need the same.
    """

    def __init__(self, info: DeviceInfo, role: CameraRole, calibration: Calibration, rate_hz: float = 30.0) -> None:
        self.info = info
        self.role: CameraRole = role
        self.calibration = calibration
        self.rate_hz = rate_hz

    def start(self) -> None:
        """Start streaming; the preset's options are already set, in the order in which `options` lists them.

        Raises
        ------
        SourceError
            The camera cannot stream, or is in use.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> Images | None:
        """Return the next images; None if none arrive in time.

        An exception closes the camera; it is then opened again.
        """

    def close(self) -> None:
        """Stop streaming and release the device. Closing twice is harmless."""

    def options(self) -> tuple[CameraOption, ...]:
        """Return the settings that can be changed, with their present values."""
        return ()

    def set_option(self, name: str, value: float) -> None:
        """Change one setting.

        Raises
        ------
        SourceError
            The camera has no such option or refuses the value.
        """
        raise SourceError(f"the {self.info.title} has no option {name!r}; it has none")


class CameraDriver(ABC):
    """The cameras of one maker.

    An instance lives as long as the source that uses it and is made without arguments. Its methods may be called
    from the threads of both cameras.
    """

    #: The maker or product line, for messages: "RealSense".
    title: str

    @abstractmethod
    def devices(self) -> list[DeviceInfo]:
        """Return the connected devices, without starting any.

        Raises
        ------
        MissingExtraError, SourceError
            The maker's software is missing or fails; the message says what to do.
        """

    @abstractmethod
    def open(self, serial: str, role: CameraRole) -> Camera:
        """Open the device with this serial number, not streaming yet; tried twice a second while it is missing.

        Raises
        ------
        SourceError
            It is not connected, or cannot be opened.
        """

    def hint(self) -> str:
        """Return a clause that says why a connected camera may not be listed; empty if there is no reason."""
        return ""
