"""Bags with one or two cameras: images, rig, pairing by time, colour."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bag_maker import D405, L515, Device, color_images, depth_images, make_bag
from tactune.core.sources.realsense_files import BagSource


@pytest.mark.parametrize("compress", [False, True])
def test_two_cameras_are_read_pixel_for_pixel_in_any_order(tmp_path, compress):
    path = make_bag(tmp_path / "two.bag", D405, L515, compress=compress)
    with BagSource(path) as source:
        assert source.length == 3
        assert source.frame_rate_hz == 15.0
        assert source.health().message == ""
        assert source.health().ok
        for index in (2, 0, 1, 1):
            frame = source.read(index)
            assert frame.sequence == index
            np.testing.assert_array_equal(frame.proximity_depth, L515.depth.images[index])
            np.testing.assert_array_equal(frame.proximity_color, L515.color.images[index])
            np.testing.assert_array_equal(frame.tactile_depth, D405.depth.images[index])
            assert frame.tactile_color is None
            frame.check_against(source.rig)


@pytest.mark.parametrize(
    ("clocks", "expected", "times_s"),
    [
        (("Global Time", "Global Time"), [2, 0], [(50.0, 49.9), (60.0, 60.2)]),
        (("Hardware Clock", "Hardware Clock"), [1, 2], [(1.0, 1.4), (2.0, 2.2)]),
        (("Global Time", "System Time"), [1, 2], [(1.0, 1.4), (2.0, 2.2)]),
        ((None, None), [1, 2], [(1.0, 1.4), (2.0, 2.2)]),
    ],
)
def test_cameras_are_paired_on_a_clock_that_they_share(open_bag, tmp_path, clocks, expected, times_s):
    proximity = depth_images(4, [1.0, 2.0], stamps_s=[50.0, 60.0], clock=clocks[0])
    tactile = depth_images(5, [0.4, 1.4, 2.2], stamps_s=[60.2, 70.0, 49.9], clock=clocks[1])
    path = make_bag(tmp_path / "two.bag", Device("L515", proximity), Device("D405", tactile))
    frames = list(open_bag(path))
    for frame, index, (proximity_s, tactile_s) in zip(frames, expected, times_s, strict=True):
        np.testing.assert_array_equal(frame.tactile_depth, tactile.images[index])
        assert frame.proximity_time_s == pytest.approx(proximity_s, abs=1e-9)
        assert frame.tactile_time_s == pytest.approx(tactile_s, abs=1e-9)
        assert frame.skew_s == pytest.approx(tactile_s - proximity_s)


def test_the_colour_cameras_pose_goes_by_way_of_the_reference(open_bag, tmp_path):
    turn_depth, turn_color = Rotation.from_euler("xyz", [0.3, -0.2, 0.1]), Rotation.from_euler("xyz", [-0.1, 0.5, 0.2])
    depth = depth_images(4, [1.0], pose=(turn_depth, (0.01, 0.02, 0.03)))
    color = color_images(5, [1.0], pose=(turn_color, (-0.04, 0.05, 0.06)))
    two = Device("L515", depth, color), Device("D405", depth_images(5, [1.0]))
    source = open_bag(make_bag(tmp_path / "two.bag", *two))
    T_c_d = np.asarray(source.rig.proximity_color.T_color_depth)
    at_reference = np.array([0.3, -0.2, 0.7])
    in_depth = turn_depth.apply(at_reference) + np.array([0.01, 0.02, 0.03])
    in_color = turn_color.apply(at_reference) + np.array([-0.04, 0.05, 0.06])
    np.testing.assert_allclose(T_c_d[:3, :3] @ in_depth + T_c_d[:3, 3], in_color, atol=1e-12)


def test_one_camera_is_a_tactile_camera(open_bag, tmp_path):
    source = open_bag(make_bag(tmp_path / "one.bag", L515))
    assert source.health().ok
    assert not source.rig.has_proximity
    assert source.rig.tactile.model == "Intel RealSense L515"
    assert source.rig.tactile.intrinsics == source.rig.proximity.intrinsics
    frame = source.read(1)
    assert np.array_equal(frame.tactile_depth, frame.proximity_depth)
    assert frame.tactile_depth.any()
    assert frame.skew_s == 0.0
    frame.check_against(source.rig)
