"""Interference that was put in is found with its size; what is only chance is not."""

from __future__ import annotations

import json

import numpy as np
import pytest

from side_by_side import HEIGHT, WIDTH, counts
from tactune.core.errors import FrameError
from tactune.core.rig.interference import emitter_switch, measure_interference, on_value
from tactune.core.sources.base import CameraOption


def recorded(rig, noise_m, missing, frames=40, seed=0):
    rng = np.random.default_rng(seed)
    images = []
    for _ in range(frames):
        image = counts(0.3 + rng.normal(0, noise_m, (HEIGHT, WIDTH)), rig.tactile)
        image[rng.random(image.shape) < missing] = rng.choice([0, 65535])
        images.append(image)
    return images


def option(name, value=1.0, minimum=0.0, maximum=1.0, default=1.0, camera="proximity", read_only=False):
    return CameraOption(camera, name, "", minimum, maximum, 1.0, default, value, read_only=read_only)


def test_lost_depth_and_added_noise_have_the_size_that_was_put_in(rig):
    found = measure_interference(recorded(rig, 0.0009, 0.10), recorded(rig, 0.0003, 0.02, seed=1), rig.tactile)
    assert found.disturbed
    assert found.fill_lost == pytest.approx(0.08, abs=0.002)
    assert found.noise_ratio == pytest.approx(3.0, rel=0.03)
    assert found.on.noise_m == pytest.approx(0.0009, rel=0.03)
    assert "costs the tactile camera 8.0 % of its pixels and makes its depth 3.0 times as noisy" in found.sentence
    assert "laser power" in found.remedy


@pytest.mark.parametrize(
    ("noise_m", "missing", "words"),
    [(0.0009, 0.02, "times as noisy"), (0.0003, 0.06, "of its pixels")],
)
def test_either_effect_alone_is_interference(rig, noise_m, missing, words):
    found = measure_interference(recorded(rig, noise_m, missing), recorded(rig, 0.0003, 0.02, seed=1), rig.tactile)
    assert found.disturbed
    assert words in found.sentence


def test_chance_is_no_interference(rig):
    for seed in range(5):
        found = measure_interference(
            recorded(rig, 0.0004, 0.02, seed=seed), recorded(rig, 0.0004, 0.02, seed=seed + 50), rig.tactile
        )
        assert not found.disturbed
        assert "does not disturb" in found.sentence
        assert found.remedy == ""


def test_an_emitter_that_helps_is_no_interference(rig):
    found = measure_interference(recorded(rig, 0.0003, 0.02), recorded(rig, 0.0003, 0.3, seed=1), rig.tactile)
    assert not found.disturbed
    assert "helps" in found.sentence


def test_only_the_region_counts(rig):
    on, off = recorded(rig, 0.0003, 0.0), recorded(rig, 0.0003, 0.0, seed=1)
    for image in on:
        image[:, : WIDTH // 2] = 0
    right = (WIDTH // 2, 0, WIDTH // 2, HEIGHT)
    assert not measure_interference(on, off, rig.tactile, right).disturbed
    assert measure_interference(on, off, rig.tactile).fill_lost == pytest.approx(0.5)


def test_a_camera_that_goes_blind_is_said_without_numbers_that_are_not_known(rig):
    blind = [np.zeros((HEIGHT, WIDTH), np.uint16)] * 12
    found = measure_interference(blind, recorded(rig, 0.0003, 0.02, frames=12), rig.tactile)
    assert found.disturbed
    assert "temporal noise unknown with it" in found.sentence
    assert json.loads(json.dumps(found.to_json(), allow_nan=False))["on"]["noise_m"] is None
    with pytest.raises(FrameError, match="no depth with the emitter on or off"):
        measure_interference(blind, blind, rig.tactile)
    with pytest.raises(FrameError, match="only 9 frames"):
        measure_interference(blind[:9], blind, rig.tactile)


def test_the_emitter_is_switched_by_what_the_camera_has():
    emitter, laser = option("emitter_enabled"), option("laser_power", 60.0, 0.0, 100.0, 48.0)
    assert emitter_switch([laser, emitter]) is emitter
    assert emitter_switch([option("gain"), laser]) is laser
    assert (
        emitter_switch([option("emitter_enabled", camera="tactile"), option("laser_power", minimum=10.0, maximum=90.0)])
        is None
    )
    assert emitter_switch([option("emitter_enabled", read_only=True)]) is None
    assert on_value(laser) == 60.0
    assert on_value(option("laser_power", 0.0, 0.0, 100.0, 48.0)) == 48.0
    assert on_value(option("laser_power", 0.0, 0.0, 100.0, 0.0)) == 100.0
