"""Assignment of devices to roles, and the messages for ambiguous devices."""

import importlib
import re

import pytest

from tactune.core.errors import MissingExtraError, SourceError
from tactune.core.preset import CameraSection, CamerasSection
from tactune.core.sources.cameras import realsense as driver
from tactune.core.sources.cameras.camera import DeviceInfo
from tactune.core.sources.cameras.drivers import choose

L515, L515_TOO = DeviceInfo("L515", "f1", "proximity"), DeviceInfo("L515", "f2", "proximity")
D405, D405_TOO = DeviceInfo("D405", "d1", "tactile"), DeviceInfo("D405", "d2", "tactile")
D435 = DeviceInfo("D435I", "d3")


def named(proximity="", tactile=""):
    return CamerasSection(proximity=CameraSection(serial=proximity), tactile=CameraSection(serial=tactile))


@pytest.mark.parametrize(
    ("connected", "cameras", "expected"),
    [
        ([D405, L515], named(), (L515, D405)),
        ([D435, L515, D405], named(), (L515, D405)),
        ([D435, L515, D405], named(tactile="d3"), (L515, D435)),
        ([L515, L515_TOO, D405, D405_TOO], named("f2", "d1"), (L515_TOO, D405)),
        ([D405, D405_TOO], named("d1", "d2"), (D405, D405_TOO)),
        ([D405, D435, L515], named("d1", "d3"), (D405, D435)),
        ([L515, L515_TOO, D405], named(tactile="f1"), (L515_TOO, L515)),
    ],
)
def test_cameras_are_found_by_serial_or_by_model(connected, cameras, expected):
    chosen = choose(connected, cameras)
    assert (chosen["proximity"], chosen["tactile"]) == expected


@pytest.mark.parametrize(
    ("connected", "cameras", "words"),
    [
        ([], named(), "finds no camera connected: plug both"),
        ([L515], named(), r"a tactile camera is not connected, only L515 \(serial f1\); plug a D405"),
        ([D405], named(), r"a proximity camera is not connected, only D405 \(serial d1\); plug an L515"),
        ([D435, L515], named(), r"a tactile camera is not connected, only D435I .*or name both serials"),
        ([L515, D405, D405_TOO], named(), r"D405 \(serial d1\) and D405 \(serial d2\) may each be the tactile camera"),
        ([L515, D405], named("f9"), r"proximity camera with the serial f9 is not connected, only L515 .*d1\); plug it"),
        ([L515, D405], named("f1", "f1"), "both cameras have the serial f1"),
    ],
)
def test_what_is_missing_or_open_is_said_with_the_remedy(connected, cameras, words):
    with pytest.raises(SourceError, match=f"^cameras: .*{words}"):
        choose(connected, cameras)


@pytest.mark.parametrize("connected", [[], [D405]])
def test_a_driver_without_the_l515_is_blamed_and_the_right_one_named(connected, monkeypatch):
    monkeypatch.setattr(driver, "driver_version", lambda: "2.59.1.11053")
    hint = driver.RealSenseDriver().hint()
    with pytest.raises(SourceError, match=r"2\.59\.1\.11053 no longer supports the L515.*pyrealsense2==2\.54\.2"):
        choose(connected, named(), hint)


def test_which_drivers_know_the_l515():
    versions = ("2.50.0", "2.54.2.5684", "2.55.1", "2.59.1.11053")
    assert [bool(driver.no_l515_sentence(version)) for version in versions] == [False, False, True, True]


@pytest.mark.parametrize(
    ("error", "kind", "words"),
    [
        (
            ModuleNotFoundError("No module named 'pyrealsense2'"),
            MissingExtraError,
            r"pip install 'tactune\[realsense\]'",
        ),
        (ImportError("undefined symbol: x"), SourceError, "undefined symbol.*force-reinstall"),
    ],
)
def test_a_driver_that_cannot_be_loaded_is_one_sentence(error, kind, words, monkeypatch):
    def refuse(name):
        assert name == "pyrealsense2"
        raise error

    monkeypatch.setattr(importlib, "import_module", refuse)
    with pytest.raises(kind, match=words) as caught:
        driver.load_driver()
    assert re.search(r"[\n]", str(caught.value)) is None
