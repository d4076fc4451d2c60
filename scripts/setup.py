"""Set up a clone of Tactune: system libraries, .venv and the locked packages.

Only the standard library is used, because nothing is installed yet. A second run finds the stamp of the first
one and returns at once, without the network.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
VENV_PYTHON = VENV / "bin" / "python"
LOCK = ROOT / "requirements.lock"
LOCKED_PYTHONS = ((3, 11), (3, 12), (3, 13))
LOCKED_MACHINE = ("Linux", "x86_64")
TYPED_FOLDERS = ("core", "widgets", "app", "presets")


class SetupError(Exception):
    """The set-up failed; the message is one sentence with cause and remedy."""


def main() -> int:
    with Path(__file__).open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            set_up()
        except SetupError as error:
            print(f"Set-up stopped: {error}", file=sys.stderr)
            return 1
    return 0


def set_up() -> None:
    link_for_type_checkers()
    packages_stamp, project_stamp = Stamp("packages", LOCK), Stamp("project", ROOT / "pyproject.toml")
    missing = missing_system_packages()
    if missing and packages_stamp.holds():
        if available := [alternatives for alternatives in missing if is_known(known_to_apt(alternatives))]:
            print(f"System packages still missing: {install_hint(available)}", file=sys.stderr)
    elif missing:
        install_system_packages(missing)
    another_python = bool(os.environ.get("PYTHON")) and is_from_another_python()
    if packages_stamp.holds() and project_stamp.holds() and not another_python:
        return
    if not packages_stamp.holds() or another_python:
        make_venv(recreate=packages_stamp.is_from_another_folder() or another_python)
        install_packages()
        packages_stamp.set()
    editable = ["--quiet", "--no-deps", "--no-build-isolation", "--editable", str(ROOT)]
    pip("install", *editable, what="Tactune itself")
    project_stamp.set()
    print("Compiling the contact tests for this computer (once) ...", flush=True)
    succeeds(VENV / "bin" / "tactune", "warmup")  # what fails here is told by the first start


class Stamp:
    """A file in the virtual environment that records from which source file it was made."""

    def __init__(self, name: str, source: Path) -> None:
        self._path = VENV / f"tactune-{name}.stamp"
        self._text = f"{ROOT} {hashlib.sha256(source.read_bytes()).hexdigest()}\n"

    def holds(self) -> bool:
        return VENV_PYTHON.exists() and self._path.exists() and self._path.read_text() == self._text

    def is_from_another_folder(self) -> bool:
        """The environment's scripts contain the path of the folder that it was made in."""
        return self._path.exists() and not self._path.read_text().startswith(f"{ROOT} ")

    def set(self) -> None:
        self._path.write_text(self._text)


def succeeds(*command: str | Path, silent: bool = False, env: dict[str, str] | None = None) -> bool:
    """Run a command and return whether it exits with 0; ``silent`` hides its errors, too."""
    errors = subprocess.DEVNULL if silent else None
    return subprocess.run(command, check=False, env=env, stdout=subprocess.DEVNULL, stderr=errors).returncode == 0


def output_of(*command: str | Path) -> str:
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def link_for_type_checkers() -> None:
    """Make .typing/tactune/<folder>, the layout that type checkers can follow."""
    typing = ROOT / ".typing" / "tactune"
    typing.mkdir(parents=True, exist_ok=True)
    for folder in TYPED_FOLDERS:
        link = typing / folder
        if not link.is_symlink():
            link.symlink_to(Path("..", "..", folder))


def missing_system_packages() -> list[tuple[str, ...]]:
    """Return the possible package names of each missing system library or command."""
    ldconfig = shutil.which("ldconfig", path=f"{os.environ.get('PATH', '')}:/sbin:/usr/sbin")
    known = output_of(ldconfig, "-p") if ldconfig else ""
    libraries = {line.split()[0] for line in known.splitlines() if line.startswith("\t")}
    missing = []
    for line in (ROOT / "scripts" / "system-libraries.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            name, *packages = line.split()
            found = name in libraries if ".so" in name else shutil.which(name)
            if not found:
                missing.append(tuple(packages))
    return missing


def install_system_packages(missing: list[tuple[str, ...]]) -> None:
    """Install packages with apt; without apt, print what is missing and continue."""
    if not shutil.which("apt-get"):
        print(
            f"apt-get is missing; install what corresponds to these Debian packages: "
            f"{' '.join(map(known_to_apt, missing))}"
        )
        return
    prefix = [] if os.geteuid() == 0 else sudo()
    if prefix is None:
        print(f"System packages are missing, and neither root nor sudo is available: {install_hint(missing)}")
        return
    print("Installing system packages (once) ...", flush=True)
    apt_get = [*prefix, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-qq", "-o", "Dpkg::Use-Pty=0"]
    succeeds(*apt_get, "update")
    names = [name for name in map(known_to_apt, missing) if is_known(name)]
    if not succeeds(*apt_get, "install", "--yes", "--no-install-recommends", *names):
        print(f"apt-get failed (its message is above); continuing without: {install_hint(missing)}", file=sys.stderr)


def sudo() -> list[str] | None:
    """Return the prefix of a command that needs root; None if sudo is missing."""
    if not shutil.which("sudo"):
        return None
    return ["sudo"] if sys.stdin.isatty() else ["sudo", "--non-interactive"]


def is_known(package: str) -> bool:
    """Return whether this release of Debian or Ubuntu has a package; True where that cannot be asked."""
    return not shutil.which("apt-cache") or succeeds("apt-cache", "show", package, silent=True)


def known_to_apt(alternatives: tuple[str, ...]) -> str:
    """Return the first of several package names that this release has, or the last one."""
    if not shutil.which("apt-cache"):
        return alternatives[-1]
    return next(filter(is_known, alternatives), alternatives[-1])


def install_hint(missing: list[tuple[str, ...]]) -> str:
    return "sudo apt-get install " + " ".join(map(known_to_apt, missing))


def is_from_another_python() -> bool:
    """Return whether the environment's Python is of another version than this one, such as 3.11 and not 3.12."""
    version = tuple(sys.version_info[:2])
    program = f"import sys; sys.exit(tuple(sys.version_info[:2]) != {version})"
    return VENV_PYTHON.exists() and not succeeds(VENV_PYTHON, "-c", program, silent=True)


def make_venv(recreate: bool) -> None:
    """Make .venv. A working one is kept unless ``recreate`` is set."""
    if not recreate and VENV_PYTHON.exists() and succeeds(VENV_PYTHON, "-c", ""):
        return
    print(f"Making .venv with Python {platform.python_version()} ...", flush=True)
    # Debian's python3.11 comes without ensurepip; its own pip can then install into the environment from outside.
    has_ensurepip = succeeds(sys.executable, "-c", "import ensurepip", silent=True)
    options = ["--clear"] if has_ensurepip else ["--clear", "--without-pip"]
    if not succeeds(sys.executable, "-m", "venv", *options, VENV):
        raise SetupError(f"{sys.executable} cannot make a virtual environment: sudo apt-get install python3.11-venv")


def install_packages() -> None:
    """Install the locked packages; the version ranges of pyproject.toml if the lock does not apply."""
    found = output_of(VENV_PYTHON, "-c", "import sys; print(*sys.version_info[:2])")
    python = tuple(int(part) for part in found.split())
    machine = (platform.system(), platform.machine())
    if python in LOCKED_PYTHONS and machine == LOCKED_MACHINE:
        size = "about 1 GB to download, 3 minutes at 50 Mbit/s, then 3 minutes to unpack and compile"
        print(f"Installing the locked packages into .venv (once; {size}) ...", flush=True)
        locked = ["--require-hashes", "--no-deps", "--only-binary", ":all:", "--requirement", str(LOCK)]
        pip("install", *locked, what="the locked packages")
    else:
        print(
            f"The lock is for Python 3.11 to 3.13 on Linux x86-64; on Python {'.'.join(map(str, python))}, "
            f"{platform.system()} {platform.machine()} the newest versions that pyproject.toml allows are installed "
            "instead ...",
            flush=True,
        )
        extras = "gui,realsense,dev" if machine == LOCKED_MACHINE else "gui,dev"
        pip("install", "--editable", f"{ROOT}[{extras}]", "setuptools>=77", what="the packages of pyproject.toml")


def pip(*arguments: str, what: str) -> None:
    """Run pip for .venv: its own pip, or else that of the Python that runs this script."""
    own = succeeds(VENV_PYTHON, "-m", "pip", "--version", silent=True)
    words = [str(VENV_PYTHON), "-m", "pip"] if own else [sys.executable, "-m", "pip", "--python", str(VENV_PYTHON)]
    quiet = [] if sys.stdout.isatty() else ["--quiet"]
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PIP_TARGET")}
    environment |= {
        "PYTHONWARNINGS": "ignore",
        "PIP_USER": "0",
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        "PIP_ROOT_USER_ACTION": "ignore",
    }
    if subprocess.run([*words, *arguments, *quiet], check=False, env=environment).returncode != 0:
        raise SetupError(f"pip could not install {what} (its message is above); check the network and run make again")


if __name__ == "__main__":
    sys.exit(main())
