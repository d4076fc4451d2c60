"""The installed camera drivers, and which connected device gets which role."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from ...errors import PluginError, SourceError, TactuneError
from ...model.plugins import load_plugin_class, load_plugins
from ...preset import CamerasSection
from ..base import CameraRole
from .camera import CameraDriver, DeviceInfo, StreamLens

GROUP = "tactune.cameras"


def camera_drivers(name: str = "") -> tuple[list[CameraDriver], list[str]]:
    """Return all installed drivers, or one by its name, and a sentence for each that cannot be loaded.

    Raises
    ------
    PluginError
        The named driver cannot be loaded.
    """
    if name:
        return [_load(name)], []
    plugins = load_plugins(GROUP, _load)
    return list(plugins.found.values()), list(plugins.problems.values())


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
    """Return all connected devices, why others may be missing, and what is wrong with drivers.

    Returns
    -------
    devices : list of DeviceInfo
        Proximity cameras first.
    hint : str
        What the drivers say about cameras that they cannot find; empty if nothing.
    problems : list of str
        One sentence for each driver that cannot be loaded or fails.

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

    Parameters
    ----------
    devices : sequence of DeviceInfo
        The connected devices.
    cameras : CamerasSection
    source : str
        Name of the source, such as ``"realsense:"``; messages begin with it.
    what : str
        How messages call a camera if none is connected.
    hint : str
        Why the driver may not list a camera; empty if there is no reason.

    Raises
    ------
    SourceError
        A camera is missing, or several would fit; the message says what to do.
    """
    if not devices:
        note = f"; note that {hint}" if hint else ""
        raise SourceError(
            f"{source} finds no {what} connected: plug both into USB 3 ports; tactune doctor finds other causes{note}"
        )
    named = {cameras.proximity.serial, cameras.tactile.serial} - {""}
    if cameras.proximity.serial and cameras.proximity.serial == cameras.tactile.serial:
        raise SourceError(f"{source} both cameras have the serial {cameras.proximity.serial}; name two different ones")
    free = [device for device in devices if device.serial not in named]
    proximity = _find(devices, cameras.proximity.serial, free, "proximity", source)
    tactile = _find(devices, cameras.tactile.serial, free, "tactile", source)
    if proximity is None:
        raise SourceError(_missing("proximity", "an L515", devices, source, hint))
    if tactile is None:
        raise SourceError(_missing("tactile", "a D405", devices, source))
    return {"proximity": proximity, "tactile": tactile}


def _load(name: str) -> CameraDriver:
    kind = load_plugin_class(GROUP, name, CameraDriver)  # type: ignore[type-abstract]
    try:
        return kind()
    except Exception as error:
        raise PluginError(
            f"the entry point {name!r} ({GROUP}) failed ({error}); update or uninstall its package"
        ) from error


def _find(
    devices: Sequence[DeviceInfo], serial: str, free: Sequence[DeviceInfo], role: CameraRole, source: str
) -> DeviceInfo | None:
    if serial:
        for device in devices:
            if device.serial == serial:
                return device
        raise SourceError(
            f"{source} the {role} camera with the serial {serial} is not connected, "
            f"but {_titles(devices)} {_is_or_are(devices)}; plug it in, or name another one in the camera dialog or as "
            f"{_form(source)}"
        )
    fitting = [device for device in free if device.role == role]
    best = [device for device in fitting if not device.is_second_choice] or fitting
    if len(best) > 1:
        raise SourceError(
            f"{source} {_titles(best)} may each be the {role} camera; "
            f"choose in the camera dialog, or name both serials as {_form(source)}"
        )
    return best[0] if best else None


def _missing(role: str, model: str, devices: Sequence[DeviceInfo], source: str, reason: str = "") -> str:
    only = f"only {_titles(devices)} {_is_or_are(devices)} connected"
    remedy = reason or f"plug {model} into a USB 3 port, or name a camera in its place as {_form(source)}"
    return f"{source} there is no {role} camera, {only}; {remedy}"


def _form(source: str) -> str:
    return f"{source.partition(':')[0]}:PROXIMITY,TACTILE"


def _titles(devices: Sequence[DeviceInfo]) -> str:
    return " and ".join(device.title for device in devices)


def _is_or_are(devices: Sequence[DeviceInfo]) -> str:
    return "is" if len(devices) == 1 else "are"
