"""Recordings are read like by librealsense's own player, pixel for pixel."""

import importlib.util
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from librealsense_player import RATE_HZ, START_S, images, played
from tactune.core.sources.realsense_files import open_recording

FIXTURES = Path(__file__).parents[3] / "data"
needs_a_driver = pytest.mark.skipif(
    not importlib.util.find_spec("pyrealsense2"), reason="pyrealsense2 (extra realsense) is not installed"
)


def _assert_lens(ours, lens, model):
    assert [ours.width, ours.height, ours.fx, ours.fy, ours.cx, ours.cy, *ours.coefficients] == lens.tolist()
    assert ours.distortion.value == model


@pytest.fixture
def real_bag(shared_data):
    return shared_data / "realsense_bag/single_depth_color_640x480.bag"


def test_the_real_bag_is_what_is_known_of_it(open_bag, real_bag):
    source = open_bag(real_bag)
    assert (source.rig.tactile.model, source.rig.tactile.serial) == ("Intel RealSense D435", "728612070259")
    assert source.rig.tactile.depth_unit_m == pytest.approx(0.001, rel=1e-6)
    assert source.frame_rate_hz == 6.0
    assert [round(frame.proximity_time_s, 6) for frame in source] == [360.815089, 360.981765]
    source.seek(0)
    assert [int(frame.proximity_depth.sum(dtype=np.int64)) for frame in source] == [357542766, 358061319]


def color_at(camera, index):
    """The colour image nearest to a depth image, in the colour camera's own pixels."""
    return camera.color(int(camera.partners[index]))


@needs_a_driver
@pytest.mark.parametrize("which", ["real", "l515"])
def test_a_recording_is_as_librealsense_plays_it(open_bag, real_bag, tmp_path, which):
    path = real_bag if which == "real" else FIXTURES / "l515_2.54.2.bag"
    source, theirs = open_bag(path), played(path, tmp_path / "played.npz")
    depth_ms, color_ms = theirs["Depth_times_ms"], theirs["Color_times_ms"]
    assert source.length == len(depth_ms)
    with closing(open_recording(path, lambda share, words: None)) as file:
        [(camera, _)] = file.cameras
        for index, frame in enumerate(source):
            time_ms = frame.tactile_time_s * 1e3
            depth, color = int(np.argmin(np.abs(depth_ms - time_ms))), int(np.argmin(np.abs(color_ms - time_ms)))
            np.testing.assert_array_equal(frame.tactile_depth, theirs["Depth"][depth])
            np.testing.assert_array_equal(color_at(camera, index), theirs["Color"][color])
            assert time_ms == pytest.approx(depth_ms[depth], abs=2e-3)
    lenses = camera.calibration.color_camera
    assert source.rig.tactile.depth_unit_m == theirs["unit_m"]
    _assert_lens(source.rig.tactile.intrinsics, theirs["Depth_lens"], str(theirs["Depth_model"]))
    _assert_lens(lenses.intrinsics, theirs["Color_lens"], str(theirs["Color_model"]))
    T_c_d = np.asarray(lenses.T_color_depth)
    np.testing.assert_allclose(T_c_d[:3, :3], theirs["rotation"].reshape(3, 3).T, atol=1e-6)
    np.testing.assert_allclose(T_c_d[:3, 3], theirs["translation"], atol=1e-8)


@pytest.mark.parametrize(
    ("name", "unit_m"), [("l515_2.54.2.bag", 0.00025), ("d405_2.58.4.db3", 0.0001), ("d405_2.59.1.db3", 0.0001)]
)
def test_recordings_of_three_versions_hold_what_was_sent(open_bag, name, unit_m):
    source = open_bag(FIXTURES / name)
    assert source.length == 3
    assert source.frame_rate_hz == 30.0
    with closing(open_recording(FIXTURES / name, lambda share, words: None)) as file:
        colors = [color_at(file.cameras[0][0], index) for index in range(3)]
    for index in (2, 0, 1):
        depth, color = images(name, index, (48, 32))
        frame = source.read(index)
        np.testing.assert_array_equal(frame.tactile_depth, depth)
        np.testing.assert_array_equal(colors[index], color)
        assert frame.tactile_time_s == pytest.approx(START_S + index / RATE_HZ, abs=2e-6)
    camera = source.rig.tactile
    assert camera.model.lower().endswith(name[:4])
    assert camera.depth_unit_m == float(np.float32(unit_m))
    focal = {"l515": 0.7203, "d405": 0.6779}[name[:4]] * 48
    lens = camera.intrinsics
    assert [lens.fx, lens.fy, lens.cx, lens.cy] == pytest.approx([focal, focal + 0.625, 25.25, 13.5], rel=1e-6)


@pytest.mark.parametrize("tactile", ["d405_2.58.4.db3", "d405_2.59.1.db3"])
def test_a_bag_and_a_db3_are_one_source(open_bag, tactile):
    source = open_bag(f"{FIXTURES / tactile},{FIXTURES / 'l515_2.54.2.bag'}")
    assert source.length == 3
    assert source.health().message == ""
    for index, frame in enumerate(source):
        np.testing.assert_array_equal(frame.proximity_depth, images("l515", index, (48, 32))[0])
        np.testing.assert_array_equal(frame.tactile_depth, images("d405", index, (48, 32))[0])
        assert frame.skew_s == pytest.approx(0.0, abs=2e-6)
