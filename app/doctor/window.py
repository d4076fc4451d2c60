"""Checks of what only the window needs: Qt, its system libraries, a display and OpenGL."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from .checks import Check, RunChild, State, python_child, run_child

_GUI_DISTRIBUTIONS = ("PyQt6", "pyqtgraph")
_HEADLESS = "tactune run works without it."

#: Where Debian and Ubuntu have the libraries that Qt needs; the others follow from their names.
_PACKAGES = {
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libxkbcommon-x11.so.0": "libxkbcommon-x11-0",
    "libdbus-1.so.3": "libdbus-1-3",
    "libfontconfig.so.1": "libfontconfig1",
    "libfreetype.so.6": "libfreetype6",
    "libglib-2.0.so.0": "libglib2.0-0",
    "libX11-xcb.so.1": "libx11-xcb1",
    "libwayland-client.so.0": "libwayland-client0",
    "libxcb-cursor.so.0": "libxcb-cursor0",
    "libxcb-icccm.so.4": "libxcb-icccm4",
    "libxcb-image.so.0": "libxcb-image0",
    "libxcb-keysyms.so.1": "libxcb-keysyms1",
    "libxcb-randr.so.0": "libxcb-randr0",
    "libxcb-render-util.so.0": "libxcb-render-util0",
    "libxcb-shape.so.0": "libxcb-shape0",
    "libxcb-xinerama.so.0": "libxcb-xinerama0",
    "libxcb-xkb.so.1": "libxcb-xkb1",
}

_OPENGL = """
import json, sys
from PyQt6.QtGui import QGuiApplication, QOffscreenSurface, QOpenGLContext
application = QGuiApplication(["tactune-doctor"])
surface, context = QOffscreenSurface(), QOpenGLContext()
surface.create()
if not context.create() or not context.makeCurrent(surface):
    print(json.dumps({"problem": "this display gives no OpenGL context"}))
    sys.exit(0)
from tactune.widgets.gl_functions import RENDERER, VERSION, GLError, GLFunctions
try:
    gl = GLFunctions(context)
    print(json.dumps({"renderer": gl.glGetString(RENDERER).decode(errors="replace"),
                      "version": gl.glGetString(VERSION).decode(errors="replace")}))
except GLError as error:
    print(json.dumps({"problem": str(error)}))
"""


def check_qt() -> list[Check]:
    """See whether the packages of the window are installed."""
    versions, missing = [], []
    for name in _GUI_DISTRIBUTIONS:
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    if missing:
        remedy = f"For the window: pip install 'tactune[gui]'; {_HEADLESS}"
        return [Check("Window", State.WARN, f"not installed: {', '.join(missing)}", remedy)]
    return [Check("Window", State.OK, ", ".join(versions))]


def check_qt_libraries(run: RunChild = run_child, files: tuple[Path, ...] | None = None) -> list[Check]:
    """Look for every system library that Qt and its window plugin are linked to."""
    name = "Qt libraries"
    files = _qt_files() if files is None else files
    if not files:
        return []
    if shutil.which("ldd") is None:
        return [Check(name, State.WARN, "cannot be checked: there is no ldd on this system")]
    missing: list[str] = []
    for file in files:
        child = run(["ldd", str(file)])
        if child.problem:
            return [Check(name, State.WARN, f"cannot be checked: {child.problem}")]
        lines = [line.split() for line in child.out.splitlines() if "not found" in line]
        missing += [words[0] for words in lines if words[0] not in missing]
    if missing:
        packages = [_PACKAGES.get(library, library) for library in missing]
        remedy = f"Install what is missing: sudo apt-get install {' '.join(packages)}"
        return [Check(name, State.FAIL, f"missing: {', '.join(missing)}", remedy)]
    return [Check(name, State.OK, "all are there")]


def check_opengl(run: RunChild = run_child, environment: Mapping[str, str] = os.environ) -> list[Check]:
    """Make an OpenGL context on this display, as the 3D views do."""
    name = "OpenGL"
    if find_spec("PyQt6") is None:
        return []
    if not any(environment.get(variable) for variable in ("DISPLAY", "WAYLAND_DISPLAY")):
        remedy = f"The window needs a display: log in at the machine, or use ssh -X; {_HEADLESS}"
        return [Check(name, State.WARN, "there is no display (DISPLAY and WAYLAND_DISPLAY are empty)", remedy)]
    child = run(python_child(_OPENGL))
    painter = "The 3D views are painted in software meanwhile; install the graphics driver for more speed."
    if child.problem:
        remedy = f"Check that the display answers and the Qt libraries are there. {_HEADLESS.capitalize()}"
        return [Check(name, State.FAIL, f"making a context: {child.problem}", remedy)]
    answer = child.answer()
    if "renderer" not in answer:
        return [Check(name, State.WARN, str(answer.get("problem", "no answer")), painter)]
    found = f"{answer['version']}, {answer['renderer']}"
    if "llvmpipe" in found.lower() or "softpipe" in found.lower():
        return [Check(name, State.WARN, f"{found}: no graphics processor", painter)]
    return [Check(name, State.OK, found)]


def _qt_files() -> tuple[Path, ...]:
    """Return Qt's own libraries that are linked to the operating system's, without loading any of them."""
    spec = find_spec("PyQt6")
    if spec is None or not spec.submodule_search_locations:
        return ()
    home = Path(next(iter(spec.submodule_search_locations)))
    files = [*home.glob("QtGui*.so"), *(home / "Qt6" / "plugins" / "platforms").glob("libqxcb.so")]
    return tuple(sorted(files))
