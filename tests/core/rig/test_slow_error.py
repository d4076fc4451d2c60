"""The slow error of the proximity camera, measured on a flat background made here."""

import cv2
import numpy as np
import pytest

from tactune.core.rig.slow_error import SLOW_LENGTH, slow_error_m

HEIGHT, WIDTH = 480, 640


def smooth(seed, length_px):
    """Noise of variance 1 that neighbours share, made small and enlarged."""
    by = max(int(length_px / 4), 1)
    white = np.random.default_rng(seed).normal(size=(3 * HEIGHT // by, 3 * WIDTH // by))
    field = cv2.GaussianBlur(white, (0, 0), length_px / by)
    small = field[: HEIGHT // by + 2, : WIDTH // by + 2] / field.std()
    return cv2.resize(small, None, fx=by, fy=by, interpolation=cv2.INTER_CUBIC)[:HEIGHT, :WIDTH]


def wall(seed, slow_m, noise_m=0.0004, noise_px=3.0):
    """A slanting wall behind two objects, with missing pixels."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    depth = 1 / (1.05 - 0.0004 * u + 0.0003 * v)
    depth[180:300, 280:420], depth[60:90, 500:540] = 0.45, 0.30
    depth += slow_m * smooth(seed, SLOW_LENGTH * WIDTH) + noise_m * smooth(seed + 500, noise_px)
    depth[np.random.default_rng(seed).random(depth.shape) < 0.02] = np.nan
    return depth.astype(np.float32)


@pytest.mark.parametrize("slow_m", [0.0, 0.0003, 0.0006])
def test_the_amplitude_is_measured_on_a_slanting_wall(slow_m):
    found = [slow_error_m(wall(seed, slow_m), 3.0) for seed in range(6)]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(slow_m, rel=0.35, abs=0.0001)


def test_noise_that_neighbours_share_is_no_slow_error():
    found = [slow_error_m(wall(seed, 0.0, 0.0010, 9.0), 9.0) for seed in range(6)]
    assert np.median(found) < 0.0002


def test_a_background_that_is_not_flat_tells_nothing():
    rough = wall(0, 0.0) + 0.02 * smooth(3, 30.0).astype(np.float32)
    assert slow_error_m(rough, 3.0) is None
    assert slow_error_m(np.full((HEIGHT, WIDTH), np.nan, np.float32), 3.0) is None
    assert slow_error_m(np.ones((60, 80), np.float32), 0.0) == pytest.approx(0.0, abs=0.0001)
