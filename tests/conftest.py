"""Settings and fixtures for every test: a home folder per process, patient waiting, recordings of real cameras."""

import atexit
import fcntl
import os
import shutil
import signal
import tempfile
from pathlib import Path

import platformdirs
import pytest
from hypothesis import settings
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from coarse_scenes import solve_coarsely
from commands import Finished

ROOT = Path(__file__).resolve().parent.parent
SHARED_DATA = Path(os.environ.get("TACTUNE_TEST_DATA", ROOT.parent / "shared" / "data"))
NO_SHARED_DATA = "no ../shared/data (set TACTUNE_TEST_DATA)"

# Settings, recovered presets and documents belong to one test process. Caches (kernels, scenes) are shared.
os.environ["XDG_CACHE_HOME"] = platformdirs.user_cache_dir()
_home = tempfile.mkdtemp(prefix="tactune-tests-")
atexit.register(shutil.rmtree, _home, ignore_errors=True)
os.environ["HOME"] = _home
for name in ("CONFIG", "DATA", "STATE"):
    os.environ[f"XDG_{name}_HOME"] = f"{_home}/{name.lower()}"

# A bare pytest works on a machine without a display.
if not any(os.environ.get(name) for name in ("QT_QPA_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY")):
    os.environ["QT_QPA_PLATFORM"] = "offscreen"

solve_coarsely()

# A busy machine is no failure.
settings.register_profile("tactune", deadline=None)
settings.load_profile("tactune")

# A shell makes what it runs in the background ignore interrupts, and so would every program that a test starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# So does nohup with hang-ups, which the programs then rightly ignore.
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def _compile_locked(compile_kernel):
    """Let one process at a time compile a kernel; the others wait and find the machine code on the disk."""

    def locked(self, signature):
        if not hasattr(self._cache, "_cache_file"):
            return compile_kernel(self, signature)
        path = Path(self._cache._cache_file._index_path).with_suffix(".lock")
        path.parent.mkdir(parents=True, exist_ok=True)
        with global_compiler_lock, path.open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return compile_kernel(self, signature)

    return locked


Dispatcher.compile = _compile_locked(Dispatcher.compile)


@pytest.fixture(scope="session")
def shared_data():
    """Return the folder of recordings of real cameras; skip the test where there is none."""
    if not SHARED_DATA.is_dir():
        pytest.skip(NO_SHARED_DATA)
    return SHARED_DATA


@pytest.fixture
def tactune(capsys, monkeypatch):
    """Run a command in this process, through the entry point of the installed one."""
    from tactune.app.cli.main import main

    def run(*words):
        monkeypatch.setattr("sys.argv", ["tactune", *map(str, words)])
        capsys.readouterr()
        return Finished(main(), *capsys.readouterr())

    return run


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter):
    skipped = terminalreporter.stats.get("skipped", [])
    count = sum(NO_SHARED_DATA in str(report.longrepr) for report in skipped)
    if count:
        words = f"{count} tests of real recordings were SKIPPED: {NO_SHARED_DATA}"
        terminalreporter.write_line(words, red=True, bold=True)


@pytest.fixture
def qtbot(qapp, request):
    """Give pytest-qt's robot at least a minute of patience: a busy machine does everything, but later."""
    from pytestqt.qtbot import QtBot

    bot = QtBot(request)
    for name in ("waitUntil", "waitSignal", "waitSignals", "waitExposed", "waitActive"):
        setattr(bot, name, _patient(getattr(bot, name)))
    return bot


def _patient(wait):
    def wait_longer(*what, timeout=5000, **options):
        if options.get("raising") is False:  # such as assertNotEmitted, which waits for nothing to happen
            return wait(*what, timeout=timeout, **options)
        return wait(*what, timeout=max(timeout, 60_000), **options)

    return wait_longer
