"""Depth quality on planes with known noise, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from side_by_side import BASELINE_M, HEIGHT, WIDTH, counts, plane_depth
from tactune.core.errors import FrameError
from tactune.core.preset import AlignmentSection, Preset
from tactune.core.rig.depth_quality import (
    camera_bias,
    camera_quality,
    clip_depths,
    fill_rate,
    fit_plane,
    measure_quality,
    stereo_baseline_m,
    tactile_region,
    temporal_noise,
)
from tactune.core.rig.quality_verdict import Verdict, judge_bias, judge_camera

REGION = (40, 30, 80, 60)
WINDOW = np.s_[30:90, 40:120]
TILTED = (0.15, -0.08, 1.0)


def test_the_plane_is_the_one_of_ordinary_least_squares():
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.1, 0.1, (500, 2)), rng.uniform(0.29, 0.31, 500)])
    points[:, 2] += 0.2 * points[:, 0]
    (a, b, c), *_ = np.linalg.lstsq(np.column_stack([points[:, :2], np.ones(500)]), points[:, 2], rcond=None)
    plane = fit_plane(points)
    assert plane is not None
    length = np.sqrt(a * a + b * b + 1)
    assert plane.normal == pytest.approx((-a / length, -b / length, 1 / length), abs=1e-12)
    assert plane.distance_m == pytest.approx(c / length, abs=1e-12)
    assert plane.along_axis_m() == pytest.approx(c, abs=1e-12)
    assert plane.signed_distances([[0, 0, c + 0.001]]) == pytest.approx([0.001 / length])


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), np.ones((2, 3)), np.outer(np.arange(9.0), (0.1, 0.2, 0.3)), np.ones((50, 3))],
)
def test_points_that_span_no_plane_give_none(points):
    assert fit_plane(points) is None


def test_half_a_percent_of_the_depths_is_cut_at_either_end():
    points = np.zeros((1000, 3))
    points[:, 2] = np.random.default_rng(0).permutation(1000)
    assert sorted(clip_depths(points)[:, 2]) == list(range(5, 995))


def test_a_tilted_wall_with_noise_gives_its_plane_and_its_noise(rig):
    camera = rig.tactile
    depth = plane_depth(camera, TILTED, 0.30)
    rng = np.random.default_rng(2)
    noisy = depth + rng.normal(0, 0.0005, depth.shape)
    quality = camera_quality("tactile", [counts(noisy, camera)], camera, REGION)

    rays = camera.intrinsics.rays().astype(np.float64)[WINDOW].reshape(-1, 2)
    z = (counts(noisy, camera)[WINDOW] * camera.depth_unit_m).ravel()
    x, y = (rays * z[:, None]).T
    (a, b, c), *_ = np.linalg.lstsq(np.column_stack([x, y, np.ones_like(z)]), z, rcond=None)
    order = np.argsort(z)[len(z) // 200 : len(z) - len(z) // 200]
    length = np.sqrt(a * a + b * b + 1)
    errors = (z - (a * x + b * y + c))[order] / length
    rms = np.sqrt(np.mean(errors**2))
    assert quality.plane_rms_m == pytest.approx(rms, rel=1e-6)
    assert quality.distance_m == pytest.approx(c / length, rel=1e-6)
    assert quality.plane_rms_share == pytest.approx(rms / (c / length), rel=1e-6)
    assert quality.distance_m == pytest.approx(0.30, abs=1e-4)
    assert quality.angle_deg == pytest.approx(np.degrees(np.arccos(1 / np.linalg.norm(TILTED))), abs=0.1)
    foot_z = z[order] - errors / length
    disparity = camera.intrinsics.fx * 0.018 * (1 / z[order] - 1 / foot_z)
    assert quality.subpixel_rms_px == pytest.approx(np.sqrt(np.mean(disparity**2)), rel=1e-6)
    # First principles: d(fb/z) = fb/z^2 dz, with the noise that was put in.
    assert quality.subpixel_rms_px == pytest.approx(camera.intrinsics.fx * 0.018 / 0.30**2 * 0.0005, rel=0.1)


def test_z_accuracy_is_signed_and_a_share_of_the_true_distance(rig):
    wall = counts(plane_depth(rig.proximity, (0, 0, 1), 0.306), rig.proximity)
    quality = camera_quality("proximity", [wall], rig.proximity, REGION, true_distance_m=0.300)
    assert quality.z_accuracy == pytest.approx(0.02, abs=1e-6)
    assert np.isnan(quality.subpixel_rms_px)


def test_the_fill_rate_counts_neither_zero_nor_65535():
    image = np.full((10, 10), 3000, np.uint16)
    image[0, :4], image[1, :3] = 0, 65535
    assert fill_rate(image) == pytest.approx(0.93)


def test_temporal_noise_is_the_noise_that_was_put_in():
    rng = np.random.default_rng(3)
    true = rng.uniform(2900, 3100, (50, 60))
    stack = np.rint(true + rng.normal(0, 20, (40, 50, 60))).astype(np.uint16)
    share, metres = temporal_noise(stack, 1e-4)
    std = stack.astype(np.float64).std(axis=0)
    assert share == pytest.approx(np.median(std / np.median(stack, axis=0)), rel=1e-5)
    assert metres == pytest.approx(np.median(std) * 1e-4, rel=1e-5)
    assert metres == pytest.approx(20e-4, rel=0.03)


def test_temporal_noise_leaves_out_missing_depths():
    rng = np.random.default_rng(4)
    stack = np.rint(40_000 + rng.normal(0, 30, (40, 20, 20))).astype(np.uint16)
    whole, _ = temporal_noise(stack, 1e-4)
    expected = [
        np.std(stack[5:, v, u].astype(float)) / np.median(stack[5:, v, u]) for v in range(20) for u in range(20)
    ]
    stack[:3], stack[3:5] = 0, 65535
    holed, _ = temporal_noise(stack, 1e-4)
    assert holed == pytest.approx(np.median(expected), rel=1e-5)
    assert holed == pytest.approx(whole, rel=0.1)
    stack[:, :15] = 0
    assert temporal_noise(stack, 1e-4)[0] == pytest.approx(holed, rel=0.3)
    assert np.isnan(temporal_noise(np.zeros((40, 5, 5), np.uint16), 1e-4)[0])


def test_the_bias_is_what_one_camera_reads_farther_on_the_same_wall(rig, make_frame):
    # The wall faces both cameras, which stand side by side at the same z.
    frame = make_frame(0.3045, 0.3000)
    bias = camera_bias([frame], rig, AlignmentSection(), REGION)
    assert bias.bias_m == pytest.approx(0.0045, abs=1e-6)
    assert bias.share == pytest.approx(0.0045 / 0.3045, rel=1e-3)
    corrected = camera_bias([frame], rig, AlignmentSection(depth_offset_m=0.0045), REGION)
    assert corrected.bias_m == pytest.approx(0.0, abs=1e-6)


def test_the_tactile_region_sees_the_same_part_of_a_wall(rig, make_frame):
    frame = make_frame(0.3, 0.3)
    left, top, width, height = tactile_region(frame, rig, AlignmentSection(), REGION)
    near, far = rig.proximity.intrinsics, rig.tactile.intrinsics
    first = (REGION[0] - near.cx) / near.fx * 0.3 - BASELINE_M
    assert left == pytest.approx(first / 0.3 * far.fx + far.cx, abs=0.6)
    assert top == pytest.approx((REGION[1] - near.cy) / near.fy * far.fy + far.cy, abs=0.6)
    assert width == pytest.approx(79 * far.fx / near.fx + 1, abs=1.0)
    assert height == pytest.approx(59 * far.fy / near.fy + 1, abs=1.0)


@pytest.mark.parametrize("region", [(-1, 0, 10, 10), (0, 0, 0, 10), (100, 0, 61, 10), (0, 0, WIDTH, HEIGHT + 1)])
def test_a_region_outside_the_image_is_refused(rig, make_frame, region):
    with pytest.raises(FrameError, match=r"the region .* does not lie within the proximity image"):
        measure_quality([make_frame(0.3, 0.3)], rig, AlignmentSection(), region)


def test_without_depth_nothing_is_claimed(rig, make_frame):
    quality = measure_quality([make_frame(0.0, 0.3)] * 6, rig, AlignmentSection(), REGION)
    assert quality.proximity.fill_rate == 0.0
    assert np.isnan(quality.proximity.plane_rms_m)
    assert quality.bias is None
    assert "no depth" in quality.bias_problem
    verdicts = {reading.title: reading.verdict for reading in judge_camera(quality.proximity)}
    assert verdicts == {"Fill rate": Verdict.POOR, "Plane fit": Verdict.UNKNOWN, "Temporal noise": Verdict.UNKNOWN}


def test_a_rig_without_pose_is_measured_without_a_bias(rig, make_frame):
    alone = rig.model_copy(update={"T_proximity_tactile": None})
    quality = measure_quality([make_frame(0.3, 0.3)], alone, AlignmentSection(), REGION)
    assert quality.tactile.region == REGION
    assert quality.bias is None
    reading = judge_bias(quality, Preset())
    assert reading.verdict is Verdict.UNKNOWN
    assert "calibrate" in reading.line


def test_words_say_the_number_what_is_good_and_the_next_step(rig, make_frame):
    rng = np.random.default_rng(5)
    shape = (HEIGHT, WIDTH)
    frames = [
        make_frame(0.300 + rng.normal(0, 0.0006, shape), 0.300 + rng.normal(0, 0.009, shape), index)
        for index in range(45)
    ]
    quality = measure_quality(frames, rig, AlignmentSection(), REGION)
    assert quality.tactile.frames == 40
    lines = [reading.line for reading in judge_camera(quality.proximity)]
    assert lines[0] == "Fill rate: 100.0 % – good (99 % or more)."
    assert lines[1].startswith("Plane fit RMS: 0.58 mm, 0.19 % of 300 mm")
    assert "– good" in lines[1]
    noise = judge_camera(quality.tactile)[-1]
    assert noise.verdict is Verdict.POOR
    assert "(good: below 1 % at this distance)" in noise.line
    assert noise.step
    assert "over 40 frames" in noise.value


def test_a_plane_that_far_pixels_turn_is_named_and_not_judged(rig):
    camera = rig.tactile
    wall = plane_depth(camera, (0, 0, 1), 0.30)
    flat = camera_quality("tactile", [counts(wall, camera)], camera, REGION)
    assert flat.stray_tilt_deg < 0.1 and judge_camera(flat)[1].verdict is Verdict.GOOD
    wall[30:46, 40:46] = 0.65  # 96 of 4,800 pixels, in a corner of the region
    turned = camera_quality("tactile", [counts(wall, camera)], camera, REGION)
    assert turned.stray_tilt_deg == pytest.approx(turned.angle_deg - flat.angle_deg, abs=0.1)
    reading = judge_camera(turned)[1]
    assert (reading.value, reading.verdict) == ("no flat surface", Verdict.UNKNOWN)
    assert f"turn the plane by {turned.stray_tilt_deg:.0f}°: make the region smaller" in reading.step


@pytest.mark.parametrize(("bias_m", "verdict"), [(0.001, Verdict.GOOD), (-0.005, Verdict.FAIR), (0.017, Verdict.POOR)])
def test_a_bias_is_judged_by_the_tolerance(rig, make_frame, bias_m, verdict):
    quality = measure_quality([make_frame(0.3 + bias_m, 0.3)], rig, AlignmentSection(), REGION)
    reading = judge_bias(quality, Preset(contact_test="tolerance"))
    assert reading.verdict is verdict
    assert ("proximity" if bias_m > 0 else "tactile") in reading.value
    if verdict is not Verdict.GOOD:
        assert f"{1e3 * bias_m:+.1f} mm".replace("-", "−") in reading.step


@pytest.mark.parametrize(
    ("bias_m", "corrected", "verdict", "limit"),
    [
        (0.017, True, Verdict.GOOD, "below 25 mm, what the test corrects"),
        (-0.024, True, Verdict.GOOD, "below 25 mm, what the test corrects"),
        (0.027, True, Verdict.POOR, "below 25 mm, what the test corrects"),
        (0.0004, False, Verdict.GOOD, "below 0.5 mm, as the bias is not corrected"),
        (-0.001, False, Verdict.FAIR, "below 0.5 mm, as the bias is not corrected"),
        (0.002, False, Verdict.POOR, "below 0.5 mm, as the bias is not corrected"),
    ],
)
def test_a_bias_is_judged_by_the_membrane_test(rig, make_frame, bias_m, corrected, verdict, limit):
    preset = Preset().with_values({"contact_test": "membrane", "membrane.bias": corrected})
    quality = measure_quality([make_frame(0.3 + bias_m, 0.3)], rig, AlignmentSection(), REGION)
    reading = judge_bias(quality, preset)
    assert (reading.verdict, reading.limit) == (verdict, limit)


@pytest.mark.parametrize("contact_test", ["tolerance", "membrane"])
@pytest.mark.parametrize("farther_m", [0.04, 0.1])
def test_two_surfaces_are_no_bias(rig, make_frame, contact_test, farther_m):
    steps = np.where(np.arange(WIDTH) % 20 < 10, 0.3, 0.3 + farther_m)
    quality = measure_quality([make_frame(steps, 0.3)], rig, AlignmentSection(), REGION)
    reading = judge_bias(quality, Preset(contact_test=contact_test))
    assert reading.verdict is Verdict.UNKNOWN
    assert "same surface" in reading.line


def test_baselines_by_model():
    assert stereo_baseline_m("Intel RealSense D405") == 0.018
    assert stereo_baseline_m("Intel RealSense L515") is None
    assert stereo_baseline_m("D499") is None
