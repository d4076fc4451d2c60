"""RealSense bags: images, rig, pairing by time within a file and across two, and refusals in one sentence."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bag_maker import D405, L515, Device, color_images, depth_images, make_bag
from tactune.core.errors import SourceError
from tactune.core.model.intrinsics import Distortion
from tactune.core.sources.realsense_files import BagSource
from tactune.core.sources.registry import open_source


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


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ("None", Distortion.NONE),
        ("Brown Conrady", Distortion.BROWN_CONRADY),
        ("Modified Brown Conrady", Distortion.MODIFIED_BROWN_CONRADY),
        ("Inverse Brown Conrady", Distortion.INVERSE_BROWN_CONRADY),
    ],
)
def test_lens_models_keep_their_names_and_coefficients(open_bag, tmp_path, model, expected):
    depth = depth_images(4, [1.0], lens=model, D=(0.1, -0.2, 0.3, -0.4, 0.5))
    lens = open_bag(make_bag(tmp_path / "one.bag", Device("D435", depth))).rig.proximity.intrinsics
    assert lens.distortion is expected
    assert lens.coefficients == (0.1, -0.2, 0.3, -0.4, 0.5)


EPOCH_S = 1_750_000_000.0
RATE_S = 1 / 30


def times(count, start=0.0, step=RATE_S):
    return [start + step * index for index in range(count)]


def two_files(tmp_path, proximity, tactile):
    first = make_bag(tmp_path / "first.bag", replace(L515, depth=proximity, serial="p1"))
    second = make_bag(tmp_path / "second.bag", replace(D405, depth=tactile, serial="t1"))
    return f"{first},{second}"


def on_global_time(seed, stamps_s, recorded_s=None):
    return depth_images(seed, recorded_s or times(len(stamps_s)), stamps_s=stamps_s, clock="Global Time")


@pytest.mark.parametrize("swapped", [False, True])
def test_two_files_are_one_source_in_either_order(tmp_path, swapped):
    tactile = make_bag(tmp_path / "d405.bag", replace(D405, serial="t1", depth=on_global_time(1, times(3, EPOCH_S))))
    proximity = make_bag(tmp_path / "l515.bag", replace(L515, depth=on_global_time(2, times(3, EPOCH_S + 0.004))))
    files = [tactile, proximity] if swapped else [proximity, tactile]
    told, name = [], f"{'bag:' if swapped else ''}{files[0]},{files[1]}"
    with open_source(name, lambda share, _: told.append(share)) as source:
        assert told == ([0.0, 0.5, 0.75] if swapped else [0.0, 0.25, 0.5]), "one job, from 0 to 100 %"
        assert source.name == f"bag:{files[0]},{files[1]}"
        assert (source.rig.proximity.model, source.rig.tactile.model) == (L515.name, D405.name)
        assert (source.rig.proximity.serial, source.rig.tactile.serial) == ("sn0", "t1")
        assert source.length == 3
        assert source.health().message == ""
        source.seek(2)
        frame = source.next_frame()
        np.testing.assert_array_equal(frame.proximity_depth, on_global_time(2, times(3)).images[2])
        np.testing.assert_array_equal(frame.tactile_depth, on_global_time(1, times(3)).images[2])
        assert frame.skew_s == pytest.approx(-0.004, abs=1e-6)
        assert frame.proximity_time_s == pytest.approx(EPOCH_S + 0.004 + 2 * RATE_S, abs=1e-6)
    files[0].write_bytes(b"")
    with pytest.raises(SourceError, match=f"{files[0].name}: this is no readable ROS recording"):
        open_source(name)
    files[1].write_bytes(files[1].read_bytes()[:4200])  # the header alone
    with pytest.raises(SourceError, match=f"{files[1].name} has no messages: it was cut off"):
        open_source(f"bag:{files[1]}")


def test_the_stamps_pair_images_whose_recorders_were_started_at_different_moments(open_bag, tmp_path):
    proximity = on_global_time(1, times(5, EPOCH_S))
    tactile = on_global_time(2, times(5, EPOCH_S + 2 * RATE_S + 0.003))
    source = open_bag(two_files(tmp_path, proximity, tactile))
    assert source.length == 3
    for index, frame in enumerate(source):
        assert frame.sequence == index
        np.testing.assert_array_equal(frame.proximity_depth, proximity.images[index + 2])
        np.testing.assert_array_equal(frame.tactile_depth, tactile.images[index])
    assert source.health().unmatched == 4
    assert source.health().ok
    assert source.health().message == "4 images without a partner from the other camera are left out"


@pytest.mark.parametrize(("late_s", "expected"), [(0.016, 4), (-0.016, 4), (0.0175, 3), (-0.0175, 3)])
def test_half_a_period_is_the_limit(open_bag, tmp_path, late_s, expected):
    stamps = times(4, EPOCH_S)
    alone = [stamps[0], stamps[1] + late_s, *stamps[2:]]
    source = open_bag(two_files(tmp_path, on_global_time(1, stamps), on_global_time(2, alone)))
    assert source.length == expected
    assert source.health().unmatched == 2 * (4 - expected)


def test_clocks_that_cannot_be_compared_are_refused(tmp_path):
    proximity, tactile = depth_images(1, times(3)), on_global_time(2, times(3, EPOCH_S))
    sentence = r"clocks cannot be compared \(Hardware Clock and Global Time.*global time enabled"
    with pytest.raises(SourceError, match=sentence):
        BagSource(two_files(tmp_path, proximity, tactile))


def test_the_same_camera_twice_is_refused(tmp_path):
    path = make_bag(tmp_path / "a.bag", L515)
    copy = tmp_path / "b.bag"
    copy.write_bytes(path.read_bytes())
    with pytest.raises(SourceError, match=r"both are of the same Intel RealSense L515 sn0"):
        BagSource(f"{path},{copy}")


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


@pytest.mark.parametrize("has_index", [True, False])
def test_a_bag_whose_recorder_was_killed_plays_up_to_its_last_whole_chunk(tmp_path, open_bag, has_index):
    whole = make_bag(tmp_path / "whole.bag", D405, L515, compress=True).read_bytes()
    at = whole.index(b"index_pos=") + len(b"index_pos=")
    last_chunk = whole.rindex(b"compression=lz4", 0, whole.rindex(b"compression=lz4") - 400)
    path = tmp_path / "killed.bag"
    index_pos = whole[at : at + 8] if has_index else bytes(8)
    path.write_bytes(whole[:at] + index_pos + whole[at + 8 : last_chunk + 200])
    source = open_bag(path)
    assert "killed.bag was not finished when it was recorded" in source.health().message
    assert source.length == 2
    for index, frame in enumerate(source):
        np.testing.assert_array_equal(frame.proximity_depth, L515.depth.images[index])
        np.testing.assert_array_equal(frame.tactile_depth, D405.depth.images[index])
