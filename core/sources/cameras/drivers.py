"""The installed camera drivers, and which connected device gets which role."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from ...errors import PluginError, SourceError, TactuneError
from ...model.plugins import added_by_others
from ...preset import CamerasSection
from ..base import CameraRole
from .camera import CameraDriver, DeviceInfo, StreamLens
from .realsense import RealSenseDriver

#: Entry points of other packages: classes of camera drivers.
GROUP: Final = "tactune.cameras"


def camera_drivers(name: str = "") -> tuple[list[CameraDriver], list[str]]:
    """Return all installed drivers, or one by its name, and a sentence for each that cannot be loaded.

    Raises
    ------
    PluginError
        The named driver cannot be loaded.
    """
    found, failed = added_by_others(GROUP, CameraDriver)
    known = {**found, "realsense": RealSenseDriver}
    if name and name not in known:
        raise PluginError(failed.get(name, f"there is no camera driver {name!r}; known are {', '.join(known)}"))
    drivers, problems = [], [] if name else list(failed.values())
    for each in [name] if name else sorted(known):
        try:
            drivers.append(known[each]())
        except Exception as error:  # another package's driver may raise anything
            problems.append(f"the camera driver {each!r} failed ({error}); update or uninstall its package")
    if name and problems:
        raise PluginError(problems[0])
    return drivers, problems


def connected_devices(drivers: Sequence[CameraDriver]) -> tuple[list[tuple[CameraDriver, DeviceInfo]], list[str]]:
    """Return the devices of all drivers, and a sentence for each driver that fails.

    Raises
    ------
    TactuneError
        No device is found and a driver fails.
    """
    found: list[tuple[CameraDriver, DeviceInfo]] = []
    failures: list[TactuneError] = []
    for driver in drivers:
        try:
            found += [(driver, info) for info in driver.devices()]
        except TactuneError as error:
            failures.append(error)
        except Exception as error:  # another package's driver may raise anything
            failures.append(SourceError(f"the camera driver of {driver.title} failed ({error}); update its package"))
    if failures and not found:
        raise failures[0]
    return found, [str(error) for error in failures]


def list_devices() -> tuple[list[DeviceInfo], str, list[str]]:
    """Return all connected devices, proximity cameras first; why others may be missing; what is wrong with drivers.

    Raises
    ------
    TactuneError
        No device is found and a driver is missing or fails.
    """
    drivers, problems = camera_drivers()
    try:
        found, failures = connected_devices(drivers)
    except TactuneError as error:
        raise SourceError("; ".join([str(error), *problems])) from error
    devices = sorted((info for _, info in found), key=lambda info: (info.role != "proximity", info.model, info.serial))
    return devices, "; ".join(filter(None, (driver.hint() for driver in drivers))), [*failures, *problems]


def list_lenses() -> dict[str, list[StreamLens]]:
    """Return the lenses of all connected devices by serial number; a driver that fails gives none."""
    lenses: dict[str, list[StreamLens]] = {}
    for driver, info in connected_devices(camera_drivers()[0])[0]:
        with suppress(Exception):  # another package's driver may raise anything
            lenses[info.serial] = driver.lenses(info.serial)
    return lenses


def choose(
    devices: Sequence[DeviceInfo], cameras: CamerasSection, source: str, *, what: str = "camera", hint: str = ""
) -> dict[CameraRole, DeviceInfo]:
    """Decide which device gets which role: by serial number where the preset names one, else by `DeviceInfo.role`.

    Messages begin with ``source``, such as ``"realsense:"``, call a camera ``what`` if none is connected, and give
    ``hint`` as the reason why the driver may not list one. `SourceError` if a camera is missing, or several would fit.
    """
    if not devices:
        note = f"; note that {hint}" if hint else ""
        raise SourceError(
            f"{source} finds no {what} connected: plug both into USB 3 ports; tactune doctor finds other causes{note}"
        )
    serials: dict[CameraRole, str] = {"proximity": cameras.proximity.serial, "tactile": cameras.tactile.serial}
    if serials["proximity"] and serials["proximity"] == serials["tactile"]:
        raise SourceError(f"{source} both cameras have the serial {serials['tactile']}; name two different ones")
    form = f"{source.partition(':')[0]}:PROXIMITY,TACTILE"
    connected = f"{_titles(devices)} {'is' if len(devices) == 1 else 'are'}"
    chosen: dict[CameraRole, DeviceInfo] = {}
    for role, serial in serials.items():
        if serial:
            fitting = [device for device in devices if device.serial == serial]
            if not fitting:
                raise SourceError(
                    f"{source} the {role} camera with the serial {serial} is not connected, but {connected}; "
                    f"plug it in, or name another one in the camera dialog or as {form}"
                )
        else:
            free = [device for device in devices if device.role == role and device.serial not in serials.values()]
            fitting = [device for device in free if not device.is_second_choice] or free
        if not fitting:
            model = "an L515" if role == "proximity" else "a D405"
            remedy = hint or f"plug {model} into a USB 3 port, or name a camera in its place as {form}"
            raise SourceError(f"{source} there is no {role} camera, only {connected} connected; {remedy}")
        if len(fitting) > 1:
            raise SourceError(
                f"{source} {_titles(fitting)} may each be the {role} camera; "
                f"choose in the camera dialog, or name both serials as {form}"
            )
        chosen[role] = fitting[0]
    return chosen


def _titles(devices: Sequence[DeviceInfo]) -> str:
    return " and ".join(device.title for device in devices)
