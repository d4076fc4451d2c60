"""Intel's camera driver pyrealsense2: loads it, explains failures, and lists devices."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from ...errors import MissingExtraError, SourceError
from ..base import CameraRole
from .camera import Camera, CameraDriver, DeviceInfo

#: Returns the driver's objects of the connected devices.
DeviceQuery = Callable[[], Iterable[Any]]

#: The last release that knows the L515; the next one dropped it.
_LAST_WITH_L515 = 2, 54, 2

#: An L515 looks through the membrane, a D405 sees the membrane; others are used where their serial number is named.
_ROLES: dict[str, CameraRole] = {"L515": "proximity", "D405": "tactile"}


class RealSenseDriver(CameraDriver):
    """The RealSense cameras; ``query`` returns the driver's objects of the connected devices."""

    title = "RealSense"

    def __init__(self, query: DeviceQuery | None = None) -> None:
        self._find = query

    def devices(self) -> list[DeviceInfo]:
        return [describe(device) for device in self._query()]

    def open(self, serial: str, role: CameraRole) -> Camera:
        from .realsense_camera import RealSenseCamera

        for device in self._query():
            if _serial(device) == serial:
                return RealSenseCamera(load_driver(), device, describe(device), role)
        raise SourceError(f"the RealSense camera with the serial {serial} is not connected; plug it in")

    def hint(self) -> str:
        """Return why this version of the driver finds no L515."""
        return no_l515_sentence(driver_version())

    def _query(self) -> list[Any]:
        if self._find is None:
            self._find = load_driver().context().query_devices
        try:
            return list(self._find())
        except RuntimeError as error:
            raise SourceError(f"the camera driver cannot list its devices ({error}); plug them in again") from error


def load_driver() -> Any:
    """Import pyrealsense2; `MissingExtraError` if it is not installed, `SourceError` if it cannot be loaded."""
    try:
        return importlib.import_module("pyrealsense2")
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            "live cameras need the camera driver pyrealsense2, which is not installed: pip install 'tactune[realsense]'"
        ) from error
    except ImportError as error:
        raise SourceError(
            f"the camera driver pyrealsense2 cannot be loaded ({error}): install the system library that is missing, "
            "or reinstall it with pip install --force-reinstall 'tactune[realsense]'"
        ) from error


def driver_version() -> str:
    """Return the driver's version, such as ``"2.54.2.5684"``, or an empty string if it is not installed."""
    try:
        return version("pyrealsense2")
    except PackageNotFoundError:
        return ""


def no_l515_sentence(driver: str) -> str:
    """Return why a driver of this version finds no L515, and what to install; empty if it supports the L515."""
    if tuple(map(int, re.findall(r"\d+", driver)))[:3] <= _LAST_WITH_L515:
        return ""
    return (
        f"the camera driver {driver} no longer supports the L515: with Python 3.11, "
        f"pip install 'pyrealsense2==2.54.2.5684'"
    )


def describe(device: Any) -> DeviceInfo:
    """Return the information about one of the driver's devices."""
    driver = load_driver()

    def told(name: str) -> str:
        info = getattr(driver.camera_info, name)
        return str(device.get_info(info)) if device.supports(info) else ""

    try:
        model = told("name").removeprefix("Intel RealSense ").removeprefix("RealSense ").strip() or "unknown"
        usb = told("usb_type_descriptor")
        return DeviceInfo(
            model=model,
            serial=told("serial_number"),
            role=_ROLES.get(model),
            firmware=told("firmware_version"),
            usb=usb,
            problem="it runs at USB 2, too slow for these cameras; use a USB 3 port and cable"
            if usb.startswith("2")
            else "",
        )
    except RuntimeError as error:
        return DeviceInfo(model="unknown", serial="", problem=f"it does not answer ({error}); plug it in again")


def _serial(device: Any) -> str:
    with suppress(RuntimeError):  # unplugged at this moment
        return str(device.get_info(load_driver().camera_info.serial_number))
    return ""
