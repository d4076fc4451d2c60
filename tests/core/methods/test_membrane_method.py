from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactune.core.errors import FrameError
from tactune.core.evaluation.metrics import pixel_scores, separate_contacts, symmetric_rmse_m, truth_cloud
from tactune.core.methods.registry import make_method
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.source import SimulatorSource

CELLS = (60, 36)


@pytest.fixture(scope="module")
def straight():
    """The paper's parameters with the simulator's mask."""
    return load_preset("default").model_copy(update={"mask": load_preset("simulator").mask})


@pytest.fixture(scope="module", params=["cup", "octopus"])
def pressed(request):
    source = SimulatorSource(request.param, cells=CELLS, variant=Variant(press="medium"), sensor="datasheet")
    return source.rig, source.read(4)


def membrane(preset, rig):
    return make_method("fusion-membrane", preset, rig)


def rmse_mm(points, frame, rig) -> float:
    return 1e3 * symmetric_rmse_m(points, truth_cloud(frame.truth, rig).points)


def test_at_most_half_of_the_straight_methods_error(pressed, straight):
    rig, frame = pressed
    ours = make_method("fusion-membrane", straight, rig).find(frame)
    theirs = make_method("fusion-homography", straight, rig).find(frame)
    assert rmse_mm(ours.points, frame, rig) < rmse_mm(theirs.points, frame, rig) / 2
    assert pixel_scores(ours.mask, frame.truth.contact).iou > pixel_scores(theirs.mask, frame.truth.contact).iou
    assert len(ours.points) == np.count_nonzero(ours.mask)


def test_the_cups_two_contacts_are_told_apart(straight):
    source = SimulatorSource("cup", cells=CELLS, variant=Variant(press="medium"), sensor="datasheet")
    frame = source.read(4)
    ours = make_method("fusion-membrane", straight, source.rig).find(frame)
    assert separate_contacts(ours.mask) == separate_contacts(frame.truth.contact) == 2


def test_the_truth_is_not_read_and_nothing_is_remembered(pressed, straight):
    rig, frame = pressed
    method = membrane(straight, rig)
    first = method.find(replace(frame, truth=None))
    method.find(replace(frame, tactile_depth=frame.tactile_depth[::-1].copy()))
    again = method.find(frame)
    np.testing.assert_array_equal(first.points, again.points)
    np.testing.assert_array_equal(first.mask, again.mask)


def test_without_noise_contact_is_found_more_exactly(straight):
    source = SimulatorSource("cup", noise=0.0, cells=CELLS, variant=Variant(press="medium"), sensor="datasheet")
    frame = source.read(0)
    ours = membrane(straight, source.rig).find(frame)
    theirs = make_method("fusion-homography", straight, source.rig).find(frame)
    assert rmse_mm(ours.points, frame, source.rig) < rmse_mm(theirs.points, frame, source.rig) / 2


@pytest.mark.parametrize("gap_mm", [4.0, 20.0])
def test_nothing_beside_the_membrane_is_contact(straight, gap_mm):
    source = SimulatorSource("hover", cells=CELLS, variant=Variant(object="cube", gap_mm=gap_mm), sensor="datasheet")
    method = membrane(straight, source.rig)
    for index in (0, 7):
        patch = method.find(source.read(index))
        assert patch.failure == ""
        assert patch.points.shape == (0, 3)
        assert not patch.mask.any()


class TestOnAPlate:
    """A flat plate on a circular membrane, whose true contact is known in closed form."""

    def test_contact_is_the_plate(self, bulged):
        frame = bulged.frame(0.5 * bulged.radius_m)
        patch = membrane(Preset(), bulged.rig).find(frame)
        assert pixel_scores(patch.mask, frame.truth.contact).iou > 0.97
        z = patch.points[:, 2].astype(float)
        assert np.abs(z - np.median(z)).max() < 1e-4

    def test_a_bias_up_to_the_limit_does_no_harm(self, bulged):
        frame = bulged.frame(0.5 * bulged.radius_m)
        far = frame.proximity_depth + np.uint16(round(0.001 / bulged.rig.proximity.depth_unit_m))
        patch = membrane(Preset(), bulged.rig).find(replace(frame, proximity_depth=far))
        assert pixel_scores(patch.mask, frame.truth.contact).iou > 0.97

    def test_region_and_range_count(self, bulged):
        frame = bulged.frame(0.5 * bulged.radius_m)
        left = {"region.enabled": True, "region.rectangle": (0, 0, 150, 240)}
        patch = membrane(Preset().with_values(left), bulged.rig).find(frame)
        assert patch.mask[:, :150].any()
        assert not patch.mask[:, 155:].any()
        near = {"range.enabled": True, "range.limits_m": (0.1, 0.2)}
        assert not membrane(Preset().with_values(near), bulged.rig).find(frame).mask.any()

    def test_images_without_depth_are_no_contact(self, bulged):
        frame = bulged.frame(0.5 * bulged.radius_m)
        method = membrane(Preset(), bulged.rig)
        for nothing in (0, 65535):
            for image in ("proximity_depth", "tactile_depth"):
                assert not method.find(replace(frame, **{image: np.full_like(frame.tactile_depth, nothing)})).mask.any()

    def test_images_of_another_size_are_refused(self, bulged, pressed):
        with pytest.raises(FrameError, match="640 x 480"):
            membrane(Preset(), bulged.rig).find(pressed[1])
