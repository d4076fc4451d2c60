"""The membrane test on simulated presses, on images with little in them, and with the bias that it finds in a frame."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from rigs import one_place_rig
from tactune.core.contact.alignment import make_alignment
from tactune.core.contact.kernels.threads import set_threads
from tactune.core.contact.kernels.tolerance import Region
from tactune.core.contact.masking import in_hsv_range
from tactune.core.contact.membrane.frame_bias import FIRM_M2
from tactune.core.contact.membrane.section import LARGEST_BIAS_M
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.contact.pixels import colors_at
from tactune.core.model.clouds import deproject, truth_points
from tactune.core.model.frames import SensorFrame
from tactune.core.model.metrics import pixel_scores, symmetric_rmse_m
from tactune.core.model.patch import Provenance
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.sensors import SENSORS
from tactune.core.sources.simulator.simulator_source import SimulatorSource

CELLS = (60, 36)
SIMULATOR = load_preset("simulator").with_value("alignment.model", "rigid")
MEMBRANE, TOLERANCE = (SIMULATOR.with_value("contact_test", name) for name in ("membrane", "tolerance"))
UNIT_M = 1e-5


@pytest.mark.parametrize("sensor", ["datasheet", "wide"])
def test_the_error_is_hardly_above_that_of_the_best_tolerance(sensor):
    """The best t of each scene is chosen with its truth, which no user has."""
    source = SimulatorSource("cup", seed=1, variant=Variant(press="medium"), sensor=sensor)
    frame = source.read(0)
    seen, truth = replace(frame, truth=None), truth_points(frame.truth, source.rig)
    ours = symmetric_rmse_m(ContactPipeline(MEMBRANE, source.rig).process(seen).points, truth)
    pipeline, best = ContactPipeline(TOLERANCE, source.rig), np.inf
    for t in (0.002, 0.004, 0.006, 0.008, 0.011, 0.016, 0.03):
        pipeline.update(TOLERANCE.with_value("tolerance.t", t))
        points = pipeline.process(seen).points
        best = min(best, symmetric_rmse_m(points, truth)) if len(points) else best
    assert ours < 1.05 * best
    assert best < 0.01


def test_wrong_tactile_depth_in_places_less_than_doubles_the_error():
    """Squares of 8 pixels on 5 % of the tactile image are off by up to a fifth of their distance."""
    source = SimulatorSource("cup", seed=1, variant=Variant(press="medium"), sensor="l515-d405")
    frame, rng = source.read(0), np.random.default_rng(0)
    spoiled, (height, width) = frame.tactile_depth.copy(), frame.tactile_depth.shape
    for _ in range(height * width // 64 // 20):
        v, u = rng.integers(0, (height - 8, width - 8))
        square = spoiled[v : v + 8, u : u + 8]
        square[:] = square * rng.uniform(0.8, 1.2)
    truth, pipeline = truth_points(frame.truth, source.rig), ContactPipeline(MEMBRANE, source.rig)
    patches = map(pipeline.process, (frame, replace(frame, tactile_depth=spoiled)))
    clean, spoilt = (symmetric_rmse_m(patch.points, truth) for patch in patches)
    assert spoilt < 2 * clean


@pytest.mark.parametrize(
    "hidden",
    [lambda v, u: u % 4 == 0, lambda v, u: (u + v) % 2 == 0, lambda v, u: (u + v) % 3 > 0],
    ids=["every fourth column", "a chessboard", "two of three"],
)
def test_depth_that_is_missing_in_a_pattern_does_not_hide_firm_contact(hidden):
    source = SimulatorSource("cup", cells=CELLS, variant=Variant(press="high"))
    frame, pipeline = source.read(0), ContactPipeline(MEMBRANE, source.rig)
    whole = len(pipeline.process(frame).points)
    depth = np.where(hidden(*np.indices(frame.proximity_depth.shape)), 0, frame.proximity_depth).astype(np.uint16)
    patch = pipeline.process(replace(frame, proximity_depth=depth))
    assert len(patch.points) > 0.9 * whole
    assert patch.membrane.firm_m2 > 2 * FIRM_M2, "a third of its area has depth, and tells the bias"


def disc(width=200, height=120, radius_px=30.0, lift_m=0.0):
    """A flat membrane and an object that leaves it by the square of the way beyond a disc."""
    v, u = np.mgrid[:height, :width]
    r = np.hypot(u - width // 2, v - height // 2)
    gap = np.where(r < radius_px, 0.0, 3e-5 * (r - radius_px) ** 2) + lift_m
    proximity = np.rint((0.3 + np.minimum(gap, 0.1)) / UNIT_M).astype(np.uint16)
    tactile = np.full((height, width), round(0.3 / UNIT_M), np.uint16)
    return SensorFrame(0, proximity, tactile, np.zeros((height, width, 3), np.uint8))


PLAIN = Preset().with_values({"contact_test": "membrane", "membrane.min_area_mm2": 0.0})


@pytest.mark.parametrize("count", [0, 65535])
def test_a_pixel_without_depth_does_not_enlarge_a_contact(count):
    """65535 counts would be an area of 2980 mm2 at the 16 m that they stand for."""
    unit_m, rig, frame = 0.00025, one_place_rig(200, 120, 300.0, UNIT_M, UNIT_M), disc(radius_px=6.0)
    rig = rig.model_copy(update={"proximity": rig.proximity.model_copy(update={"depth_unit_m": unit_m})})
    depth = np.rint(frame.proximity_depth * (UNIT_M / unit_m)).astype(np.uint16)
    depth[60, 100] = count
    frame = replace(frame, proximity_depth=depth)
    assert 100 < ContactPipeline(PLAIN, rig).process(frame).area_mm2 < 300
    assert not ContactPipeline(PLAIN.with_value("membrane.min_area_mm2", 400.0), rig).process(frame).mask.any()


@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize(
    ("proximity", "tactile"), [(0, None), (65535, None), (None, 0), (None, 65535), (0, 0), (65535, 65535)]
)
def test_images_without_depth_have_no_contact(bias, proximity, tactile):
    rig, frame = one_place_rig(200, 120, 300.0, UNIT_M, UNIT_M), disc()
    images = {
        name: np.full_like(getattr(frame, name), value)
        for name, value in (("proximity_depth", proximity), ("tactile_depth", tactile))
        if value is not None
    }
    patch = ContactPipeline(PLAIN.with_value("membrane.bias", bias), rig).process(replace(frame, **images))
    assert patch.points.shape == (0, 3)
    assert not patch.mask.any()
    assert patch.skipped == ("no candidates",)
    wanted = Provenance.NO_PROXIMITY_DEPTH if proximity is not None else Provenance.NO_TACTILE_DEPTH
    assert set(np.unique(patch.provenance)) == {wanted}


def test_one_and_four_threads_and_a_used_pipeline_give_the_same_bits():
    source = SimulatorSource("cup", seed=1, cells=CELLS, variant=Variant(press="medium"), sensor="datasheet")
    first, second = (replace(source.read(index), truth=None) for index in (0, 1))

    def patches(threads):
        set_threads(threads)
        pipeline = ContactPipeline(MEMBRANE, source.rig)
        found = [pipeline.process(second), pipeline.process(first)]
        pipeline.update(MEMBRANE.with_values({"membrane.gap_m": 0.0004, "membrane.trust_m": 0.03}))
        pipeline.process(first)
        pipeline.update(MEMBRANE)
        found += [pipeline.process(first), ContactPipeline(MEMBRANE, source.rig).process(first)]
        return [patch.points.tobytes() + patch.mask.tobytes() + patch.provenance.tobytes() for patch in found]

    with ThreadPoolExecutor(1) as pool:  # whose thread keeps the setting to itself
        one, four = (pool.submit(patches, threads).result() for threads in (1, 4))
    assert one == four
    assert one[1] == one[2] == one[3]
    assert one[0] != one[1]


def test_the_gap_is_zero_in_contact_and_grows_outside_its_edge():
    preset = load_preset("simulator")
    with open_source("sim:cup?press=medium") as source:
        frame, rig = source.next_frame(), source.rig
    patch = ContactPipeline(preset, rig).process(frame)
    gap = patch.membrane.gap_m.get()
    assert gap.shape == frame.proximity_depth.shape
    assert np.nanmax(gap[patch.mask]) <= preset.membrane.gap_m
    rim = gap[patch.provenance == Provenance.RIM]
    assert np.nanmedian(rim) > 4 * preset.membrane.gap_m
    assert np.isnan(gap[patch.provenance == Provenance.OUTSIDE_REGION]).all()
    assert np.isnan(gap[:5]).all()  # far from the object
    assert patch.membrane.firm_m2 > 0.001


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
