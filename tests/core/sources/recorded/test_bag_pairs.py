"""Two recordings of one camera each as one source: names, clocks, pairs and errors."""

from dataclasses import replace

import numpy as np
import pytest

from bag_maker import D405, L515, depth_images, make_bag
from tactune.core.errors import SourceError
from tactune.core.sources.realsense_files import BagSource
from tactune.core.sources.registry import open_source

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
    with open_source(f"{'bag:' if swapped else ''}{files[0]},{files[1]}") as source:
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
    assert source.health().message == "4 images without one of the other camera are left out"


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
    with pytest.raises(SourceError, match=r"both recordings are of the same camera, Intel RealSense L515 sn0"):
        BagSource(f"{path},{copy}")
