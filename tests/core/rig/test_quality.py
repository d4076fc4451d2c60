"""Depth quality on planes with known noise, against NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from side_by_side import BASELINE_M, HEIGHT, WIDTH, counts, plane_depth
from tactune.core.errors import FrameError
from tactune.core.preset import Preset
from tactune.core.rig.quality import Verdict, measure_quality, temporal_noise

REGION = (40, 30, 80, 60)
TILTED = (0.15, -0.08, 1.0)


def test_a_tilted_wall_with_noise_gives_its_plane_and_its_noise(rig, make_frame):
    camera = rig.proximity
    depth = plane_depth(camera, TILTED, 0.30)
    noisy = depth + np.random.default_rng(2).normal(0, 0.0005, depth.shape)
    quality = measure_quality([make_frame(noisy, 0.3)], rig, Preset(), REGION, true_distance_m=0.300).proximity

    window = np.s_[30:90, 40:120]
    z = (counts(noisy, camera)[window] * camera.depth_unit_m).ravel()
    x, y = (camera.intrinsics.rays().astype(np.float64)[window].reshape(-1, 2) * z[:, None]).T
    (a, b, c), *_ = np.linalg.lstsq(np.column_stack([x, y, np.ones_like(z)]), z, rcond=None)
    order = np.argsort(z)[len(z) // 200 : len(z) - len(z) // 200]
    length = np.sqrt(a * a + b * b + 1)
    rms = np.sqrt(np.mean(((z - (a * x + b * y + c))[order] / length) ** 2))
    assert quality.plane_rms_m == pytest.approx(rms, rel=1e-4)
    assert quality.distance_m == pytest.approx(0.30, abs=1e-4)
    assert quality.angle_deg == pytest.approx(np.degrees(np.arccos(1 / np.linalg.norm(TILTED))), abs=0.1)
    assert quality.z_accuracy == pytest.approx((c - 0.3) / 0.3, abs=1e-4)


def test_the_fill_rate_counts_neither_zero_nor_65535(rig, make_frame):
    depth_m = np.full((HEIGHT, WIDTH), 0.3)
    depth_m[30:36, 40:120], depth_m[36:42, 40:120] = 0.0, 65535 * rig.proximity.depth_unit_m
    frame = make_frame(depth_m, 0.3)
    assert measure_quality([frame], rig, Preset(), REGION).proximity.fill_rate == pytest.approx(0.8)


def test_temporal_noise_is_the_noise_that_was_put_in_and_leaves_out_missing_depths():
    rng = np.random.default_rng(3)
    true = rng.uniform(2900, 3100, (50, 60))
    stack = np.rint(true + rng.normal(0, 20, (40, 50, 60))).astype(np.uint16)
    stack[:3], stack[3:5] = 0, 65535
    metres, share = temporal_noise(stack, 1e-4)
    std = stack[5:].astype(np.float64).std(axis=0)
    assert metres == pytest.approx(np.sqrt(np.median(std**2)) * 1e-4, rel=0.01)
    assert share == pytest.approx(np.median(std / np.median(stack[5:], axis=0)), rel=0.01)
    assert np.isnan(temporal_noise(np.zeros((40, 5, 5), np.uint16), 1e-4)[0])


def test_the_tactile_region_sees_the_same_part_of_a_wall(rig, make_frame):
    left, top, width, height = measure_quality([make_frame(0.3, 0.3)], rig, Preset(), REGION).tactile.region
    near, far = rig.proximity.intrinsics, rig.tactile.intrinsics
    first = (REGION[0] - near.cx) / near.fx * 0.3 - BASELINE_M
    assert left == pytest.approx(first / 0.3 * far.fx + far.cx, abs=0.6)
    assert top == pytest.approx((REGION[1] - near.cy) / near.fy * far.fy + far.cy, abs=0.6)
    assert width == pytest.approx(79 * far.fx / near.fx + 1, abs=1.0)
    assert height == pytest.approx(59 * far.fy / near.fy + 1, abs=1.0)


@pytest.mark.parametrize("region", [(-1, 0, 10, 10), (0, 0, 0, 10), (100, 0, 61, 10), (0, 0, WIDTH, HEIGHT + 1)])
def test_a_region_outside_the_image_is_refused(rig, make_frame, region):
    with pytest.raises(FrameError, match="within the proximity image"):
        measure_quality([make_frame(0.3, 0.3)], rig, Preset(), region)


def test_what_is_unknown_is_not_claimed(rig, make_frame):
    blind = measure_quality([make_frame(0.0, 0.3)] * 6, rig, Preset(), REGION)
    verdicts = {reading.title: reading.verdict for reading in blind.proximity.readings()}
    assert verdicts == {"Fill rate": Verdict.POOR, "Plane fit": Verdict.UNKNOWN, "Temporal noise": Verdict.UNKNOWN}
    assert np.isnan(blind.bias_m) and "no depth" in blind.problem
    alone = rig.model_copy(update={"T_proximity_tactile": None})
    without_pose = measure_quality([make_frame(0.3, 0.3)], alone, Preset(), REGION)
    assert without_pose.tactile.region == REGION
    reading = without_pose.bias_reading(Preset())
    assert reading.verdict is Verdict.UNKNOWN and "calibrate" in reading.line


def test_without_a_pose_the_region_is_cut_to_the_tactile_image(rig, make_frame):
    lens = rig.tactile.intrinsics.model_copy(update={"width": 60, "height": 40})
    small = rig.tactile.model_copy(update={"intrinsics": lens})
    smaller = rig.model_copy(update={"tactile": small, "T_proximity_tactile": None})
    frame = replace(make_frame(0.3, 0.3), tactile_depth=np.full((40, 60), 3000, np.uint16), tactile_color=None)
    quality = measure_quality([frame], smaller, Preset().with_value("alignment.model", "rigid"), (50, 50, 80, 60))
    assert quality.problem and quality.tactile.region == (50, 39, 10, 1)
    assert quality.tactile.fill_rate == 1.0


def test_words_say_the_number_what_is_good_and_the_next_step(rig, make_frame):
    rng = np.random.default_rng(5)
    shape = (HEIGHT, WIDTH)
    frames = [
        make_frame(0.300 + rng.normal(0, 0.0006, shape), 0.300 + rng.normal(0, 0.009, shape), index)
        for index in range(45)
    ]
    quality = measure_quality(frames, rig, Preset(), REGION)
    fill, plane, _ = quality.proximity.readings()
    assert fill.line == "Fill rate: 100.0 % – good (99 % or more)."
    assert "0.58 mm" in plane.value and plane.verdict is Verdict.GOOD
    noise = quality.tactile.readings()[-1]
    assert quality.tactile.frames == 40
    assert noise.verdict is Verdict.POOR and noise.step and "(good: " in noise.line


@pytest.mark.parametrize(
    ("bias_m", "values", "verdict"),
    [
        (0.001, {"contact_test": "tolerance"}, Verdict.GOOD),
        (-0.005, {"contact_test": "tolerance"}, Verdict.FAIR),
        (0.017, {"contact_test": "tolerance"}, Verdict.POOR),
        (-0.024, {"membrane.bias": True}, Verdict.GOOD),
        (0.027, {"membrane.bias": True}, Verdict.POOR),
        (0.0004, {"membrane.bias": False}, Verdict.GOOD),
        (-0.001, {"membrane.bias": False}, Verdict.FAIR),
        (0.002, {"membrane.bias": False}, Verdict.POOR),
    ],
)
def test_a_bias_is_judged_by_the_contact_test(rig, make_frame, bias_m, values, verdict):
    preset = Preset().with_values({"contact_test": "membrane"} | values)
    quality = measure_quality([make_frame(0.3 + bias_m, 0.3)], rig, preset, REGION)
    assert quality.bias_m == pytest.approx(bias_m, abs=1e-6)
    corrected = preset.with_value("alignment.depth_offset_m", bias_m)
    offset = measure_quality([make_frame(0.3 + bias_m, 0.3)], rig, corrected, REGION)
    assert offset.bias_m == pytest.approx(0.0, abs=1e-6)
    reading = quality.bias_reading(preset)
    assert reading.verdict is verdict
    assert ("proximity" if bias_m > 0 else "tactile") in reading.value
    if verdict is not Verdict.GOOD:
        assert f"{1e3 * bias_m:+.1f} mm".replace("-", "−") in reading.step


@pytest.mark.parametrize("contact_test", ["tolerance", "membrane"])
@pytest.mark.parametrize("farther_m", [0.04, 0.1])
def test_two_surfaces_are_no_bias(rig, make_frame, contact_test, farther_m):
    steps = np.where(np.arange(WIDTH) % 20 < 10, 0.3, 0.3 + farther_m)
    preset = Preset(contact_test=contact_test)
    reading = measure_quality([make_frame(steps, 0.3)], rig, preset, REGION).bias_reading(preset)
    assert reading.verdict is Verdict.UNKNOWN
    assert "same surface" in reading.line
