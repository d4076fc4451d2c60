"""Checks of Python, packages, folders and memory, and of what the window needs: Qt, display."""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path

import platformdirs

from .checks import Check, RunChild, State, python_child, run_child

_MIN_FREE_BYTES, _ENOUGH_FREE_BYTES = 200e6, 2e9
_FRAMES_BYTES = 37_000_000

#: Distribution names whose import name differs.
_IMPORT_NAMES = {"opencv-contrib-python-headless": "cv2"}


def check_python(found: tuple[int, ...] = tuple(sys.version_info[:3])) -> list[Check]:
    """Check that Python is not too new for the L515's driver."""
    text = ".".join(map(str, found))
    if found[:2] > (3, 11):
        remedy = "Drivers for this Python have no L515; for an L515, install Tactune in Python 3.11."
        return [Check("Python", State.WARN, text, remedy)]
    return [Check("Python", State.OK, text)]


def check_packages(run: RunChild = run_child) -> list[Check]:
    """Import every package that the headless core needs."""
    names = [re.split(r"[^A-Za-z0-9_.-]", line)[0] for line in requires("tactune") or [] if "extra ==" not in line]
    child = run(python_child("import " + ", ".join(_IMPORT_NAMES.get(name, name) for name in names)))
    if child.problem:
        remedy = "Reinstall them: pip install --force-reinstall tactune"
        return [Check("Packages", State.FAIL, f"importing them: {child.problem}", remedy)]
    shown = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "numba"))
    return [Check("Packages", State.OK, f"all {len(names)} can be imported: {shown}, …")]


def check_cache_folder(folder: Path | None = None) -> list[Check]:
    """Check that the cache folder is writable and has space."""
    name = "Cache folder"
    folder = folder or Path(platformdirs.user_cache_dir("tactune"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        free = shutil.disk_usage(folder).free
    except OSError as error:
        remedy = f"Make {folder} writable, or set XDG_CACHE_HOME; otherwise every start computes its scenes again."
        return [Check(name, State.FAIL, f"{folder}: {error.strerror or error}", remedy)]
    words = f"{folder}, {free / 1e9:.1f} GB free"
    if free < _ENOUGH_FREE_BYTES:
        state = State.FAIL if free < _MIN_FREE_BYTES else State.WARN
        return [Check(name, state, words, "Free some space: a minute of recording takes up to 1 GB.")]
    return [Check(name, State.OK, words)]


def check_shared_memory(folder: Path = Path("/dev/shm")) -> list[Check]:  # noqa: S108  # where Linux has it
    """Check the space in the shared memory that passes frames from the capture process to the window."""
    if not folder.is_dir():
        return []
    free = shutil.disk_usage(folder).free
    if free < _FRAMES_BYTES:
        remedy = "Close other programs; in a container, give it more with --shm-size."
        return [Check("Shared memory", State.FAIL, f"{free / 1e6:.0f} MB free, too few for frames", remedy)]
    return [Check("Shared memory", State.OK, f"{free / 1e6:.0f} MB free, {os.cpu_count()} processor cores")]


_HEADLESS = "tactune run works without it."


def check_window(environment: Mapping[str, str] = os.environ) -> list[Check]:
    """Check that the packages of the window are installed, and that there is a display."""
    try:
        versions = [f"{name} {version(name)}" for name in ("PyQt6", "pyqtgraph")]
    except PackageNotFoundError as error:
        remedy = f"For the window: pip install 'tactune[gui]'; {_HEADLESS}"
        return [Check("Window", State.WARN, f"not installed: {error.name}", remedy)]
    lines = [Check("Window", State.OK, ", ".join(versions))]
    named = [f"{name}={environment[name]}" for name in ("DISPLAY", "WAYLAND_DISPLAY") if environment.get(name)]
    if named or not sys.platform.startswith("linux"):
        return [*lines, Check("Display", State.OK, ", ".join(named) or sys.platform)]
    remedy = f"The window needs a display: log in at the machine, or use ssh -X; {_HEADLESS}"
    return [*lines, Check("Display", State.WARN, "DISPLAY and WAYLAND_DISPLAY are empty", remedy)]


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
