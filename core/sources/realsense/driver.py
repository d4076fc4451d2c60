"""The camera driver, loaded when it is first needed, and what is wrong with it in words."""

from __future__ import annotations

import importlib
import re
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from ...errors import MissingExtraError, SourceError

#: The last release that knows the L515; the next one dropped it.
LAST_WITH_L515 = "2.54.2"

#: System libraries that the driver's wheel needs and the Debian packages that have them.
_PACKAGES = {"libusb-1.0": "libusb-1.0-0", "libudev": "libudev1"}


def load_driver() -> Any:
    """Import pyrealsense2 and return it.

    Raises
    ------
    MissingExtraError
        It is not installed.
    SourceError
        It is installed but cannot be loaded; the message names the system library that is missing.
    """
    try:
        return importlib.import_module("pyrealsense2")
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            "live cameras need the camera driver pyrealsense2, which is not installed: pip install 'tactune[realsense]'"
        ) from error
    except ImportError as error:
        raise SourceError(_cannot_load(str(error))) from error


def driver_version() -> str:
    """Return the driver's version, such as ``"2.54.2.5684"``, or an empty text where it is not installed."""
    try:
        return version("pyrealsense2")
    except PackageNotFoundError:
        return ""


def knows_l515(driver: str) -> bool:
    """Tell whether a driver of this version has support for the L515."""
    return _numbers(driver)[:3] <= _numbers(LAST_WITH_L515)


def no_l515_sentence(driver: str) -> str:
    """Say why a driver of this version finds no L515 and what to install; empty where it would find one."""
    if knows_l515(driver):
        return ""
    return (
        f"the camera driver {driver} no longer supports the L515: with Python 3.11, "
        f"pip install 'pyrealsense2=={LAST_WITH_L515}.5684'"
    )


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(number) for number in re.findall(r"\d+", text))


def _cannot_load(message: str) -> str:
    for library, package in _PACKAGES.items():
        if library in message:
            return f"the camera driver pyrealsense2 needs the system library {library}: sudo apt-get install {package}"
    return (
        f"the camera driver pyrealsense2 cannot be loaded ({message}): "
        "reinstall it with pip install --force-reinstall 'tactune[realsense]'"
    )
