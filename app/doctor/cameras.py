"""Checks of the camera drivers, permissions and USB."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from .checks import Check, RunChild, State, python_child, run_child

RULES_FOLDERS = ("/etc/udev/rules.d", "/run/udev/rules.d", "/usr/lib/udev/rules.d", "/lib/udev/rules.d")
_USB = Path("/sys/bus/usb/devices")
_NODES = Path("/dev/bus/usb")
_INTEL = "8086"
_USB3_MBIT = 5000
_RULES_URL = "https://github.com/IntelRealSense/librealsense/blob/master/config/99-realsense-libusb.rules"
_INSTALL_RULES = (
    f"Save {_RULES_URL} (the raw file) in /etc/udev/rules.d, run "
    "'sudo udevadm control --reload-rules && sudo udevadm trigger', and plug the cameras in again."
)
_DRIVER = """
import json
from tactune.core.errors import TactuneError
from tactune.core.sources.cameras.realsense import driver_version, load_driver, no_l515_sentence
try:
    load_driver()
    print(json.dumps({"version": driver_version(), "no_l515": no_l515_sentence(driver_version())}))
except TactuneError as error:
    print(json.dumps({"problem": str(error), "installed": bool(driver_version())}))
"""
_ALL_DRIVERS = """
import json
from tactune.core.sources.cameras.drivers import camera_drivers
drivers, problems = camera_drivers()
print(json.dumps({"drivers": [driver.title for driver in drivers], "problems": problems}))
"""


@dataclass(frozen=True)
class UsbCamera:
    """A RealSense camera as listed by the operating system; ``node`` is the file that the driver opens."""

    product: str
    speed_mbit: float
    node: Path


def check_driver(run: RunChild = run_child) -> list[Check]:
    """Import the camera driver with its system libraries, and check its support for the L515."""
    name = "Camera driver"
    child = run(python_child(_DRIVER))
    if child.problem:
        remedy = "Reinstall it: pip install --force-reinstall 'tactune[realsense]'"
        return [Check(name, State.FAIL, f"importing pyrealsense2: {child.problem}", remedy)]
    answer = child.answer()
    if "problem" in answer:
        words, _, remedy = str(answer["problem"]).rpartition(": ")
        state = State.FAIL if answer.get("installed") else State.WARN
        return [Check(name, state, words, f"{remedy[:1].upper()}{remedy[1:]}")]
    found = f"pyrealsense2 {answer.get('version')}"
    if answer.get("no_l515"):
        sentence = str(answer["no_l515"])
        return [Check(name, State.WARN, found, f"{sentence[0].upper()}{sentence[1:]}.")]
    return [Check(name, State.OK, f"{found}, with support for L515 and D405")]


def check_all_drivers(run: RunChild = run_child) -> list[Check]:
    """Load the camera drivers of all installed packages; a broken one is a line."""
    name = "Camera packages"
    child = run(python_child(_ALL_DRIVERS))
    if child.problem:
        remedy = "Uninstall the packages with camera drivers one by one to find the one that causes this."
        return [Check(name, State.FAIL, f"loading the camera drivers: {child.problem}", remedy)]
    answer = child.answer()
    lines = []
    for problem in answer.get("problems", []):
        words, _, remedy = problem.rpartition("; ")
        lines.append(Check(name, State.FAIL, words, f"{remedy[:1].upper()}{remedy[1:]}."))
    return lines or [Check(name, State.OK, ", ".join(answer.get("drivers", [])) or "no driver")]


def check_udev_rules(folders: Iterable[str | Path] = RULES_FOLDERS) -> list[Check]:
    """Check for the udev rule that lets all users open the cameras."""
    found = [file for folder in folders for file in sorted(Path(folder).glob("*realsense*.rules"))]
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
    remedy = "Plug the cameras in with the cables that came with them; 'lsusb -d 8086:' shows them."
    if not nodes.is_dir():
        remedy = "This system shows no USB devices; in a container, start it with --device /dev/bus/usb."
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
