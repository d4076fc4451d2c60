"""Incomplete or damaged bags are refused with one sentence."""

from dataclasses import replace

import pytest

from bag_maker import D405, L515, Device, color_images, depth_images, make_bag
from tactune.core.errors import SourceError
from tactune.core.sources.realsense_files import BagSource


@pytest.fixture
def two_cameras(tmp_path):
    return make_bag(tmp_path / "two.bag", D405, L515)


ONE = [1.0]
BAD = {
    "no depth": ([Device("L515", None, color_images(1, ONE))], "it holds no depth images"),
    "three cameras": (
        [D405, L515, replace(D405, name="D415")],
        r"has 3 depth cameras \(Intel RealSense D405, Intel RealSense L515, D415\); record one or two",
    ),
    "no unit": ([replace(D405, unit_topic=None)], "the depth unit is missing"),
    "no lens": ([replace(D405, without={"camera_info"})], r"Depth_0/info/camera_info is missing"),
    "unknown lens": ([Device("D405", depth_images(1, ONE, lens="Ftheta"))], "'ftheta' is not a valid Distortion"),
    "focal length of zero": ([Device("D405", depth_images(1, ONE, K=(0.0, 1.0, 1.0, 1.0)))], "fx"),
    "no pose": (
        [Device("L515", depth_images(1, ONE), color_images(1, ONE, tf=None))],
        r"the pose of /device_0/sensor_1/Color_0 to /device_0/sensor_0/Depth_0 is missing",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_recording_that_lacks_something_is_refused_in_one_sentence(tmp_path, case):
    devices, sentence = BAD[case]
    path = make_bag(tmp_path / "bad.bag", *devices)
    with pytest.raises(SourceError, match=sentence) as caught:
        BagSource(path)
    assert "bad.bag" in str(caught.value)
    assert "record" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("device", "sentence"),
    [
        (Device("L515", depth_images(1, ONE, encoding="32FC1")), "'32FC1'; known are mono16"),
        (Device("L515", depth_images(1, ONE, size=(6, 9))), "it has 8 x 6 pixels, .* 9 x 6"),
        (Device("L515", depth_images(1, ONE, missing_bytes=16)), "it has 80 bytes, too few for its size"),
    ],
)
def test_an_image_that_is_not_as_stated_is_refused(open_bag, tmp_path, device, sentence):
    source = open_bag(make_bag(tmp_path / "bad.bag", device))
    with pytest.raises(SourceError, match=sentence):
        source.read(0)


def test_a_closed_source_says_so(open_bag, two_cameras):
    source = open_bag(two_cameras)
    source.close()
    source.close()
    with pytest.raises(SourceError, match=r"two\.bag is closed; open it again"):
        source.read(0)
