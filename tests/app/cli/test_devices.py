"""``tactune devices`` with cameras, without cameras, and with a driver that is missing, hangs or crashes."""

import pytest

from tactune.app.sources import list_devices
from tactune.app.sources.list_devices import Child
from tactune.core.sources.cameras import drivers
from tactune.core.sources.cameras.camera import DeviceInfo


@pytest.mark.parametrize("died", ["crashed (SIGSEGV)", "no answer within 15 s"])
def test_a_driver_that_crashes_or_hangs_is_one_sentence(tactune, monkeypatch, died):
    monkeypatch.setattr(list_devices, "run_child", lambda command, patience_s: Child(problem=died))
    assert died in tactune("devices").sentence


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
