"""Depth quality on planes with known noise, against NumPy."""

import numpy as np
import pytest

from side_by_side import BASELINE_M, HEIGHT, WIDTH, counts, plane_depth
from tactune.core.errors import FrameError
from tactune.core.preset import Preset
from tactune.core.rig.quality import Verdict, measure_quality

REGION = (40, 30, 80, 60)
TILTED = (0.15, -0.08, 1.0)


def test_a_tilted_wall_with_noise_gives_its_plane_and_its_noise(rig, make_frame):
    camera = rig.proximity
    depth = plane_depth(camera, TILTED, 0.30)
    noisy = depth + np.random.default_rng(2).normal(0, 0.0005, depth.shape)
    quality, _ = measure_quality(make_frame(noisy, 0.3), rig, Preset(), REGION)

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


def test_the_fill_rate_counts_neither_zero_nor_65535(rig, make_frame):
    depth_m = np.full((HEIGHT, WIDTH), 0.3)
    depth_m[30:36, 40:120], depth_m[36:42, 40:120] = 0.0, 65535 * rig.proximity.depth_unit_m
    frame = make_frame(depth_m, 0.3)
    assert measure_quality(frame, rig, Preset(), REGION)[0].fill_rate == pytest.approx(0.8)


def test_the_tactile_region_sees_the_same_part_of_a_wall(rig, make_frame):
    left, top, width, height = measure_quality(make_frame(0.3, 0.3), rig, Preset(), REGION)[1].region
    near, far = rig.proximity.intrinsics, rig.tactile.intrinsics
    first = (REGION[0] - near.cx) / near.fx * 0.3 - BASELINE_M
    assert left == pytest.approx(first / 0.3 * far.fx + far.cx, abs=0.6)
    assert top == pytest.approx((REGION[1] - near.cy) / near.fy * far.fy + far.cy, abs=0.6)
    assert width == pytest.approx(79 * far.fx / near.fx + 1, abs=1.0)
    assert height == pytest.approx(59 * far.fy / near.fy + 1, abs=1.0)


@pytest.mark.parametrize("region", [(-1, 0, 10, 10), (0, 0, 0, 10), (100, 0, 61, 10), (0, 0, WIDTH, HEIGHT + 1)])
def test_a_region_outside_the_image_is_refused(rig, make_frame, region):
    with pytest.raises(FrameError, match="within the proximity image"):
        measure_quality(make_frame(0.3, 0.3), rig, Preset(), region)


def test_what_is_unknown_is_not_claimed(rig, make_frame):
    blind, _ = measure_quality(make_frame(0.0, 0.3), rig, Preset(), REGION)
    verdicts = {reading.title: reading.verdict for reading in blind.readings()}
    assert verdicts == {"Fill rate": Verdict.POOR, "Plane fit": Verdict.UNKNOWN}
