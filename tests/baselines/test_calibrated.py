from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactune.core.baselines.calibrated import CalibratedFusion, CalibratedSettings
from tactune.core.baselines.calibrated_steps import contact_bias_m, facing, local_mean, print_bias_m, retreat
from tactune.core.baselines.registry import make_method
from tactune.core.errors import FrameError, TactuneError
from tactune.core.evaluation.distances import separate_contacts
from tactune.core.evaluation.metrics import pixel_scores, symmetric_rmse_m, truth_cloud
from tactune.core.preset import Preset
from tactune.core.preset_file import load_preset
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.source import SimulatorSource

CELLS = (60, 36)


@pytest.fixture(scope="module")
def straight():
    """The paper's parameters with the simulator's mask."""
    return load_preset("default").model_copy(update={"mask": load_preset("simulator").mask})


@pytest.fixture(scope="module", params=["cup", "octopus"])
def pressed(request):
    source = SimulatorSource(request.param, cells=CELLS, variant=Variant(press="medium"))
    return source.rig, source.read(4)


def rmse_mm(points, frame, rig) -> float:
    return 1e3 * symmetric_rmse_m(points, truth_cloud(frame.truth, rig).points)


def test_at_most_a_third_of_the_straight_method_and_contacts_apart(pressed, straight):
    rig, frame = pressed
    ours = make_method("fusion-calibrated", straight, rig).find(frame)
    theirs = make_method("fusion-homography", straight, rig).find(frame)
    assert rmse_mm(ours.points, frame, rig) < rmse_mm(theirs.points, frame, rig) / 3
    assert separate_contacts(ours.mask) == separate_contacts(frame.truth.contact)
    assert pixel_scores(ours.mask, frame.truth.contact).iou > pixel_scores(theirs.mask, frame.truth.contact).iou
    assert len(ours.points) == np.count_nonzero(ours.mask)


def test_the_truth_is_not_read_and_nothing_is_remembered(pressed, straight):
    rig, frame = pressed
    method = CalibratedFusion(straight, rig)
    first = method.find(replace(frame, truth=None))
    method.find(replace(frame, tactile_depth=frame.tactile_depth[::-1].copy()))
    again = method.find(frame)
    np.testing.assert_array_equal(first.points, again.points)
    np.testing.assert_array_equal(first.mask, again.mask)


def test_without_noise_contact_is_found_more_exactly(straight):
    source = SimulatorSource("cup", noise=0.0, cells=CELLS, variant=Variant(press="medium"))
    frame = source.read(0)
    ours = CalibratedFusion(straight, source.rig).find(frame)
    theirs = make_method("fusion-homography", straight, source.rig).find(frame)
    assert rmse_mm(ours.points, frame, source.rig) < rmse_mm(theirs.points, frame, source.rig) / 2


@pytest.mark.parametrize("gap_mm", [4.0, 20.0])
def test_nothing_beside_the_membrane_is_contact(straight, gap_mm):
    source = SimulatorSource("hover", cells=CELLS, variant=Variant(object="cube", gap_mm=gap_mm))
    method = CalibratedFusion(straight, source.rig)
    for index in (0, 7):
        patch = method.find(source.read(index))
        assert patch.failure == ""
        assert patch.points.shape == (0, 3)
        assert not patch.mask.any()


class TestOnAPlate:
    """A flat plate on a circular membrane, whose true contact is known in closed form."""

    def test_contact_is_the_plate(self, bulged):
        frame = bulged.frame(0.5 * bulged.radius_m)
        patch = CalibratedFusion(Preset(), bulged.rig).find(frame)
        assert pixel_scores(patch.mask, frame.truth.contact).iou > 0.97
        z = patch.points[:, 2].astype(float)
        assert np.abs(z - np.median(z)).max() < 1e-4

    def test_a_bias_up_to_the_limit_does_no_harm(self, bulged):
        frame = bulged.frame(0.5 * bulged.radius_m)
        far = frame.proximity_depth + np.uint16(round(0.001 / bulged.rig.proximity.depth_unit_m))
        patch = CalibratedFusion(Preset(), bulged.rig).find(replace(frame, proximity_depth=far))
        assert pixel_scores(patch.mask, frame.truth.contact).iou > 0.97

    def test_region_and_range_count(self, bulged):
        frame = bulged.frame(0.5 * bulged.radius_m)
        left = {"region.enabled": True, "region.rectangle": (0, 0, 150, 240)}
        patch = CalibratedFusion(Preset().with_values(left), bulged.rig).find(frame)
        assert patch.mask[:, :150].any()
        assert not patch.mask[:, 155:].any()
        near = {"range.enabled": True, "range.limits_m": (0.1, 0.2)}
        assert not CalibratedFusion(Preset().with_values(near), bulged.rig).find(frame).mask.any()

    def test_images_without_depth_are_no_contact(self, bulged):
        frame = bulged.frame(0.5 * bulged.radius_m)
        method = CalibratedFusion(Preset(), bulged.rig)
        for nothing in (0, 65535):
            for image in ("proximity_depth", "tactile_depth"):
                assert not method.find(replace(frame, **{image: np.full_like(frame.tactile_depth, nothing)})).mask.any()

    def test_images_of_another_size_are_refused(self, bulged, pressed):
        with pytest.raises(FrameError, match="640 x 480"):
            CalibratedFusion(Preset(), bulged.rig).find(pressed[1])


class TestSteps:
    def test_the_mean_leaves_out_what_is_not_usable(self):
        usable = np.zeros((20, 20), bool)
        usable[:, :10] = True
        image = np.where(usable, 2.0, 1e6).astype(np.float32)
        mean, share = local_mean(image, usable, 2.0)
        np.testing.assert_allclose(mean[:, :11], 2.0, rtol=1e-5)
        assert share[10, 5] == pytest.approx(1.0)
        assert 0.5 < share[10, 9] < 0.7
        np.testing.assert_array_equal(local_mean(image, usable, 0.0)[0], image * usable)

    def test_the_slope_of_a_plane(self, bulged):
        camera = bulged.rig.proximity.intrinsics
        rays = camera.rays().astype(np.float32)
        for normal in ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.3, -0.5, 0.812)):
            depth = 0.3 / (rays @ np.array(normal[:2]) + normal[2])
            cosine = facing(depth.astype(np.float32), rays, (camera.fx, camera.fy))[100:140, 140:180]
            np.testing.assert_allclose(cosine, normal[2], atol=2e-3)

    def test_biases(self):
        rng = np.random.default_rng(1)
        gaps = np.concatenate([rng.normal(0.0007, 0.0003, 5000), rng.uniform(0, 0.004, 2000)]).astype(np.float32)
        assert contact_bias_m(gaps, 0.002) == pytest.approx(0.0007, abs=1.5e-4)
        assert abs(contact_bias_m(gaps, 0.0004)) <= 0.0004
        assert contact_bias_m(gaps[:50], 0.002) == 0.0
        assert print_bias_m(np.full(500, 0.0005, np.float32)) == pytest.approx(0.0005)
        assert print_bias_m(np.full(50, 0.0005, np.float32)) == 0.0

    def test_a_tangential_rim_is_taken_away_and_an_end_is_not(self):
        """A strip that ends to the left, and from column 60 on leaves with the gap growing by the square."""
        u = np.arange(120, dtype=np.float32)
        gap = np.tile(np.where(u > 60, 2e-5 * (u - 60) ** 2 / 2, 0), (80, 1)).astype(np.float32)
        known = np.tile(u >= 20, (80, 1))
        near = known & (gap < 0.0018)
        left = retreat(near, known, gap, 0.0018, 1.0, 1.0, 20.0)[40]
        assert np.flatnonzero(near[40])[-1] == 73
        assert abs(int(np.flatnonzero(left)[-1]) - 60) <= 2
        assert np.flatnonzero(left)[0] == 20


@pytest.mark.parametrize(("name", "value"), [("window_px", -1.0), ("core", 1.5), ("gap_m", float("nan"))])
def test_settings_that_make_no_sense_are_refused(name, value):
    with pytest.raises(TactuneError, match=f"{name} is"):
        CalibratedSettings(**{name: value})
