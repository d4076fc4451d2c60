"""``tactune devices`` with cameras, without cameras, and with a driver that is missing, hangs or crashes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tactune.app.doctor import checks as doctor
from tactune.app.doctor import computer
from tactune.app.doctor.checks import Child
from tactune.app.doctor.computer import UsbCamera
from tactune.app.sources import list_devices
from tactune.core.sources.cameras import drivers
from tactune.core.sources.cameras import realsense as driver
from tactune.core.sources.cameras.camera import DeviceInfo

L515 = {
    "model": "L515",
    "serial": "f0190001",
    "role": "proximity",
    "firmware": "1.5.8.1",
    "usb": "3.2",
    "problem": "",
}
D405 = {
    "model": "D405",
    "serial": "12345",
    "firmware": "",
    "usb": "2.1",
    "problem": "it runs at USB 2, too slow for these cameras; use a USB 3 port and cable",
}


@pytest.fixture(autouse=True)
def usb(monkeypatch):
    """What the operating system sees; nothing at first."""
    cameras: list[UsbCamera] = []
    monkeypatch.setattr(computer, "usb_cameras", lambda: cameras)
    monkeypatch.setattr(driver, "driver_version", lambda: "2.54.2.5684")
    return cameras


@pytest.fixture
def answer(monkeypatch):
    """Let the driver's process answer."""

    def set_answer(devices=None, problem="", died=""):
        told = {"problem": problem} if problem else {"devices": devices}
        child = Child(problem=died) if died else Child(json.dumps(told))
        monkeypatch.setattr(doctor, "run_child", lambda command, patience_s: child)

    return set_answer


def test_a_driver_without_the_l515_says_so(tactune, answer, monkeypatch):
    monkeypatch.setattr(driver, "driver_version", lambda: "2.57.7.10000")
    answer([D405])
    assert "no longer supports the L515" in tactune("devices").out
    answer([L515])
    assert "L515:" not in tactune("devices").out


def test_a_camera_that_only_usb_sees_is_named(tactune, answer, usb):
    usb.append(UsbCamera("Intel RealSense L515", 5000.0, Path("/dev/null")))
    answer([])
    done = tactune("devices")
    assert done.status == 1
    assert "On USB there are Intel RealSense L515; the driver does not list all of them" in done.out


@pytest.mark.parametrize("died", ["crashed (SIGSEGV)", "no answer within 15 s"])
def test_a_driver_that_crashes_or_hangs_is_one_sentence(tactune, answer, died):
    answer(died=died)
    assert died in tactune("devices").sentence


def test_what_the_driver_s_process_writes_is_what_is_put_into_words(tactune, monkeypatch, capsys):
    connected = [DeviceInfo(**L515), DeviceInfo("unknown", "", problem="it does not answer")]
    monkeypatch.setattr(drivers, "list_devices", lambda: (connected, "", []))
    assert list_devices.main() == 0
    written = capsys.readouterr().out
    monkeypatch.setattr(doctor, "run_child", lambda command, patience_s: Child(written))
    done = tactune("devices")
    assert done.status == 0
    assert done.out.splitlines() == [
        "L515, serial f0190001",
        "  firmware 1.5.8.1, USB 3.2",
        "unknown, serial unknown",
        "  firmware unknown, USB version unknown",
        "  It does not answer.",
    ]
