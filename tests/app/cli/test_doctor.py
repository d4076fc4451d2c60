"""``tactune doctor``: each check on a working system and with each simulated fault; ``tactune devices``."""

import json
import os

import pytest

from tactune.app.cli import doctor
from tactune.app.cli.doctor import Check, State, check_cameras, check_drivers, check_packages
from tactune.app.sources import list_devices
from tactune.app.sources.list_devices import Child, python_child, run_child
from tactune.core.sources.cameras import drivers
from tactune.core.sources.cameras.camera import DeviceInfo


def only(lines):
    (line,) = lines
    return line


# Child processes


def test_a_child_that_crashes_hangs_fails_or_is_missing_is_told_in_words():
    crash = run_child(python_child("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"))
    assert crash.problem == "crashed (SIGSEGV)"
    assert "no answer within" in run_child(python_child("import time; time.sleep(60)"), patience_s=0.3).problem
    assert run_child(python_child("raise ValueError('odd')")).problem == "ValueError: odd"
    assert "cannot be started" in run_child(["/no/such/program"]).problem


def test_a_check_that_fails_itself_is_a_line_and_the_others_go_on(monkeypatch):
    def check_the_moon():
        raise ZeroDivisionError("dust")

    checks = [check_the_moon, lambda: [Check("Sun", State.OK, "shines")]]
    monkeypatch.setattr(doctor, "CHECKS", checks)
    lines = doctor.check_computer()
    assert [(line.name, line.state) for line in lines] == [("the moon", State.WARN), ("Sun", State.OK)]
    assert "ZeroDivisionError: dust" in lines[0].found


@pytest.mark.parametrize(
    ("check", "answer", "state", "words"),
    [
        (check_packages, {}, State.OK, "numpy"),
        (check_packages, Child(problem="crashed (SIGSEGV)"), State.FAIL, "crashed (SIGSEGV)"),
        (check_drivers, Child(problem="crashed (SIGSEGV)"), State.FAIL, "crashed (SIGSEGV)"),
        (check_drivers, {"version": "2.54.2.5684", "no_l515": ""}, State.OK, "2.54.2.5684"),
        (check_drivers, {"version": "2.57.7.1", "no_l515": "it knows no L515"}, State.WARN, "2.57.7.1"),
        (check_drivers, {"problem": "it is not installed: pip install it", "version": ""}, State.WARN, "not installed"),
        (check_drivers, {"problem": "needs libudev: apt", "version": "2.54"}, State.FAIL, "needs libudev"),
    ],
)
def test_what_child_processes_answer(check, answer, state, words):
    line = only(check(lambda _: answer if isinstance(answer, Child) else Child(json.dumps(answer))))
    assert line.state is state
    assert words in line.found
    assert bool(line.remedy) is (state is not State.OK)


@pytest.fixture
def plug_in(tmp_path):
    """Make a USB device as Linux shows it; returns its node."""
    (tmp_path / "usb").mkdir()

    def make(port="2-1", product="Intel RealSense L515", speed="5000", number=7, vendor="8086"):
        folder = tmp_path / "usb" / port
        folder.mkdir()
        for name, text in (("idVendor", vendor), ("product", product), ("speed", speed), ("busnum", "2")):
            (folder / name).write_text(f"{text}\n")
        (folder / "devnum").write_text(f"{number}\n")
        node = tmp_path / "nodes" / "002" / f"{number:03d}"
        node.parent.mkdir(parents=True, exist_ok=True)
        node.write_text("")
        return node

    return make


def test_cameras_on_usb(tmp_path, plug_in, monkeypatch):
    assert only(check_cameras(tmp_path / "usb", tmp_path / "nodes")).state is State.WARN
    plug_in()
    plug_in("2-2", "Intel RealSense D405", speed="480", number=8)
    plug_in("2-3", "Bluetooth adapter", number=9)
    plug_in("2-4", "RealSense look-alike", number=10, vendor="1234")
    fast, slow = check_cameras(tmp_path / "usb", tmp_path / "nodes")
    assert (fast.state, fast.found) == (State.OK, "Intel RealSense L515 on USB 3 (5000 Mbit/s)")
    assert slow.state is State.FAIL
    assert "USB 2 (480 Mbit/s)" in slow.found
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    closed = check_cameras(tmp_path / "usb", tmp_path / "nodes")
    assert [line.state for line in closed] == [State.FAIL] * 2
    assert "no permission" in closed[0].found
    assert "udev" in closed[0].remedy


def test_the_report_is_lines_with_remedies_and_its_status_tells(tactune, monkeypatch):
    lines = [Check("Sun", State.OK, "shines"), Check("Moon", State.WARN, "waxes", "Wait.")]
    monkeypatch.setattr(doctor, "CHECKS", [lambda: lines])
    done = tactune("doctor")
    assert done.status == 0
    assert done.out.splitlines()[:3] == [
        "ok   Sun             shines",
        "warn Moon            waxes",
        "                     Wait.",
    ]
    assert "2 checks: 0 failed, 1 with a warning" in done.out
    lines.append(Check("Earth", State.FAIL, "quakes", "Hold on."))
    assert tactune("doctor").status == 1


def test_what_the_driver_s_process_writes_is_what_is_put_into_words(tactune, monkeypatch, capsys):
    def listed(connected, hint=""):
        monkeypatch.setattr(drivers, "list_devices", lambda: (connected, hint, []))
        capsys.readouterr()
        assert list_devices.main() == 0
        written = capsys.readouterr().out
        monkeypatch.setattr(list_devices, "run_child", lambda command, patience_s: Child(written))
        return tactune("devices")

    l515 = DeviceInfo("L515", "f0190001", role="proximity", firmware="1.5.8.1", usb="3.2")
    done = listed([l515, DeviceInfo("unknown", "", problem="it does not answer")])
    assert done.status == 0
    assert done.out.splitlines() == [
        "L515, serial f0190001, firmware 1.5.8.1, USB 3.2",
        "unknown, serial unknown, firmware unknown, USB unknown",
        "  It does not answer.",
    ]
    none = listed([], "the driver no longer supports the L515")
    assert none.status == 1 and none.out.startswith("The driver no longer supports the L515.\nNo camera is connected")
