"""What is plugged in, asked of the driver without starting anything, and which device is which camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ...errors import SourceError
from ...preset import CamerasSection
from ..base import CameraRole
from .driver import driver_version, load_driver, no_l515_sentence

#: Returns the driver's objects of the devices that are plugged in.
DeviceQuery = Callable[[], list[Any]]

_TACTILE_MODEL, _TACTILE_FAMILY = "D405", "D4"
_MISSING_REMEDY = "plug it in, or name another one in the camera dialog or as realsense:PROXIMITY,TACTILE"


@dataclass(frozen=True, order=True)
class StreamMode:
    """One way in which a sensor can stream; ``stream`` and ``format`` are the driver's own words."""

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
        Such as ``"L515"``, the maker's name left out.
    usb : str
        USB version that the connection runs at, such as ``"3.2"``; empty where unknown.
    modes : tuple of StreamMode
        What it can stream, in order.
    problem : str
        Why it cannot be used as it is; empty where it can.
    """

    model: str
    serial: str
    firmware: str = ""
    usb: str = ""
    modes: tuple[StreamMode, ...] = ()
    problem: str = ""

    @property
    def is_proximity_model(self) -> bool:
        """Whether it is a camera that looks through the membrane."""
        return self.model.startswith("L5")

    @property
    def title(self) -> str:
        """Model and serial number."""
        return f"{self.model} (serial {self.serial})"


def list_devices(driver: Any | None = None) -> list[DeviceInfo]:
    """Return the connected devices, those that look through the membrane first.

    Parameters
    ----------
    driver : module, optional
        pyrealsense2; loaded where not given.

    Raises
    ------
    MissingExtraError
        The driver is not installed.
    SourceError
        The driver cannot be loaded or fails.
    """
    driver = driver or load_driver()
    devices = [describe(device) for device in hardware(driver)()]
    return sorted(devices, key=lambda device: (not device.is_proximity_model, device.model, device.serial))


def hardware(driver: Any) -> DeviceQuery:
    """Return what asks the driver for the devices on this machine's USB."""
    context = driver.context()

    def query() -> list[Any]:
        try:
            return list(context.query_devices())
        except RuntimeError as error:
            raise SourceError(f"the camera driver cannot list its devices ({error}); plug them in again") from error

    return query


def describe(device: Any) -> DeviceInfo:
    """Ask a device of the driver what it is."""
    driver = load_driver()

    def told(name: str) -> str:
        info = getattr(driver.camera_info, name)
        return str(device.get_info(info)) if device.supports(info) else ""

    try:
        name = told("name")
        modes = {mode for sensor in device.query_sensors() for mode in map(_mode, sensor.get_stream_profiles()) if mode}
        usb = told("usb_type_descriptor")
        return DeviceInfo(
            model=name.removeprefix("Intel RealSense ").removeprefix("RealSense ").strip() or "unknown",
            serial=told("serial_number"),
            firmware=told("firmware_version"),
            usb=usb,
            modes=tuple(sorted(modes)),
            problem="it runs at USB 2, too slow for these cameras; use a USB 3 port and cable"
            if usb.startswith("2")
            else "",
        )
    except RuntimeError as error:
        return DeviceInfo(model="unknown", serial="", problem=f"it does not answer ({error}); plug it in again")


def _mode(profile: Any) -> StreamMode | None:
    if not profile.is_video_stream_profile():
        return None
    video = profile.as_video_stream_profile()
    stream = profile.stream_type().name
    return StreamMode(stream, video.width(), video.height(), profile.fps(), profile.format().name)


def choose(devices: Sequence[DeviceInfo], cameras: CamerasSection, source: str) -> dict[CameraRole, DeviceInfo]:
    """Decide which device is which camera: by serial number where the preset names one, else by model.

    Raises
    ------
    SourceError
        A camera is missing or the choice is open; the message, which begins with ``source``, says what to do.
    """
    l515_hint = no_l515_sentence(driver_version())
    if not devices:
        hint = f"; note that {l515_hint}" if l515_hint else ""
        raise SourceError(
            f"{source} finds no RealSense camera connected: plug both into USB 3 ports; "
            f"tactune doctor says what else may be wrong{hint}"
        )
    named = {cameras.proximity.serial, cameras.tactile.serial} - {""}
    if cameras.proximity.serial and cameras.proximity.serial == cameras.tactile.serial:
        raise SourceError(f"{source} both cameras have the serial {cameras.proximity.serial}; name two different ones")
    free = [device for device in devices if device.serial not in named]
    proximity = _find(
        devices, cameras.proximity.serial, [device for device in free if device.is_proximity_model], "proximity", source
    )
    candidates = [device for device in free if device.model.startswith(_TACTILE_FAMILY)]
    best = [device for device in candidates if device.model == _TACTILE_MODEL]
    tactile = _find(devices, cameras.tactile.serial, best or candidates, "tactile", source)
    if proximity is None:
        raise SourceError(_lacks("proximity", "an L515", devices, source, l515_hint))
    if tactile is None:
        raise SourceError(_lacks("tactile", "a D405", devices, source))
    return {"proximity": proximity, "tactile": tactile}


def _find(
    devices: Sequence[DeviceInfo], serial: str, fitting: Sequence[DeviceInfo], role: str, source: str
) -> DeviceInfo | None:
    if serial:
        for device in devices:
            if device.serial == serial:
                return device
        raise SourceError(
            f"{source} the {role} camera with the serial {serial} is not connected, "
            f"but {_titles(devices)} {_is_or_are(devices)}; {_MISSING_REMEDY}"
        )
    if len(fitting) > 1:
        raise SourceError(
            f"{source} {_titles(fitting)} may each be the {role} camera; "
            "choose in the camera dialog, or name both serials as realsense:PROXIMITY,TACTILE"
        )
    return fitting[0] if fitting else None


def _lacks(role: str, model: str, devices: Sequence[DeviceInfo], source: str, reason: str = "") -> str:
    only = f"only {_titles(devices)} {_is_or_are(devices)} connected"
    remedy = reason or f"plug {model} into a USB 3 port, or name a camera in its place as realsense:PROXIMITY,TACTILE"
    return f"{source} there is no {role} camera, {only}; {remedy}"


def _titles(devices: Sequence[DeviceInfo]) -> str:
    return " and ".join(device.title for device in devices)


def _is_or_are(devices: Sequence[DeviceInfo]) -> str:
    return "is" if len(devices) == 1 else "are"
