from dataclasses import replace

import numpy as np
import pytest

from tactune.core.errors import FrameError, TactuneError
from tactune.core.lab.bench import synthetic_scene
from tactune.core.lab.methods import make_method, method_names
from tactune.core.lab.single_camera import MembraneView, proximity_only, tactile_only
from tactune.core.model.clouds import deproject
from tactune.core.model.metrics import pixel_scores
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset

BASELINE_M, RIM_M = 0.02, 0.25


def inside(truth_depth, pixels=6):
    """Pixels that see the membrane, and so do all within some pixels."""
    import cv2

    seen = np.isfinite(truth_depth).astype(np.uint8)
    return cv2.erode(seen, np.ones((2 * pixels + 1,) * 2, np.uint8)).astype(bool)


class TestMembraneView:
    def test_depth_is_that_of_the_membrane_on_each_proximity_ray(self, bulged):
        frame = bulged.frame(0.4 * bulged.radius_m)
        found = MembraneView(Preset().alignment, bulged.rig).depth_m(frame.tactile_depth)
        sure = inside(frame.truth.depth_m)
        assert sure.sum() > 20_000
        assert np.isfinite(found[sure]).all()
        assert np.abs(found - frame.truth.depth_m)[sure].max() < 4e-4
        assert np.sqrt(np.mean((found - frame.truth.depth_m)[sure] ** 2)) < 1e-4
        far = ~np.isfinite(frame.truth.depth_m)
        assert np.isnan(found[~far]).mean() < 0.003
        assert np.isfinite(found[far]).sum() < 0.02 * far.sum()


class TestProximityOnly:
    def test_a_plate_through_the_untouched_frame_is_contact(self, bulged):
        untouched, frame = bulged.frame(0.0), bulged.frame(0.5 * bulged.radius_m)
        patch = proximity_only(Preset(), bulged.rig, untouched)(frame)
        depth = frame.proximity_depth * bulged.rig.proximity.depth_unit_m
        in_front = depth < untouched.truth.depth_m - 0.002
        assert in_front.sum() > 5000
        assert pixel_scores(patch.mask, in_front).iou > 0.98
        np.testing.assert_array_equal(
            patch.points, deproject(frame.proximity_depth, bulged.rig.proximity, np.flatnonzero(patch.mask))
        )

    def test_nothing_behind_the_untouched_frame_and_without_depth_is_contact(self, bulged):
        find = proximity_only(Preset(), bulged.rig, bulged.frame(0.0))
        assert len(find(bulged.frame(0.5 * bulged.radius_m, gap_m=0.002)).points) == 0
        frame = bulged.frame(0.5 * bulged.radius_m)
        assert not find(replace(frame, proximity_depth=np.zeros_like(frame.proximity_depth))).mask.any()
        with pytest.raises(FrameError, match="640 x 480"):
            find(synthetic_scene(100).frame)


class TestTactileOnly:
    def test_points_and_mask_lie_on_the_dent(self, bulged):
        frame = bulged.frame(0.5 * bulged.radius_m)
        patch = tactile_only(Preset(), bulged.rig, bulged.frame(0.0))(frame)
        x, y, z = patch.points.astype(float).T
        r = np.hypot(x - BASELINE_M, y)
        np.testing.assert_allclose(z, RIM_M + bulged.height(r, 0.5 * bulged.radius_m), atol=1e-4)
        scores = pixel_scores(patch.mask, frame.truth.contact)
        assert scores.precision > 0.95  # the most deformed are in the middle of the plate
        assert 0.5 < scores.recall < 0.8


def test_every_method_finds_the_cup(cup_frames):
    rig, untouched, pressed = cup_frames
    preset = load_preset("simulator")
    for name in method_names():
        patch = make_method(name, preset, rig, untouched)(pressed)
        assert pixel_scores(patch.mask, pressed.truth.contact).recall > 0.5, name
    with pytest.raises(TactuneError, match="untouched"):
        make_method("proximity-only", preset, rig)
    with pytest.raises(TactuneError, match="no method 'magic'"):
        make_method("magic", preset, rig)


class TestPressure:
    def test_a_plate_is_found_and_carries_the_inflation_times_its_area(self, bulged):
        """The plate carries p within the radius c and nothing else; both cameras' frames differ, the force does not."""
        radius_m = 0.5 * bulged.radius_m
        untouched, frame = bulged.frame(0.0), bulged.frame(radius_m)
        patch = make_method("pressure", Preset(), bulged.rig, untouched)(frame)
        assert pixel_scores(patch.mask, frame.truth.contact).iou > 0.65
        assert patch.pressure.force_mm2[2] == pytest.approx(-1e6 * np.pi * radius_m**2, rel=0.08)  # small slopes
        assert np.hypot(*patch.pressure.force_mm2[:2]) < 0.05 * 1e6 * np.pi * radius_m**2
