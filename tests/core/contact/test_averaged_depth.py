"""The temporal average of depth while the membrane is still."""

from dataclasses import replace

import numpy as np
import pytest

from tactune.core.contact.average import AveragedDepth
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.preset import Preset

AVERAGED = Preset().with_values({"contact_test": "membrane", "membrane.frames": 10})


@pytest.fixture(scope="module")
def rig(make_rig):
    return make_rig(width=160, height=120)


def frames_of(make_frame, rig, count, noise_m=0.0008, share_missing=0.1):
    return [make_frame(rig, seed, noise_m, share_missing) for seed in range(count)]


def test_the_mean_is_that_of_the_frames(make_frame, rig):
    frames = frames_of(make_frame, rig, 8, share_missing=0.0)
    average = AveragedDepth(rig, 10)
    for frame in frames:
        shown = average.add(frame)
    for name in ("proximity_depth", "tactile_depth"):
        mean = np.mean([getattr(frame, name).astype(float) for frame in frames], axis=0)
        assert np.abs(getattr(shown, name) - mean).max() <= 0.51
    assert shown.sequence == frames[-1].sequence


def test_where_the_membrane_moves_both_cameras_begin_anew(make_frame, rig):
    still = make_frame(rig, 0, 0.0, 0.0)
    average = AveragedDepth(rig, 10)
    for _ in range(5):
        average.add(still)
    pressed = still.tactile_depth.copy()
    pressed[32:96, 32:96] -= np.uint16(12)  # 1.2 mm, in four squares
    nearer = still.proximity_depth - np.uint16(1)  # 0.25 mm, which alone would be averaged
    moved = replace(still, tactile_depth=pressed, proximity_depth=nearer)
    shown = average.add(moved)
    np.testing.assert_array_equal(shown.tactile_depth, pressed)
    np.testing.assert_array_equal(shown.proximity_depth, nearer)


def test_what_moves_behind_a_membrane_at_rest_begins_anew_by_itself(make_frame, rig):
    still = make_frame(rig, 0, 0.0, 0.0)
    average = AveragedDepth(rig, 10)
    for _ in range(5):
        average.add(replace(still, tactile_depth=still.tactile_depth + np.uint16(2)))
    behind = still.proximity_depth.copy()
    behind[:32, :32] += np.uint16(8)  # 2 mm
    behind[70, 70] += np.uint16(100)  # one pixel
    shown = average.add(replace(still, proximity_depth=behind))
    np.testing.assert_array_equal(shown.proximity_depth, behind)
    assert (shown.tactile_depth > still.tactile_depth).mean() > 0.99


def test_the_pipeline_averages_only_where_asked_and_each_frame_once(make_frame, rig):
    frames = frames_of(make_frame, rig, 6)
    alone = ContactPipeline(AVERAGED.with_value("membrane.frames", 1), rig)
    averaging, average = ContactPipeline(AVERAGED, rig), AveragedDepth(rig, 10)
    for frame in frames:
        shown = average.add(frame)
        for _ in range(3):
            patch = averaging.process(frame)
        single = alone.process(frame)
    expected = ContactPipeline(AVERAGED.with_value("membrane.frames", 1), rig).process(shown)
    np.testing.assert_array_equal(patch.points, expected.points)
    fresh = ContactPipeline(AVERAGED, rig).process(frames[-1])
    np.testing.assert_array_equal(single.points, fresh.points)
    assert patch.points.shape != single.points.shape or not np.array_equal(patch.points, single.points)


def test_what_moves_slowly_together_stays_together(make_frame, rig):
    """The difference of both depths tells contact, so one may not lag behind the other."""
    still = make_frame(rig, 0, 0.0, 0.0)
    nearer = replace(still, proximity_depth=(still.proximity_depth * 0.93).astype(np.uint16))
    average = AveragedDepth(rig, 15)
    cameras = ("proximity_depth", rig.proximity.depth_unit_m), ("tactile_depth", rig.tactile.depth_unit_m)
    for step in range(60):
        way_m = 0.00005 * step
        moved = {name: np.rint(getattr(nearer, name) + way_m / unit_m).astype(np.uint16) for name, unit_m in cameras}
        shown = average.add(replace(still, **moved))
        lags_m = [np.median(moved[name].astype(float) - getattr(shown, name)) * unit_m for name, unit_m in cameras]
        assert abs(lags_m[0] - lags_m[1]) < 0.0003
