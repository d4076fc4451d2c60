"""The statistic that compares simulated with real noise, and that the fitted sensor agrees."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactune.core.model.intrinsics import Intrinsics
from tactune.core.sources.simulator.sensors import SENSORS

SCRIPT = Path(__file__).parents[3] / "scripts" / "measure_noise_statistics.py"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("measure_noise_statistics", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclass looks there
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def curved(shape):
    v, u = np.indices(shape) / 100.0
    return 1.0 / (3.0 + 0.1 * u - 0.2 * v + 0.05 * u * v)


def test_residual_is_the_noise_on_a_quadratic_surface(script):
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.standard_normal((200, 260)), (0, 0), 3.0)
    noise *= 0.001 / noise.std()
    depth = curved(noise.shape) + noise
    depth[::17, ::13] = 0.0
    depth[50, 60] += 0.1
    residual = script.residual_m(depth)
    assert np.isnan(residual[0, 0]) and np.isnan(residual[50, 60])
    assert np.nanstd(residual) == pytest.approx(0.001, rel=0.05)
    expected = [np.exp(-(lag**2) / 36.0) for lag in (1, 2, 4, 8)]
    assert script.autocorrelation(residual, (1, 2, 4, 8)) == pytest.approx(expected, abs=0.08)


def test_the_smoothest_region_is_found(script):
    rng = np.random.default_rng(1)
    depth = curved((240, 320)) + 0.002 * rng.standard_normal((240, 320))
    depth[80:180, 120:250] = curved((240, 320))[80:180, 120:250]
    depth[:, :100] = 0.0
    assert script.smoothest(depth, (130, 100), 20) == (slice(80, 180), slice(120, 250))
    with pytest.raises(SystemExit, match="no region of 130 x 100 pixels"):
        script.smoothest(np.zeros((240, 320)), (130, 100), 20)


def test_noise_is_brought_to_the_named_distance_and_incidence(script):
    lens = Intrinsics(width=320, height=240, fx=230.0, fy=230.0, cx=160.0, cy=120.0)
    middle = slice(100, 140), slice(140, 180)
    sensor = SENSORS["l515-d405"]
    assert script.growth(np.full((240, 320), 0.3), middle, lens, sensor) == pytest.approx(1.0, abs=0.01)
    assert script.growth(np.full((240, 320), 0.6), middle, lens, sensor) == pytest.approx(1.5, abs=0.01)
    v, _ = np.indices((240, 320))
    tilted = 0.3 / (1.0 + np.tan(np.radians(60.0)) * (v - 120.0) / 230.0).clip(0.1)
    assert script.growth(tilted, middle, lens, sensor) == pytest.approx(1.35, abs=0.03)


@pytest.mark.long
def test_the_fitted_sensor_agrees_with_real_cameras_and_the_data_sheets_do_not(
    script, shared_data, monkeypatch, capsys
):
    for sensor, status in (("l515-d405", 0), ("datasheet", 1)):
        words = [str(SCRIPT), "--data", str(shared_data), "--sensor", sensor, "--frames", "1"]
        monkeypatch.setattr("sys.argv", words)
        assert script.main() == status
        assert ("DISAGREES" in capsys.readouterr().out) is bool(status)
