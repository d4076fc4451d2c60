"""The installed camera drivers, and which connected device gets which role."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from ...errors import SourceError, TactuneError
from ...model.plugins import added_by_others
from ...preset import CamerasSection
from ..base import CameraRole
from .camera import CameraDriver, DeviceInfo
from .orbbec import OrbbecDriver
from .realsense import RealSenseDriver

#: Entry points of other packages: classes of camera drivers.
GROUP: Final = "tactune.cameras"
#: Names of live sources, and all their messages, begin with it.
SCHEME: Final = "cameras"


def camera_drivers() -> tuple[list[CameraDriver], list[str]]:
    """Return all installed drivers, and a sentence for each that cannot be loaded."""
    found, failed = added_by_others(GROUP, CameraDriver)
    known = {**found, "orbbec": OrbbecDriver, "realsense": RealSenseDriver}
    drivers, problems = [], list(failed.values())
    for name in sorted(known):
        try:
            drivers.append(known[name]())
        except Exception as error:  # another package's driver may raise anything
            problems.append(f"the camera driver {name!r} failed ({error}); update or uninstall its package")
    return drivers, problems


def connected_devices(drivers: Sequence[CameraDriver]) -> tuple[list[tuple[CameraDriver, DeviceInfo]], list[str]]:
    """Return the devices of all drivers, and a sentence for each that fails; raise the first if there is no device."""
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
    """Return all devices, proximity cameras first; why others may be missing; what is wrong with drivers."""
    drivers, problems = camera_drivers()
    try:
        found, failures = connected_devices(drivers)
    except TactuneError as error:
        raise SourceError("; ".join([str(error), *problems])) from error
    devices = sorted((info for _, info in found), key=lambda info: (info.role != "proximity", info.model, info.serial))
    return devices, "; ".join(filter(None, (driver.hint() for driver in drivers))), [*failures, *problems]


def choose(
    devices: Sequence[DeviceInfo],
    cameras: CamerasSection,
    hint: str = "",
    roles: Sequence[CameraRole] = ("proximity", "tactile"),
) -> dict[CameraRole, DeviceInfo]:
    """Give each role a device, by the preset's serial numbers or by `DeviceInfo.role`, if that is clear."""
    if not devices:
        note = f"; note that {hint}" if hint else ""
        raise SourceError(f"{SCHEME}: finds no camera; plug both into USB 3 ports, or see tactune doctor{note}")
    serials: dict[CameraRole, str] = {"proximity": cameras.proximity.serial, "tactile": cameras.tactile.serial}
    form = f"name both serials as {SCHEME}:PROXIMITY,TACTILE or choose in the camera dialog"
    chosen: dict[CameraRole, DeviceInfo] = {}
    for role in roles:
        if serial := serials[role]:
            fitting = [device for device in devices if device.serial == serial]
        else:
            fitting = [device for device in devices if device.role == role and device.serial not in serials.values()]
        if not fitting:
            what = f"the {role} camera with the serial {serial}" if serial else f"a {role} camera"
            model = "an L515" if role == "proximity" else "a D405"
            remedy = hint or f"plug {'it' if serial else model} in, or {form}"
            raise SourceError(f"{SCHEME}: {what} is not connected, only {_titles(devices)}; {remedy}")
        if len(fitting) > 1:
            raise SourceError(f"{SCHEME}: {_titles(fitting)} may each be the {role} camera; {form}")
        chosen[role] = fitting[0]
    if len(roles) == 2 and chosen["proximity"] is chosen["tactile"]:
        raise SourceError(f"{SCHEME}: both cameras have the serial {serials['tactile']}; name two different ones")
    return chosen


def _titles(devices: Sequence[DeviceInfo]) -> str:
    return " and ".join(device.title for device in devices)
