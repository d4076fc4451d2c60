"""The membrane test on simulated presses, and on images with little or nothing in them."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from rigs import one_place_rig
from tactune.core.contact.kernels.threads import set_threads
from tactune.core.contact.membrane.bias import FIRM_M2
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.model.clouds import truth_points
from tactune.core.model.frames import SensorFrame
from tactune.core.model.metrics import symmetric_rmse_m
from tactune.core.model.patch import Provenance
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.source import SimulatorSource

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
