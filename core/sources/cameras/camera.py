"""The interface of camera drivers: a `CameraDriver` lists and opens devices, a `Camera` delivers images.

Threads, pairing, time stamps, reopening and all messages are shared by all makers: see
`camera_thread`, `pairing` and `source`. A package adds a driver by an entry point in the group ``tactune.cameras``
that names a subclass of `CameraDriver`; ``docs/guide/extending.md`` has an example.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...contact.masking import colors_at
from ...errors import SourceError, as_sentence
from ...model.arrays import AnyArray, Uint8Array, Uint16Array
from ...model.clouds import deproject, valid_depth
from ...model.frames import ColorCamera, DepthCamera, Matrix4, Rig, rigid_transform
from ...model.intrinsics import Distortion, Intrinsics
from ..base import CameraOption, CameraRole

Kind = Literal["depth", "color"]

_NO_DISTORTION = {"distortion": Distortion.NONE}
_SAME_FRAME = rigid_transform(np.eye(4))


@dataclass(frozen=True, eq=False)
class Image:
    """One image, copied out of the driver.

    Attributes
    ----------
    number : int
        The camera's number of the image. Gaps count as dropped images.
    pixels : uint16, shape (H, W), or uint8, shape (H, W, 3)
        Raw counts or RGB.
    stamp_s : float
        The camera's time stamp, seconds.
    on_host_clock : bool
        Whether the stamp is on the computer's clock, as `time.time`. Otherwise it is on the camera's own clock,
        and images are placed by their arrival.
    """

    kind: Kind
    number: int
    pixels: AnyArray
    stamp_s: float
    on_host_clock: bool = True


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
        aligned.reshape(-1, 3)[pixels], _ = colors_at(points, pixels, color, rig)
        return aligned


@dataclass(frozen=True, order=True)
class StreamMode:
    """One mode in which a sensor can stream; ``stream`` and ``format`` are the driver's own words."""

    stream: str
    width: int
    height: int
    rate_hz: int
    format: str

    def __str__(self) -> str:
        return f"{self.stream} {self.width} x {self.height} at {self.rate_hz} Hz ({self.format})"


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
    is_second_choice : bool
        Gets its default role only if no other device has this default role.
    usb : str
        USB version of the connection, such as ``"3.2"``; empty if unknown.
    modes : tuple of StreamMode
        Available modes, sorted.
    problem : str
        Why it cannot be used; empty if it can.
    """

    model: str
    serial: str
    role: CameraRole | None = None
    is_second_choice: bool = False
    firmware: str = ""
    usb: str = ""
    modes: tuple[StreamMode, ...] = ()
    problem: str = ""

    @property
    def title(self) -> str:
        """Model and serial number."""
        return f"{self.model} (serial {self.serial})"


@dataclass(frozen=True)
class StreamLens:
    """The factory calibration of one image size.

    Attributes
    ----------
    kind : {"depth", "color"}
    intrinsics : Intrinsics
    depth_unit_m : float
        Length of one count of the camera's depth images.
    """

    kind: Kind
    intrinsics: Intrinsics
    depth_unit_m: float


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
        Rate of the depth images; both cameras of a rig need the same.
    """

    def __init__(self, info: DeviceInfo, role: CameraRole, calibration: Calibration, rate_hz: float = 30.0) -> None:
        self.info = info
        self.role: CameraRole = role
        self.calibration = calibration
        self.rate_hz = rate_hz

    @property
    def defaults(self) -> Mapping[str, float]:
        """Options that are set unless the preset names them."""
        return {}

    def start(self) -> None:
        """Start streaming. Options are already set.

        Raises
        ------
        SourceError
            The camera cannot stream, or is in use.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> Sequence[Image]:
        """Return the next images, depth and colour in any order; empty if none arrives in time.

        An exception closes the camera; it is then opened again.
        """

    def flush(self) -> None:
        """Drop the images that have already arrived."""

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

    def apply_options(self, wanted: Mapping[str, float]) -> list[str]:
        """Set options, and return a sentence for each one that the camera refuses."""
        return self._apply(wanted.items())

    def reset_by(self, name: str) -> Collection[str]:
        """Return the options that change too when ``name`` is set, such as those of a visual preset."""
        return ()

    def _apply(self, options: Iterable[tuple[str, float]]) -> list[str]:
        refused = []
        for name, value in options:
            try:
                self.set_option(name, value)
            except SourceError as error:
                refused.append(as_sentence(str(error)))
        return refused


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

    def serials(self) -> list[str]:
        """Return the serial numbers of the connected devices; asked twice a second while a camera is silent."""
        return [info.serial for info in self.devices()]

    def lenses(self, serial: str) -> list[StreamLens]:
        """Return the lens of every image size of a device, without streaming; empty if the driver does not tell."""
        return []

    @abstractmethod
    def open(self, serial: str, role: CameraRole) -> Camera:
        """Open the device with this serial number, not streaming yet.

        Raises
        ------
        SourceError
            It is not connected, or cannot be opened.
        """

    def hint(self) -> str:
        """Return a clause that says why a connected camera may not be listed; empty if there is no reason."""
        return ""
