"""Systematic errors of the simulator's named sensors; what measures noise tells whether its noise is right."""

from dataclasses import replace

import numpy as np
import pytest

from tactune.core.sources.simulator.noise import NoiseModel
from tactune.core.sources.simulator.render import CLEAN_UNIT_M
from tactune.core.sources.simulator.scene import CleanState, simulator_rig
from tactune.core.sources.simulator.sensors import SENSORS

RIG = simulator_rig()
#: A wall at 0.3 m that faces both cameras.
WALL = np.full((480, 640), round(0.3 / CLEAN_UNIT_M), dtype=np.uint16)
FACING, PLAIN = np.full(WALL.shape, 255, dtype=np.uint8), np.zeros(WALL.shape, dtype=np.uint8)


def proximity_error(model):
    """Error of the proximity camera on the wall in metres, NaN where there is no depth."""
    counts = model.proximity_depth(0, CleanState(WALL, WALL, FACING, PLAIN, PLAIN, WALL, PLAIN, WALL))
    return np.where(counts > 0, counts * RIG.proximity.depth_unit_m - WALL * CLEAN_UNIT_M, np.nan)


@pytest.mark.parametrize("name", ["datasheet", "l515-d405", "worn", "far-offset"])
def test_systematic_errors_are_as_the_model_says(name):
    sensor = SENSORS[name]
    shared = replace(sensor, tof_correlated_m=0.0, tof_slow_bias_m=0.0, tof_drift_m=0.0, stereo_hole_share=0.01)
    error = proximity_error(NoiseModel(RIG, 0, 1.0, shared))
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
        assert np.array_equal(proximity_error(none), proximity_error(clean))
        assert np.array_equal(none.tactile_depth(2, WALL), clean.tactile_depth(2, WALL))
    far = SENSORS["far-offset"]
    for level in (0.5, 2.0):
        error = proximity_error(NoiseModel(RIG, 0, level, far))
        assert np.nanmean(error) == pytest.approx(0.020 * level, abs=2e-4)
