"""Orbbec cameras by the SDK's own playback of recordings that were written without a camera."""

import inspect

import numpy as np
import pytest

import orbbec_bag
from tactune.core.errors import SourceError
from tactune.core.preset import CamerasSection
from tactune.core.sources.cameras import orbbec
from tactune.core.sources.cameras.camera_source import CameraSource
from tactune.core.sources.cameras.orbbec import OrbbecDriver

pytest.importorskip("pyorbbecsdk", reason="the Orbbec SDK is not installed", exc_type=ImportError)
sdk = orbbec.load_sdk()

COUNT = 60
DEPTHS = [np.full((576, 640), 300 + n, np.uint16) for n in range(COUNT)]
COLORS = [np.full((480, 640, 3), (n, 2 * n, 3 * n), np.uint8) for n in range(COUNT)]


class Played:
    """Recordings, named by their serials, in place of the SDK's list of connected devices.

    Only what is opened becomes a device of the SDK: one that ends before its threads have begun may wait a minute.
    """

    def __init__(self, *paths):
        self.paths = paths

    def get_count(self):
        return len(self.paths)

    def get_device_name_by_index(self, index):
        return "Orbbec Femto Bolt"

    def get_device_serial_number_by_index(self, index):
        return self.paths[index].stem

    def get_device_connection_type_by_index(self, index):
        return "USB3.0"

    def get_device_by_serial_number(self, serial):
        return sdk.PlaybackDevice(str(next(path for path in self.paths if path.stem == serial)))


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    paths = [tmp_path_factory.mktemp("bags") / f"{name}.bag" for name in ("A1", "B2")]
    for path in paths:
        orbbec_bag.write_bag(path, DEPTHS, COLORS, path.stem)
    return Played(*paths)


def test_a_camera_reports_its_lenses_and_its_images(played):
    driver = OrbbecDriver(lambda: played)
    first, _ = driver.devices()
    assert (first.model, first.serial, first.role, first.usb) == ("Femto Bolt", "A1", "proximity", "3.0")
    camera = driver.open("A1", "proximity")
    lens = camera.calibration.depth.intrinsics
    assert (lens.fx, lens.fy, lens.cx, lens.cy, lens.width, lens.height) == (*orbbec_bag.DEPTH_LENS, 640, 576)
    assert camera.calibration.depth.depth_unit_m == 0.001
    assert np.allclose(np.array(camera.calibration.T_color_depth)[:3, 3], np.array(orbbec_bag.SHIFT_MM) / 1000)
    assert camera.rate_hz == 30.0
    camera.start()
    seen = [images for images in (camera.read(1.0) for _ in range(10)) if images is not None]
    camera.close()
    camera.close()
    assert len(seen) == 10
    for images in seen:
        assert np.array_equal(images.depth, DEPTHS[images.number])
        assert images.color is not None
        assert np.array_equal(images.color, COLORS[images.number])
        assert images.time_s == pytest.approx(1.7e9 + images.number / 30, abs=1e-5)


def test_two_make_a_rig_in_the_roles_that_are_asked_for(played):
    section = CamerasSection()
    for role, serial in (("proximity", "B2"), ("tactile", "A1")):
        section = section.model_copy(update={role: getattr(section, role).model_copy(update={"serial": serial})})
    with CameraSource([OrbbecDriver(lambda: played)], section) as source:
        assert (source.rig.proximity.serial, source.rig.tactile.serial) == ("B2", "A1")


@pytest.mark.parametrize(
    ("model", "k1", "outcome"),
    [(3, 0.01, "brown_conrady"), (4, 0.01, "brown_conrady"), (0, 0.0, "none"), (1, 0.0, "none")],
)
def test_lens_models(model, k1, outcome, tmp_path):
    orbbec_bag.write_bag(tmp_path / "A1.bag", DEPTHS, COLORS, "A1", model, k1)
    camera = OrbbecDriver(lambda: Played(tmp_path / "A1.bag")).open("A1", "tactile")
    camera.close()
    assert camera.calibration.color.distortion == outcome


def test_a_lens_whose_numbers_nobody_defines_is_refused(tmp_path):
    orbbec_bag.write_bag(tmp_path / "A1.bag", DEPTHS, COLORS, "A1", 1, 0.01)
    with pytest.raises(SourceError, match=r"Femto Bolt.*\(serial A1\) reports .* lens.*modified_brown_conrady"):
        OrbbecDriver(lambda: Played(tmp_path / "A1.bag")).open("A1", "tactile")


def test_what_is_not_there_is_told(played, monkeypatch):
    with pytest.raises(SourceError, match="the serial C3 is not connected"):
        OrbbecDriver(lambda: played).open("C3", "tactile")
    monkeypatch.setattr(orbbec, "find_spec", lambda name: None)
    assert OrbbecDriver().devices() == []


def test_the_options_are_properties_of_this_sdk():
    for number, _, _ in orbbec._OFFERED.values():
        assert hasattr(sdk.OBPropertyID, number)
    for kind in ("int", "bool"):
        for name in (f"get_{kind}_property", f"set_{kind}_property", f"get_{kind}_property_range"):
            assert inspect.isroutine(getattr(sdk.Device, name))
    for name in ("min", "max", "step", "default_value"):
        assert hasattr(sdk.OBIntPropertyRange, name)
        assert hasattr(sdk.OBBoolPropertyRange, name)
    for method in (name for name in dir(Played) if name.startswith("get_")):
        assert hasattr(sdk.DeviceList, method)
    formats = {name for name in dir(sdk.OBFormat) if name.isupper()}
    assert formats >= orbbec._COLORS.keys()
