"""scripts/setup.py finds and installs missing packages, or names the command, on various systems."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
LIBRARIES = ROOT / "scripts" / "system-libraries.txt"


@pytest.fixture
def setup_script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("setup_script", ROOT / "scripts" / "setup.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Pretend a machine that has just these commands, each a line of shell; return the log they may write to."""

    def make(**commands: str) -> Path:
        folder, log = tmp_path / "bin", tmp_path / "log"
        folder.mkdir()
        for name, line in commands.items():
            file = folder / name.replace("_", "-")
            file.write_text(f"#!/bin/sh\n{line}\n")
            file.chmod(0o755)
        for tool in ("env", "cat"):
            (folder / tool).symlink_to(f"/usr/bin/{tool}")
        monkeypatch.setenv("PATH", str(folder))
        monkeypatch.setenv("LOG", str(log))
        return log

    return make


def known_libraries(without: str) -> str:
    """Return a stand-in for ldconfig that knows every library but one."""
    names = [line.split()[0] for line in LIBRARIES.read_text().splitlines() if ".so" in line.partition(" ")[0]]
    listing = "".join(f"\\t{name} (libc6,x86-64) => /lib/{name}\\n" for name in names if name != without)
    return f"printf '{listing}'"


def test_every_line_of_the_list_names_a_thing_and_its_packages() -> None:
    lines = [line.split() for line in LIBRARIES.read_text().splitlines() if line and not line.startswith("#")]
    assert len(lines) > 20
    assert all(len(words) >= 2 for words in lines)
    assert len({words[0] for words in lines}) == len(lines)


def test_what_is_missing_is_found(setup_script: ModuleType, machine: Callable[..., Path]) -> None:
    machine(ldconfig=known_libraries(without="libusb-1.0.so.0"), Xvfb="", xauth="", **{"g++": ""})
    assert setup_script.missing_system_packages() == [("libusb-1.0-0",)]


def test_a_missing_command_is_found(setup_script: ModuleType, machine: Callable[..., Path]) -> None:
    machine(ldconfig=known_libraries(without=""), xauth="", **{"g++": ""})
    assert setup_script.missing_system_packages() == [("xvfb",)]


def test_apt_installs_the_names_that_this_release_knows(
    setup_script: ModuleType, machine: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    log = machine(apt_get='echo "$@" >>"$LOG"', apt_cache='[ "$2" != new-name ]')
    setup_script.install_system_packages([("new-name", "old-name"), ("new-name",), ("first", "second")])
    update, install = log.read_text().splitlines()
    assert update.endswith("update")
    assert install.endswith("install --yes --no-install-recommends old-name first")


@pytest.mark.parametrize(("sudo", "used"), [("", False), ('echo sudo "$@" >>"$LOG"', True)])
def test_sudo_is_asked_only_by_those_who_are_not_root(
    setup_script: ModuleType,
    machine: Callable[..., Path],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    sudo: str,
    used: bool,
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    commands = {"sudo": sudo} if sudo else {}
    log = machine(apt_get="exit 1", apt_cache="", **commands)
    setup_script.install_system_packages([("libusb-1.0-0",)])
    if used:
        assert "sudo" in log.read_text().splitlines()[-1]
    else:
        assert "sudo apt-get install libusb-1.0-0" in capsys.readouterr().out


def test_without_apt_the_list_is_printed(
    setup_script: ModuleType, machine: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    machine()
    setup_script.install_system_packages([("libglib2.0-0t64", "libglib2.0-0"), ("xvfb",)])
    assert "libglib2.0-0 xvfb" in capsys.readouterr().out


def test_a_failing_apt_is_reported_and_the_set_up_goes_on(
    setup_script: ModuleType,
    machine: Callable[..., Path],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    machine(apt_get="echo no network >&2; exit 100", apt_cache="")
    setup_script.install_system_packages([("xvfb",)])
    complaint = capfd.readouterr().err
    assert "no network" in complaint
    assert "sudo apt-get install xvfb" in complaint


def test_the_stamp_follows_the_file(setup_script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(setup_script, "VENV", tmp_path)
    monkeypatch.setattr(setup_script, "VENV_PYTHON", tmp_path / "python")
    lock = tmp_path / "lock"
    lock.write_text("one")
    assert not setup_script.Stamp("packages", lock).holds()
    setup_script.Stamp("packages", lock).set()
    assert not setup_script.Stamp("packages", lock).holds(), "there is no Python yet"
    (tmp_path / "python").touch()
    assert setup_script.Stamp("packages", lock).holds()
    lock.write_text("two")
    assert not setup_script.Stamp("packages", lock).holds()


def test_an_environment_that_was_moved_is_noticed(
    setup_script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setup_script, "VENV", tmp_path)
    lock = tmp_path / "lock"
    lock.write_text("one")
    setup_script.Stamp("packages", lock).set()
    assert not setup_script.Stamp("packages", lock).is_from_another_folder()
    monkeypatch.setattr(setup_script, "ROOT", tmp_path / "moved")
    assert setup_script.Stamp("packages", lock).is_from_another_folder()


@pytest.mark.parametrize(("asked", "anew"), [("", False), ("python3.9", True)])
def test_another_python_than_the_environments_is_used_if_asked_for(
    setup_script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: str, anew: bool
) -> None:
    monkeypatch.setattr(setup_script, "VENV", tmp_path)
    monkeypatch.setattr(setup_script, "VENV_PYTHON", tmp_path / "python")
    (tmp_path / "python").symlink_to(sys.executable)
    monkeypatch.setattr(setup_script, "missing_system_packages", list)
    made: list[bool] = []
    monkeypatch.setattr(setup_script, "make_venv", lambda *, recreate: made.append(recreate))
    monkeypatch.setattr(setup_script, "install_packages", lambda: None)
    monkeypatch.setattr(setup_script, "pip", lambda *arguments, what: None)
    monkeypatch.setenv("PYTHON", "")
    setup_script.set_up()
    assert made == [False]
    monkeypatch.setenv("PYTHON", asked)
    monkeypatch.setattr(sys, "version_info", (3, 9, 1))
    setup_script.set_up()
    assert made == [False, True][: 1 + anew]
