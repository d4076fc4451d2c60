from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactune.core.bench.scenes import synthetic_scene
from tactune.core.errors import FrameError, RigMismatchError
from tactune.core.evaluation.metrics import pixel_scores
from tactune.core.methods.membrane_view import MembraneView
from tactune.core.methods.proximity_only import ProximityOnly
from tactune.core.methods.tactile_only import TactileOnly
from tactune.core.model.clouds import deproject
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset

BASELINE_M, RIM_M = 0.02, 0.25


def corrected(scale: float, offset_m: float) -> Preset:
    return Preset().with_values({"alignment.depth_scale": scale, "alignment.depth_offset_m": offset_m})


def inside(truth_depth, pixels: int = 6):
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

    def test_depth_scale_and_offset_are_applied(self, bulged):
        frame = bulged.frame(0.0)
        wrong = np.rint((frame.tactile_depth - 300.0) / 1.02).astype(np.uint16)
        wrong[frame.tactile_depth == 0] = 0
        found = MembraneView(corrected(1.02, 0.003).alignment, bulged.rig)
        sure = inside(frame.truth.depth_m)
        assert np.abs(found.depth_m(wrong) - frame.truth.depth_m)[sure].max() < 4e-4
        everywhere = np.ones(wrong.shape, bool)
        np.testing.assert_allclose(
            found.points(everywhere, wrong),
            MembraneView(Preset().alignment, bulged.rig).points(everywhere, frame.tactile_depth),
            atol=2e-5,
        )

    def test_points_lie_on_the_membrane(self, bulged):
        contact = 0.4 * bulged.radius_m
        counts = bulged.frame(contact).tactile_depth
        chosen = np.zeros(counts.shape, bool)
        chosen[100:140, 120:260] = True
        x, y, z = MembraneView(Preset().alignment, bulged.rig).points(chosen, counts).astype(float).T
        assert len(x) == np.count_nonzero(chosen & (counts > 0))
        r = np.hypot(x - BASELINE_M, y)
        np.testing.assert_allclose(z, RIM_M + bulged.height(r, contact), atol=1e-5)

    def test_a_tactile_mask_is_seen_from_the_proximity_camera(self, bulged):
        contact = 0.5 * bulged.radius_m
        frame = bulged.frame(contact)
        _, r = bulged.depth_m(bulged.rig.tactile.intrinsics, 0.0, contact)
        picked = MembraneView(Preset().alignment, bulged.rig).pick(r < contact, frame.tactile_depth)
        assert pixel_scores(picked, frame.truth.contact).iou > 0.97
        assert not MembraneView(Preset().alignment, bulged.rig).pick(r < 0, frame.tactile_depth).any()

    def test_no_depth_is_nowhere(self, bulged):
        counts = bulged.frame(0.0).tactile_depth.copy()
        counts[:] = 65535
        view = MembraneView(Preset().alignment, bulged.rig)
        assert np.isnan(view.depth_m(counts)).all()
        assert len(view.points(np.ones(counts.shape, bool), counts)) == 0

    def test_a_pose_is_needed(self, bulged):
        with pytest.raises(RigMismatchError, match="calibrate"):
            MembraneView(Preset().alignment, bulged.rig.model_copy(update={"T_proximity_tactile": None}))


class TestProximityOnly:
    def test_a_plate_through_the_untouched_frame_is_contact(self, bulged):
        untouched, frame = bulged.frame(0.0), bulged.frame(0.5 * bulged.radius_m)
        patch = ProximityOnly(Preset(), bulged.rig, untouched, margin_m=0.001).find(frame)
        depth = frame.proximity_depth * bulged.rig.proximity.depth_unit_m
        in_front = depth < untouched.truth.depth_m - 0.001
        assert in_front.sum() > 5000
        assert pixel_scores(patch.mask, in_front).iou > 0.99
        np.testing.assert_array_equal(
            patch.points, deproject(frame.proximity_depth, bulged.rig.proximity, np.flatnonzero(patch.mask))
        )
        assert patch.failure == ""

    def test_a_plate_behind_the_untouched_frame_is_not(self, bulged):
        method = ProximityOnly(Preset(), bulged.rig, bulged.frame(0.0))
        assert len(method.find(bulged.frame(0.5 * bulged.radius_m, gap_m=0.002)).points) == 0

    def test_the_margin_is_how_much_nearer_a_point_must_be(self, bulged):
        untouched = bulged.frame(0.0)
        nearer = untouched.truth.depth_m - 0.004
        counts = np.nan_to_num(nearer / bulged.rig.proximity.depth_unit_m).astype(np.uint16)
        frame = replace(untouched, proximity_depth=counts)
        sure = inside(untouched.truth.depth_m)
        assert ProximityOnly(Preset(), bulged.rig, untouched, margin_m=0.003).find(frame).mask[sure].all()
        assert not ProximityOnly(Preset(), bulged.rig, untouched, margin_m=0.005).find(frame).mask[sure].any()

    def test_pixels_without_depth_are_no_contact(self, bulged):
        method = ProximityOnly(Preset(), bulged.rig, bulged.frame(0.0))
        frame = bulged.frame(0.5 * bulged.radius_m)
        for nothing in (0, 65535):
            assert not method.find(
                replace(frame, proximity_depth=np.full_like(frame.proximity_depth, nothing))
            ).mask.any()

    def test_images_of_another_size_are_refused(self, bulged):
        method = ProximityOnly(Preset(), bulged.rig, bulged.frame(0.0))
        with pytest.raises(FrameError, match="640 x 480"):
            method.find(synthetic_scene(100).frame)


class TestTactileOnly:
    def test_the_share_of_the_most_deformed_points_is_contact(self, bulged):
        untouched, frame = bulged.frame(0.0), bulged.frame(0.5 * bulged.radius_m)
        dent = untouched.tactile_depth.astype(int) - frame.tactile_depth
        seen = (untouched.tactile_depth > 0) & (frame.tactile_depth > 0)
        deformed = seen & (dent > 150)
        for share in (0.3, 0.6, 1.0):
            method = TactileOnly(Preset(), bulged.rig, untouched, share=share, noise_m=0.001505)
            contact = method.contact(frame.tactile_depth)
            assert contact.sum() == pytest.approx(share * deformed.sum(), rel=0.01)
            assert dent[contact].min() >= dent[seen & ~contact].max()

    def test_the_threshold_is_absolute(self, bulged):
        untouched, frame = bulged.frame(0.0), bulged.frame(0.5 * bulged.radius_m)
        method = TactileOnly(Preset(), bulged.rig, untouched, rule="threshold", threshold_m=0.006)
        dent = (untouched.tactile_depth.astype(int) - frame.tactile_depth) * bulged.rig.tactile.depth_unit_m
        seen = (untouched.tactile_depth > 0) & (frame.tactile_depth > 0)
        sure = seen & (np.abs(dent - 0.006) > 1e-6)
        contact = method.contact(frame.tactile_depth)
        np.testing.assert_array_equal(contact[sure], (dent > 0.006)[sure])
        assert not contact[~seen].any()

    def test_points_and_mask_lie_on_the_dent(self, bulged):
        frame = bulged.frame(0.5 * bulged.radius_m)
        patch = TactileOnly(Preset(), bulged.rig, bulged.frame(0.0)).find(frame)
        x, y, z = patch.points.astype(float).T
        r = np.hypot(x - BASELINE_M, y)
        np.testing.assert_allclose(z, RIM_M + bulged.height(r, 0.5 * bulged.radius_m), atol=1e-4)
        scores = pixel_scores(patch.mask, frame.truth.contact)
        assert scores.precision > 0.95  # the most deformed are in the middle of the plate
        assert 0.5 < scores.recall < 0.8

    def test_nothing_is_deformed_in_the_untouched_frame(self, bulged):
        for rule in ("share", "threshold"):
            method = TactileOnly(Preset(), bulged.rig, bulged.frame(0.0), rule=rule)
            patch = method.find(bulged.frame(0.0, noise_m=0.0002, seed=3))
            assert len(patch.points) == 0
            assert not patch.mask.any()

    def test_depth_scale_counts_for_the_deformation(self, bulged):
        untouched, frame = bulged.frame(0.0), bulged.frame(0.5 * bulged.radius_m)
        plain = TactileOnly(Preset(), bulged.rig, untouched, rule="threshold", threshold_m=0.006)
        scaled = TactileOnly(corrected(1.2, 0.01), bulged.rig, untouched, rule="threshold", threshold_m=0.0072)
        differ = plain.contact(frame.tactile_depth) != scaled.contact(frame.tactile_depth)
        assert differ.mean() < 1e-3


@pytest.fixture(scope="module")
def other_untouched() -> SensorFrame:
    from tactune.core.sources.simulator.source import SimulatorSource

    return SimulatorSource(scene="cup", sensor="datasheet").read(1)


class TestOnTheSimulator:
    def test_proximity_only(self, cup_frames, other_untouched):
        rig, untouched, pressed = cup_frames
        method = ProximityOnly(Preset(), rig, untouched)
        scores = pixel_scores(method.find(pressed).mask, pressed.truth.contact)
        assert scores.recall > 0.9
        assert scores.precision > 0.15
        assert method.find(other_untouched).mask.mean() < 0.03

    def test_tactile_only(self, cup_frames, other_untouched):
        rig, untouched, pressed = cup_frames
        method = TactileOnly(Preset(), rig, untouched)
        scores = pixel_scores(method.find(pressed).mask, pressed.truth.contact)
        assert scores.recall > 0.9
        assert scores.precision > 0.15
        threshold = TactileOnly(Preset(), rig, untouched, rule="threshold")
        assert threshold.find(other_untouched).mask.mean() < 0.003


def test_the_synthetic_scene_is_its_own_untouched_frame():
    """The membrane of this scene never moves: only what the proximity camera sees may be contact."""
    scene = synthetic_scene(20_000)
    assert not TactileOnly(scene.preset, scene.rig, scene.frame).find(scene.frame).mask.any()
    view = MembraneView(scene.preset.alignment, scene.rig).depth_m(scene.frame.tactile_depth)
    truth = scene.frame.truth
    error = (view - truth.depth_m)[truth.contact]
    assert np.isfinite(error).mean() > 0.99
    assert abs(float(np.nanmean(error))) < 5e-5
    assert float(np.nanstd(error)) < 6e-4
