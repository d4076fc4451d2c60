"""The bias that the membrane test finds in a frame: in firm contact by itself, elsewhere only with the rig's."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from tactune.core.contact.alignment import make_alignment
from tactune.core.contact.kernels.chain import Region
from tactune.core.contact.masking import in_hsv_range
from tactune.core.contact.membrane.section import LARGEST_BIAS_M
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.contact.pixels import colors_at
from tactune.core.model.clouds import deproject
from tactune.core.model.metrics import pixel_scores
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.sensors import SENSORS
from tactune.core.sources.simulator.source import SimulatorSource

CELLS = (60, 36)
MEMBRANE = load_preset("simulator").with_values({"contact_test": "membrane", "alignment.model": "rigid"})


@cache
def cup(sensor, press="medium"):
    return SimulatorSource("cup", seed=1, cells=CELLS, variant=Variant(press=press), sensor=sensor)


@cache
def hovering(gap_mm, sensor):
    return SimulatorSource("cup", seed=1, cells=CELLS, variant=Variant(gap_mm=gap_mm), sensor=sensor)


def farther(frame, bias_m, unit_m):
    """Return a frame whose proximity camera reads farther by the bias, without its truth."""
    depth = frame.proximity_depth.astype(np.int32)
    moved = np.where((depth > 0) & (depth < 65535), depth + round(bias_m / unit_m), depth)
    return replace(frame, proximity_depth=moved.astype(np.uint16), truth=None)


def noise(bias_m, sigma_m=0.0003, origin="prints", white_m=0.001):
    """Return noise about as large as that of the data sheets, with a part that neighbouring pixels share."""
    camera = {
        "white_m": white_m, "correlated_m": white_m / 2, "length_px": 2.4, "changing_share": 1.0, "distance_m": 0.3,
    }  # fmt: skip
    return {
        "proximity": camera, "tactile": camera, "bias_m": bias_m, "bias_sigma_m": sigma_m, "bias_from": origin,
        "measured": "2026-01-02T03:04:05Z", "frames": 30,
    }  # fmt: skip


def found_bias_m(preset, frame, source):
    return ContactPipeline(preset, source.rig).process(frame).membrane.bias_m


def true_bias_m(frame, source):
    """Return the mean difference of both depths in true contact, which the slow errors of the sensors also shift."""
    alignment = make_alignment(MEMBRANE.alignment, source.rig)
    width, height = source.rig.proximity.intrinsics.width, source.rig.proximity.intrinsics.height
    aligned = alignment.align(frame.proximity_depth, frame.tactile_depth, Region(0, 0, width, height))
    difference = (aligned.expected_m - aligned.measured_m)[frame.truth.contact]
    return float(np.mean(difference[np.abs(difference) < 0.02]))


@pytest.mark.parametrize("bias_m", [-0.004, 0.017])
@pytest.mark.parametrize(
    ("sensor", "known"),
    [("clean", "not measured"), ("clean", "unknown"), ("clean", "contact"), ("datasheet", "not measured")],
)
def test_a_flat_bias_is_found_in_firm_contact(bias_m, known, sensor):
    source = cup(sensor)
    frame = source.read(0)
    moved = farther(frame, bias_m, source.rig.proximity.depth_unit_m)
    true_m = bias_m + true_bias_m(frame, source)
    rig = {"not measured": None, "unknown": noise(0.0, 0.005, "unknown"), "contact": noise(true_m, 0.0005, "contact")}
    preset = MEMBRANE.with_value("noise", rig[known])
    assert found_bias_m(preset, moved, source) == pytest.approx(true_m, abs=0.0003)
    mask = ContactPipeline(preset, source.rig).process(moved).mask
    unbiased = ContactPipeline(preset.with_value("noise", None), source.rig).process(replace(frame, truth=None)).mask
    assert pixel_scores(mask, frame.truth.contact).iou > pixel_scores(unbiased, frame.truth.contact).iou - 0.05


@pytest.mark.parametrize("bias_m", [-0.004, 0.004])
def test_small_contact_draws_an_unknown_bias_to_itself_and_does_not_prove_it(bias_m):
    source = cup("clean", "low")
    frame = source.read(0)
    v, u = np.nonzero(frame.truth.contact)
    contact_alone = (int(u.min()), int(v.min()), int(np.ptp(u)), int(np.ptp(v)))
    values = {"mask.enabled": False, "region.enabled": True, "region.rectangle": contact_alone}
    moved = farther(frame, bias_m, source.rig.proximity.depth_unit_m)
    found = ContactPipeline(MEMBRANE.with_values(values), source.rig).process(moved).membrane
    assert found.bias_m == pytest.approx(bias_m, abs=0.0004)
    assert found.firm_m2 == 0 and not found.bias_known


def test_a_rigs_bias_that_has_changed_is_replaced_in_firm_contact():
    source = cup("clean")
    moved = farther(source.read(0), 0.006, source.rig.proximity.depth_unit_m)
    preset = MEMBRANE.with_value("noise", noise(0.0, 0.0003))
    assert found_bias_m(preset, moved, source) == pytest.approx(0.006, abs=0.0005)


def test_large_contact_outweighs_a_measured_bias_that_is_a_little_off():
    source = cup("datasheet")
    frame = source.read(0)
    true_m = true_bias_m(frame, source)
    values = {"mask.enabled": False, "noise": noise(true_m + 0.0008, 0.0005, "contact")}
    assert found_bias_m(MEMBRANE.with_values(values), frame, source) == pytest.approx(true_m, abs=0.0002)


def test_a_bias_that_is_larger_than_any_is_taken_for_a_gap():
    source = cup("clean")
    for bias_m, touches in ((LARGEST_BIAS_M - 0.001, True), (LARGEST_BIAS_M + 0.001, False)):
        moved = farther(source.read(0), bias_m, source.rig.proximity.depth_unit_m)
        assert ContactPipeline(MEMBRANE, source.rig).process(moved).mask.any() == touches


def test_firm_contact_speaks_against_prints_that_tell_another_bias():
    source = cup("datasheet")
    frame, rig = source.read(0), source.rig
    pixels = np.flatnonzero(frame.proximity_depth)
    colors, seen = colors_at(
        deproject(frame.proximity_depth, rig.proximity, pixels), pixels, frame.proximity_color, rig
    )
    printed = np.zeros(frame.proximity_depth.shape, np.uint8)
    printed.flat[pixels] = seen & in_hsv_range(colors, MEMBRANE.mask)
    moved = farther(frame, 0.006, rig.proximity.depth_unit_m)
    but_prints = np.where(cv2.dilate(printed, np.ones((15, 15))), frame.proximity_depth, moved.proximity_depth)
    preset = MEMBRANE.with_value("noise", noise(0.003))
    for depth, agree in ((moved.proximity_depth, True), (but_prints, False)):
        found = ContactPipeline(preset, rig).process(replace(moved, proximity_depth=depth)).membrane
        assert found.bias_m == pytest.approx(0.0057, abs=0.0005)
        assert found.bias_seen == agree
        assert (found.bias_change_m > 0.001) == agree


@pytest.mark.parametrize("sensor", ["clean", "datasheet"])
def test_what_hovers_is_no_contact_where_the_bias_is_known(sensor):
    source = hovering(2.0, sensor)
    preset = MEMBRANE.with_value("noise", noise(SENSORS[sensor].tof_offset_m))
    for index in (0, 7):
        patch = ContactPipeline(preset, source.rig).process(source.read(index))
        assert not patch.mask.any()


def test_without_the_correction_the_depths_are_compared_as_they_are():
    source = cup("clean")
    preset = MEMBRANE.with_value("membrane.bias", False)
    pixels = []
    for bias_m in (0.0, 0.001, 0.002, 0.006):
        moved = farther(source.read(0), bias_m, source.rig.proximity.depth_unit_m)
        assert found_bias_m(preset, moved, source) == 0.0
        pixels.append(int(ContactPipeline(preset, source.rig).process(moved).mask.sum()))
    assert pixels == sorted(pixels, reverse=True)
    assert pixels[0] > 3000
    assert pixels[-1] == 0
