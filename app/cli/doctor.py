"""The commands ``tactune devices``, ``doctor`` and ``warmup``: the cameras, and whether this computer is ready."""

from __future__ import annotations

import os
import platform
import re
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import requires, version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ...core.errors import TactuneError, as_sentence, counted
from ..sources.list_devices import RunChild, ask_driver, python_child, run_child
from .common import CliProgress, say, warn

if TYPE_CHECKING:
    from ...core.sources.ros.topics import ImageTopic

#: Exit status of ``devices`` if no camera is connected.
NONE_STATUS = 1
#: Exit status of ``doctor`` if a check fails.
FAILED_STATUS = 1

_FRAMES_BYTES = 37e6
#: Distribution names whose import name differs.
_IMPORT_NAMES = {"opencv-contrib-python-headless": "cv2", "pillow": "PIL"}

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


def devices() -> None:
    """List the connected cameras.

    Tells model, serial number, firmware and USB version; and live ROS 2 topics of depth. Exit status 0 if a camera is
    connected, 1 if none is, 2 if the camera driver is missing or fails.
    """
    with ThreadPoolExecutor(1) as pool:
        listening = pool.submit(_ros2_topics)
        answer = ask_driver()
        topics = listening.result()
    for topic in topics:
        typer.echo(f"{topic.name}, {topic.width} x {topic.height}, {topic.encoding}: a camera of ros2:")
    for device in answer["devices"]:
        about = [("serial", "serial"), ("firmware", "firmware"), ("USB", "usb")]
        say(", ".join([device["model"], *(f"{word} {device.get(key) or 'unknown'}" for word, key in about)]))
        if device.get("problem"):
            say(f"  {as_sentence(device['problem'])}")
    for note in filter(None, [answer.get("hint"), *answer.get("problems", [])]):
        say(as_sentence(note))
    if not answer["devices"] and not topics:
        say("No camera is connected: plug both into USB 3 ports; tactune doctor finds other causes.")
        raise typer.Exit(NONE_STATUS)


def _ros2_topics() -> list[ImageTopic]:
    """Return the live depth topics; none without the extra ``live``."""
    try:
        from ...core.sources.ros.live import cameras_here

        return cameras_here()
    except TactuneError:
        return []


def doctor() -> None:
    """Check this computer: packages, camera driver, USB, Qt, memory.

    Names a remedy for each problem. Exit status 0 if no check fails (warnings concern only some uses), 1 if one does.
    """
    lines = check_computer()
    say(report(lines))
    if any(line.state is State.FAIL for line in lines):
        raise typer.Exit(FAILED_STATUS)


def warmup() -> None:
    """Compile in advance, so that a robot's first frame is fast."""
    from ...core.warmup import warm_up

    with CliProgress() as progress:
        result = warm_up(progress.preparing)
    say(f"compiled {counted(result.compiled, 'kernel')}, loaded {result.loaded}")
    if not result.folders:
        warn("no cache folder is writable, so every start compiles again; set NUMBA_CACHE_DIR to a writable folder")


# The checks of ``tactune doctor``


class State(StrEnum):
    """Result of a check; ``WARN`` concerns only some uses."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True)
class Check:
    """One line of the report: what was checked, what was found, and what to do if something is wrong."""

    name: str
    state: State
    found: str
    remedy: str = ""

    def text(self) -> str:
        first = f"{self.state:<5}{self.name:<16}{self.found}"
        return f"{first}\n{'':<21}{self.remedy}" if self.remedy else first


def check_computer() -> list[Check]:
    """Run all checks in parallel and return their lines in order. It takes seconds and never raises."""
    with ThreadPoolExecutor(max_workers=4) as pool:
        return [line for lines in pool.map(_guarded, CHECKS) for line in lines]


def _guarded(check: Callable[[], Sequence[Check]]) -> Sequence[Check]:
    try:
        return check()
    except Exception as error:
        name = check.__name__.removeprefix("check_").replace("_", " ")
        problem = f"could not be checked ({type(error).__name__}: {error})"
        return [Check(name, State.WARN, problem, "Please report this with the line above.")]


def report(lines: Sequence[Check]) -> str:
    """Return the lines as text, with their number at the end."""
    failed, warned = (sum(line.state is state for line in lines) for state in (State.FAIL, State.WARN))
    checks = "\n".join(line.text() for line in lines)
    return f"{checks}\n\n{len(lines)} checks: {failed} failed, {warned} with a warning"


# Packages and memory


def check_packages(run: RunChild = run_child) -> list[Check]:
    """Import every package that the headless core needs, in a process of its own."""
    names = [re.split(r"[^A-Za-z0-9_.-]", line)[0] for line in requires("tactune") or [] if "extra ==" not in line]
    child = run(python_child("import " + ", ".join(_IMPORT_NAMES.get(name, name) for name in names)))
    if child.problem:
        remedy = "Reinstall them: pip install --force-reinstall tactune"
        return [Check("Packages", State.FAIL, f"importing them: {child.problem}", remedy)]
    shown = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "numba"))
    found = f"Python {platform.python_version()}; all {len(names)} packages can be imported: {shown}, …"
    return [Check("Packages", State.OK, found)]


def check_shared_memory(folder: Path = Path("/dev/shm")) -> list[Check]:  # noqa: S108  # where Linux has it
    """Check the space in the shared memory that passes frames from the capture process to the window."""
    if not folder.is_dir():
        return []
    free = shutil.disk_usage(folder).free
    if free < _FRAMES_BYTES:
        remedy = "Close other programs; in a container, give it more with --shm-size."
        return [Check("Shared memory", State.FAIL, f"{free / 1e6:.0f} MB free, too few for frames", remedy)]
    return [Check("Shared memory", State.OK, f"{free / 1e6:.0f} MB free, {os.cpu_count()} processor cores")]


# Cameras


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
        line = Check(name, State.FAIL if version else State.WARN, words, as_sentence(remedy))
    elif no_l515:
        line = Check(name, State.WARN, f"pyrealsense2 {version}", as_sentence(no_l515))
    else:
        line = Check(name, State.OK, f"pyrealsense2 {version}, with support for L515 and D405")
    others = [other.rpartition("; ") for other in answer.get("others", [])]
    return [line, *(Check(name, State.FAIL, words, as_sentence(remedy)) for words, _, remedy in others)]


def check_cameras(usb: Path = _USB, nodes: Path = _NODES) -> list[Check]:
    """List the RealSense cameras that the operating system sees, and check their permissions and USB speed."""

    def read(file: Path) -> str:
        try:
            return file.read_text(errors="replace").strip()
        except OSError:
            return ""

    lines = []
    for device in sorted(usb.glob("*")):
        product = read(device / "product")
        if read(device / "idVendor") != _INTEL or "realsense" not in product.lower():
            continue
        try:  # the node is the file that the driver opens
            node = nodes / f"{int(read(device / 'busnum')):03d}" / f"{int(read(device / 'devnum')):03d}"
            mbit_s = float(read(device / "speed"))
        except ValueError:  # unplugged meanwhile
            continue
        if not os.access(node, os.R_OK | os.W_OK):
            found = f"{product}: no permission to open {node}"
            lines.append(Check("Cameras", State.FAIL, found, _INSTALL_RULES))
        elif mbit_s < _USB3_MBIT:
            found = f"{product} on USB 2 ({mbit_s:.0f} Mbit/s)"
            remedy = "Use a USB 3 port and a USB 3 cable; turn the plug over, push it in firmly, avoid hubs."
            lines.append(Check("Cameras", State.FAIL, found, remedy))
        else:
            lines.append(Check("Cameras", State.OK, f"{product} on USB 3 ({mbit_s:.0f} Mbit/s)"))
    remedy = "Plug the cameras in with the cables that came with them; in a container, share /dev/bus/usb."
    return lines or [Check("Cameras", State.WARN, "no RealSense camera is plugged in", remedy)]


# Qt


def check_qt_libraries(run: RunChild = run_child, files: tuple[Path, ...] | None = None) -> list[Check]:
    """Check every system library that Qt and its window plugin are linked to."""
    name = "Qt libraries"
    files = _qt_files() if files is None else files
    if not files or shutil.which("ldd") is None:
        return []
    missing: dict[str, None] = {}
    for file in files:
        child = run(["ldd", str(file)])
        if child.problem:
            return [Check(name, State.WARN, f"cannot be checked: {child.problem}")]
        missing |= {line.split()[0]: None for line in child.out.splitlines() if "not found" in line}
    if missing:
        remedy = "Install the packages of your system that hold these libraries."
        return [Check(name, State.FAIL, f"missing: {', '.join(missing)}", remedy)]
    return [Check(name, State.OK, "all found")]


def _qt_files() -> tuple[Path, ...]:
    """Return Qt's own libraries that are linked to system libraries, without loading them."""
    spec = find_spec("PyQt6")
    if spec is None or not spec.submodule_search_locations:
        return ()
    home = Path(next(iter(spec.submodule_search_locations)))
    files = [*home.glob("QtGui*.so"), *(home / "Qt6" / "plugins" / "platforms").glob("libqxcb.so")]
    return tuple(sorted(files))


#: In the order of their lines.
CHECKS = (check_packages, check_shared_memory, check_drivers, check_cameras, check_qt_libraries)
