"""The simulator's named sensors: measured amplitude, correlation and other errors are what each model says."""

from dataclasses import replace

import numpy as np
import pytest

from tactune.core.sources.simulator.noise import STEREO_BASELINE_M, NoiseModel
from tactune.core.sources.simulator.render import CLEAN_UNIT_M
from tactune.core.sources.simulator.scene import CleanState, simulator_rig
from tactune.core.sources.simulator.sensors import SENSORS

RIG = simulator_rig()
#: A wall at 0.3 m that faces both cameras.
WALL = np.full((480, 640), round(0.3 / CLEAN_UNIT_M), dtype=np.uint16)
#: The default and a coarse one, and the others in the long run.
ORDINARY = ("l515-d405", "worn")
EACH = [name if name in ORDINARY else pytest.param(name, marks=pytest.mark.long) for name in SENSORS]
FACING, PLAIN = np.full(WALL.shape, 255, dtype=np.uint8), np.zeros(WALL.shape, dtype=np.uint8)


def measured(model, frame, wall, cosine=FACING, flags=PLAIN):
    """Return what the proximity camera measures of a wall behind the membrane."""
    return model.proximity_depth(frame, CleanState(wall, wall, cosine, flags, PLAIN, wall, PLAIN, wall))


def proximity_error(model, frame, wall=WALL, cosine=FACING):
    """Error in metres without the known bias; NaN where there is no depth."""
    counts = measured(model, frame, wall, cosine)
    error = counts * RIG.proximity.depth_unit_m - wall * CLEAN_UNIT_M
    return np.where(counts > 0, error, np.nan)


def tactile_error(model, frame):
    """Error in disparity pixels; NaN where there is no match."""
    counts = model.tactile_depth(frame, WALL)
    focal_baseline = RIG.tactile.intrinsics.fx * STEREO_BASELINE_M
    with np.errstate(divide="ignore"):
        error = focal_baseline / (counts * RIG.tactile.depth_unit_m) - focal_baseline / 0.3
    return np.where((counts > 0) & (counts < 65535), error, np.nan)


def random_part(sensor, seed, frame):
    """Error in metres of a sensor without its systematic errors."""
    random = replace(sensor, tof_offset_m=0.0, tof_scale=1.0, tof_slope_m=0.0, tof_slow_bias_m=0.0, tof_drift_m=0.0)
    return proximity_error(NoiseModel(RIG, seed, 1.0, random), frame)


def covariance(one, other, lag=0):
    """Mean product of two images, one shifted by some columns."""
    return float(np.nanmean(one[:, lag:] * other[:, : other.shape[1] - lag]))


def check_noise(errors, white, correlated, length_px, fixed_share, step):
    """Compare pairs of frames, one pair a seed, with white noise and correlated noise of variance 1."""
    spread = float(np.mean([covariance(e, e) for pair in errors for e in pair])) ** 0.5
    assert spread == pytest.approx((white**2 + correlated**2 + step**2 / 12) ** 0.5, rel=0.1, abs=0.5 * step)
    if correlated == 0.0:
        return
    tolerance = 0.12 if length_px < 12 else 0.4
    for lag in (round(0.5 * length_px) or 1, round(length_px)):
        expected = correlated**2 * np.exp(-(lag**2) / (4 * length_px**2))
        found = float(np.mean([covariance(e, e, lag) for pair in errors for e in pair]))
        assert found == pytest.approx(expected, rel=tolerance)
    far = float(np.mean([covariance(e, e, round(6 * length_px)) for pair in errors for e in pair]))
    assert abs(far) < tolerance * correlated**2
    kept = float(np.mean([covariance(*pair) for pair in errors]))
    assert kept == pytest.approx(fixed_share * correlated**2, rel=1.5 * tolerance)


@pytest.mark.parametrize("name", EACH)
def test_time_of_flight_noise_has_the_amplitude_and_the_length_of_the_model(name):
    sensor = SENSORS[name]
    errors = [[random_part(sensor, seed, frame) for frame in (0, 9)] for seed in range(3)]
    check_noise(
        errors, sensor.tof_white_m, sensor.tof_correlated_m, sensor.tof_correlated_px,
        sensor.tof_correlated_fixed_share, RIG.proximity.depth_unit_m,
    )  # fmt: skip


@pytest.mark.parametrize("name", EACH)
def test_stereo_noise_has_the_amplitude_and_the_length_of_the_model(name):
    sensor = SENSORS[name]
    models = [NoiseModel(RIG, seed, 1.0, sensor) for seed in range(3)]
    errors = [[tactile_error(model, frame) for frame in (0, 9)] for model in models]
    step = 1.0 / sensor.stereo_subpixel_steps if sensor.stereo_subpixel_steps else 0.008
    check_noise(
        errors, sensor.stereo_white_px, sensor.stereo_correlated_px, sensor.stereo_length_px,
        sensor.stereo_fixed_share, step,
    )  # fmt: skip
    holes = np.mean([np.isnan(error[:, 60:]).mean() for pair in errors for error in pair])
    assert holes == pytest.approx(sensor.stereo_hole_share, rel=0.35, abs=1e-4)


@pytest.mark.parametrize("name", ["datasheet", "l515-d405", "worn", "far-offset"])
def test_systematic_errors_are_as_the_model_says(name):
    sensor = SENSORS[name]
    shared = replace(sensor, tof_correlated_m=0.0, tof_slow_bias_m=0.0, tof_drift_m=0.0, stereo_hole_share=0.01)
    error = proximity_error(NoiseModel(RIG, 0, 1.0, shared), 0)
    assert np.nanmean(error) == pytest.approx(sensor.tof_offset_m + 0.3 * (sensor.tof_scale - 1.0), abs=2e-5)
    turn = np.radians(sensor.tof_slope_deg)
    across = np.nanmean(error[:, 540:]) - np.nanmean(error[:, :100])
    assert across == pytest.approx(sensor.tof_slope_m * np.cos(turn) * 540 / 640, abs=5e-5)
    down = np.nanmean(error[380:]) - np.nanmean(error[:100])
    assert down == pytest.approx(sensor.tof_slope_m * np.sin(turn) * 380 / 640, abs=5e-5)
    assert np.isnan(error).mean() == pytest.approx(sensor.tof_dropout_share, rel=0.1)


def test_no_noise_is_the_clean_sensor_and_noise_is_a_factor_on_all_errors():
    clean = NoiseModel(RIG, 0, 1.0, SENSORS["clean"])
    for sensor in (SENSORS["l515-d405"], SENSORS["worn"]):
        none = NoiseModel(RIG, 0, 0.0, sensor)
        assert np.array_equal(proximity_error(none, 2), proximity_error(clean, 2))
        assert np.array_equal(tactile_error(none, 2), tactile_error(clean, 2))
    far = SENSORS["far-offset"]
    for level in (0.5, 2.0):
        error = proximity_error(NoiseModel(RIG, 0, level, far), 0)
        assert np.nanmean(error) == pytest.approx(0.020 * level, abs=2e-4)
