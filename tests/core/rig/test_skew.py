"""The delay between both cameras is recovered: on a board with known motion, and on the simulator."""

import numpy as np
import pytest

from side_by_side import HEIGHT, WIDTH, counts
from tactune.core.errors import FrameError, RigMismatchError
from tactune.core.preset import AlignmentSection
from tactune.core.rig.skew import STEP, Sample, measure_skew
from tactune.core.sources.registry import open_source

RATE_HZ = 30.0
REST_M = 0.30
TARGET_S = 0.003


def press(t):
    """Depth of the board, metres: an irregular in and out that begins and ends before it touches."""
    return REST_M - 0.02 * (np.sin(2.4 * t) + 0.55 * np.sin(5.3 * t + 1.0) + 0.3 * np.sin(9.1 * t))


def still(t):
    return REST_M - 0.01


@pytest.fixture
def record(rig):
    """A few seconds in which the tactile camera's stamps are ``delay_s`` later than what they show."""
    shape = -(-HEIGHT // STEP), -(-WIDTH // STEP)
    across = np.hypot(*(np.indices(shape) - np.array([shape[0] / 2, shape[1] / 2])[:, None, None]))
    bulge = np.clip(1.4 - across / 10, 0, 1)

    def make(delay_s, motion=press, seconds=5.0, noise_m=0.001, drop=0.0, jitter_s=0.0, phase_s=0.011):
        rng = np.random.default_rng(7)
        samples = []
        for index in range(round(seconds * RATE_HZ)):
            if rng.random() < drop:
                continue
            near_s = index / RATE_HZ
            far_s = near_s + phase_s + rng.uniform(-jitter_s, jitter_s)
            pressed = np.maximum(REST_M - motion(far_s - delay_s), 0.0)
            noise = rng.normal(0, noise_m, (2, *shape))
            near = counts(motion(near_s) + noise[0], rig.proximity)
            samples.append(Sample(near_s, far_s, near, counts(REST_M - pressed * bulge + noise[1], rig.tactile)))
        return samples

    return make


@pytest.mark.parametrize(
    ("delay_s", "values"),
    [(-0.5, {}), (-0.033, {"model": "homography"}), (0.0, {}), (0.06, {"depth_offset_m": 0.004})],
)
def test_a_known_delay_is_found_to_a_fraction_of_a_frame(rig, record, delay_s, values):
    skew = measure_skew(record(delay_s), rig, AlignmentSection(**values))
    assert skew.delay_s == pytest.approx(delay_s, abs=TARGET_S)
    assert skew.uncertainty_s < 0.010
    assert skew.significant == (delay_s != 0.0)


def test_the_delay_is_on_the_time_stamps_not_on_the_frame_numbers(rig, record):
    skew = measure_skew(record(0.08, drop=0.15, jitter_s=0.008), rig, AlignmentSection())
    assert skew.delay_s == pytest.approx(0.08, abs=TARGET_S)


def shift(frames, first, seconds, delay_s):
    """Play simulator frames over and over; the tactile image is mixed of the two between which the delay falls."""
    samples = []
    for index in range(round(seconds * RATE_HZ)):
        near_s = index / RATE_HZ
        shown = (first + (near_s + 0.0021 - delay_s) * RATE_HZ) % len(frames)
        before = frames[int(shown)].tactile_depth[::STEP, ::STEP]
        after = frames[(int(shown) + 1) % len(frames)].tactile_depth[::STEP, ::STEP]
        mixed = np.rint(before + (shown % 1.0) * (after.astype(float) - before))
        both = (before % 65535 > 0) & (after % 65535 > 0)
        near = frames[(first + index) % len(frames)].proximity_depth[::STEP, ::STEP]
        samples.append(Sample(near_s, near_s + 0.0021, near, np.where(both, mixed, 0).astype(np.uint16)))
    return samples


def test_the_simulator_pressed_over_and_over_gives_its_delay():
    source = open_source("sim:cup?sensor=datasheet&seed=1")
    frames = [source.read(index) for index in range(source.length)]
    for delay_s in (-0.0767, 0.0083):
        skew = measure_skew(shift(frames, 20, 5.0, delay_s), source.rig, AlignmentSection())
        assert skew.delay_s == pytest.approx(delay_s, abs=0.004)


def test_a_still_scene_is_refused_with_the_reason(rig, record):
    with pytest.raises(FrameError, match=r"proximity camera sees too little motion, .* press an object"):
        measure_skew(record(0.0, motion=still), rig, AlignmentSection())


def test_a_motion_that_repeats_is_refused_with_both_delays(rig, record):
    def beat(t):
        return REST_M - 0.02 * np.sin(2 * np.pi * t / 0.5)

    with pytest.raises(FrameError, match=r"delays of .* fit almost equally well"):
        measure_skew(record(0.02, motion=beat), rig, AlignmentSection())


def test_missing_depth_and_a_missing_pose_are_said(rig, record):
    samples = record(0.0, seconds=1.0)
    blind = [Sample(s.proximity_time_s, s.tactile_time_s, s.proximity_depth, s.tactile_depth * 0) for s in samples]
    with pytest.raises(FrameError, match=r"tactile camera sees almost no depth"):
        measure_skew(blind, rig, AlignmentSection())
    with pytest.raises(RigMismatchError, match=r"calibrate"):
        measure_skew(samples, rig.model_copy(update={"T_proximity_tactile": None}), AlignmentSection())
