"""Checks of the camera drivers, permissions and USB."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from .checks import Check, RunChild, State, python_child, run_child

_RULES_FOLDERS = ("/etc/udev/rules.d", "/run/udev/rules.d", "/usr/lib/udev/rules.d", "/lib/udev/rules.d")
_USB = Path("/sys/bus/usb/devices")
_NODES = Path("/dev/bus/usb")
_INTEL = "8086"
_USB3_MBIT = 5000
_RULES_URL = "https://github.com/IntelRealSense/librealsense/blob/master/config/99-realsense-libusb.rules"
_INSTALL_RULES = (
    f"Save {_RULES_URL} (the raw file) in /etc/udev/rules.d, run "
    "'sudo udevadm control --reload-rules && sudo udevadm trigger', and plug the cameras in again."
)
_DRIVERS = """
import json
from tactune.core.errors import TactuneError
from tactune.core.sources.cameras.drivers import camera_drivers
from tactune.core.sources.cameras.realsense import driver_version, load_driver, no_l515_sentence
answer = {"version": driver_version(), "no_l515": no_l515_sentence(driver_version()), "others": camera_drivers()[1]}
try:
    load_driver()
except TactuneError as error:
    answer["problem"] = str(error)
print(json.dumps(answer))
"""


@dataclass(frozen=True)
class UsbCamera:
    """A RealSense camera as listed by the operating system; ``node`` is the file that the driver opens."""

    product: str
    speed_mbit: float
    node: Path


def check_drivers(run: RunChild = run_child) -> list[Check]:
    """Import the RealSense driver with its system libraries, and those of other packages; a broken one is a line."""
    name = "Camera driver"
    child = run(python_child(_DRIVERS))
    if child.problem:
        remedy = "Reinstall it: pip install --force-reinstall 'tactune[realsense]'; uninstall other camera packages."
        return [Check(name, State.FAIL, f"importing pyrealsense2: {child.problem}", remedy)]
    answer = child.answer()
    version, problem, no_l515 = (str(answer.get(key, "")) for key in ("version", "problem", "no_l515"))
    if problem:
        words, _, remedy = problem.rpartition(": ")
        line = Check(name, State.FAIL if version else State.WARN, words, _capital(remedy))
    elif no_l515:
        line = Check(name, State.WARN, f"pyrealsense2 {version}", f"{_capital(no_l515)}.")
    else:
        line = Check(name, State.OK, f"pyrealsense2 {version}, with support for L515 and D405")
    others = [other.rpartition("; ") for other in answer.get("others", [])]
    return [line, *(Check(name, State.FAIL, words, f"{_capital(remedy)}.") for words, _, remedy in others)]


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]


def check_udev_rules() -> list[Check]:
    """Check for the udev rule that lets all users open the cameras."""
    found = [file for folder in _RULES_FOLDERS for file in sorted(Path(folder).glob("*realsense*.rules"))]
    if found:
        return [Check("udev rules", State.OK, str(found[0]))]
    return [Check("udev rules", State.WARN, "no rule for RealSense cameras; only root can use them", _INSTALL_RULES)]


def check_cameras(usb: Path = _USB, nodes: Path = _NODES) -> list[Check]:
    """List the connected cameras, and check their permissions and USB speed."""
    lines = []
    for camera in usb_cameras(usb, nodes):
        if not os.access(camera.node, os.R_OK | os.W_OK):
            found = f"{camera.product}: no permission to open {camera.node}"
            lines.append(Check("Cameras", State.FAIL, found, _INSTALL_RULES))
        elif camera.speed_mbit < _USB3_MBIT:
            found = f"{camera.product} on USB 2 ({camera.speed_mbit:.0f} Mbit/s)"
            remedy = "Use a USB 3 port and a USB 3 cable; turn the plug over, push it in firmly, avoid hubs."
            lines.append(Check("Cameras", State.FAIL, found, remedy))
        else:
            lines.append(Check("Cameras", State.OK, f"{camera.product} on USB 3 ({camera.speed_mbit:.0f} Mbit/s)"))
    if lines:
        return lines
    remedy = "Plug the cameras in with the cables that came with them; in a container, share /dev/bus/usb."
    return [Check("Cameras", State.WARN, "no RealSense camera is plugged in", remedy)]


def usb_cameras(usb: Path = _USB, nodes: Path = _NODES) -> list[UsbCamera]:
    """Return the connected RealSense cameras."""

    def read(file: Path) -> str:
        try:
            return file.read_text(errors="replace").strip()
        except OSError:
            return ""

    cameras = []
    for device in sorted(usb.glob("*")):
        product = read(device / "product")
        if read(device / "idVendor") != _INTEL or "realsense" not in product.lower():
            continue
        try:
            node = nodes / f"{int(read(device / 'busnum')):03d}" / f"{int(read(device / 'devnum')):03d}"
            cameras.append(UsbCamera(product, float(read(device / "speed")), node))
        except ValueError:  # unplugged meanwhile
            continue
    return cameras
