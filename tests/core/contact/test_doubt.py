"""The doubt of a patch: what makes it rise and fall, and what the test does where an assumption breaks."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.lab import faults
from tactune.core.model.metrics import pixel_scores
from tactune.core.model.patch import SURE
from tactune.core.output.cloud_files import patch_columns
from tactune.core.rig.noise import MIN_FRAMES, measure_noise
from tactune.core.rig.untouched import average_untouched
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.simulator_source import SimulatorSource
from tactune.core.tuning.advice.findings import Examiner

CELLS = (60, 36)
TOUCH, HOVER = Variant("medium"), Variant(gap_mm=4.0)


@pytest.fixture(scope="module")
def rig():
    """A preset with the measured rig, an untouched frame, a touch and a hover."""
    sources = [SimulatorSource("cup", cells=CELLS, variant=variant) for variant in (TOUCH, HOVER)]
    away = sources[0].with_object_away()
    frames = list(islice(away, MIN_FRAMES))
    preset = load_preset("simulator").with_value("mask.value", (110, 255))
    preset = preset.model_copy(update={"noise": measure_noise(frames, away.rig, preset)})
    return preset, average_untouched(frames).frame, *sources


def test_a_touch_that_dents_the_membrane_is_sure_and_one_that_does_not_is_doubted(rig):
    preset, untouched, touch, _ = rig
    frame = touch.read(0)
    doubt = ContactPipeline(preset, touch.rig, untouched).process(frame).doubt
    assert doubt.touch_probability > SURE
    assert doubt.reasons == ()
    assert 0 < doubt.boundary_error_mm < 10
    same = replace(untouched, tactile_depth=frame.tactile_depth)
    still = ContactPipeline(preset, touch.rig, same).process(frame)
    assert still.doubt.touch_probability < SURE
    assert still.doubt.reasons == ("no dent",)
    # bias and dent are known equally well, so a gap of 0 is as likely as a dent of 0
    assert still.contacts[0].doubt.touch_probability == pytest.approx(0.5, abs=0.06)


def test_a_wide_largest_gap_widens_the_error_is_found_and_mended(rig):
    preset, untouched, touch, _ = rig
    frame, wide = touch.read(0), preset.with_value("membrane.gap_m", 0.0015)
    fit, patch = (ContactPipeline(each, touch.rig, untouched).process(frame) for each in (preset, wide))
    added_mm = np.sqrt(patch.area_mm2 / np.pi) - np.sqrt(fit.area_mm2 / np.pi)
    assert added_mm > 3
    assert patch.doubt.boundary_error_mm > fit.doubt.boundary_error_mm + added_mm / 3
    found = {finding.name: finding for finding in Examiner(touch.rig).findings(frame, patch, wide)}
    assert found["wide_gap"].proposal.apply(wide).membrane == preset.membrane
    assert "wide_gap" not in {each.name for each in Examiner(touch.rig).findings(frame, fit, preset)}


def test_what_the_proximity_camera_saw_there_untouched_is_no_sure_contact(rig):
    """A smear hides the colour of the prints, which still reflect infrared."""
    preset, untouched, touch, hover = rig
    for source in (touch, hover):
        frame = source.read(0)
        smeared = replace(frame, proximity_color=np.full_like(frame.proximity_color, 128))
        patch = ContactPipeline(preset, source.rig, untouched).process(smeared)
        true = frame.truth.contact[patch.mask]
        false = [contact.doubt for contact in patch.contacts if not true[contact.members].any()]
        assert false
        assert all("print or dirt" in doubt.reasons and doubt.touch_probability < SURE for doubt in false)
        touching = [contact.doubt for contact in patch.contacts if true[contact.members].any()]
        assert all("print or dirt" not in doubt.reasons and doubt.touch_probability > SURE for doubt in touching)


@pytest.mark.parametrize("drift_m", [0.0015, -0.0015])
def test_prints_follow_a_bias_that_drifts_after_the_rig_was_measured(rig, drift_m):
    preset, untouched, *sources = rig
    for source in sources:
        sensor = source.sensor
        drifted = source.with_sensor(replace(sensor, tof_offset_m=sensor.tof_offset_m + drift_m)).read(0)
        pipeline = ContactPipeline(preset, source.rig, untouched)
        patch = pipeline.process(drifted)
        assert bool(len(patch.points)) == bool(source.scene.name.startswith("cup-medium"))
        if len(patch.points):
            change_m = patch.membrane.bias_change_m
            assert change_m == pytest.approx(drift_m, abs=0.0007) or change_m == 0.0
            found = {finding.name for finding in Examiner(source.rig).findings(drifted, patch, preset, untouched)}
            assert ("changed_bias" in found) == (change_m != 0.0)


def test_prints_are_found_again_in_half_of_the_light(rig):
    preset, untouched, touch, _ = rig
    frame = touch.read(0)
    dark = replace(frame, proximity_color=frame.proximity_color // 2)
    bright, relit, blind = (
        ContactPipeline(preset, touch.rig, known).process(each)
        for each, known in ((frame, untouched), (dark, untouched), (dark, None))
    )
    assert pixel_scores(relit.mask, bright.mask).iou > 0.97
    assert not blind.membrane.bias_seen
    assert relit.membrane.bias_seen


def test_prints_that_no_light_explains_are_said_to_be_gone(rig):
    preset, untouched, touch, _ = rig
    grey = replace(touch.read(0), proximity_color=np.full_like(touch.read(0).proximity_color, 128))
    patch = ContactPipeline(preset, touch.rig, untouched).process(grey)
    assert "prints gone from the mask" in patch.doubt.reasons
    found = Examiner(touch.rig).findings(grey, patch, preset, untouched)
    assert "lost_prints" in {finding.name for finding in found}


def test_every_point_and_record_carries_the_doubt_about_its_contact(rig):
    preset, untouched, touch, _ = rig
    frame = touch.read(0)
    patch = ContactPipeline(preset, touch.rig, untouched).process(frame)
    stated = patch_columns(patch, frame, touch.rig)["touch_probability"]
    assert sum(len(contact.members) for contact in patch.contacts) == len(patch.points)
    for contact in patch.contacts:
        np.testing.assert_allclose(stated[contact.members], contact.doubt.touch_probability, rtol=1e-6)
    assert patch.doubt.record().keys() == {"touch_probability", "boundary_error_mm", "doubt"}


def test_an_unknown_bias_is_a_reason_for_doubt(rig):
    preset, _, touch, _ = rig
    bare = preset.with_value("mask.enabled", False).model_copy(update={"noise": None})
    doubt = ContactPipeline(bare, touch.rig).process(touch.read(0)).doubt
    assert {"bias unknown", "no untouched frame"} <= set(doubt.reasons)
    assert doubt.touch_probability < SURE


@pytest.mark.parametrize("bias_m", [0.012, -0.012])
def test_a_measured_bias_that_the_contact_test_does_not_correct_is_a_reason_for_doubt(rig, bias_m):
    preset, _, touch, _ = rig
    noise = preset.noise.model_copy(update={"bias_m": bias_m, "bias_from": "contact"})
    tolerance = preset.with_value("contact_test", "tolerance").model_copy(update={"noise": noise})
    assert "bias not corrected" in ContactPipeline(tolerance, touch.rig).process(touch.read(0)).doubt.reasons


def test_what_the_tolerance_lets_pass_is_sure_only_where_it_dents_the_membrane(rig):
    preset, untouched, touch, hover = rig
    noise = preset.noise.model_copy(update={"bias_m": 0.0, "bias_sigma_m": 0.0, "bias_from": "contact"})
    tolerance = preset.with_value("contact_test", "tolerance").with_value("tolerance.t", 0.03)
    sure = [
        ContactPipeline(tolerance.model_copy(update={"noise": noise}), source.rig, before).process(source.read(0)).doubt
        for source, before in ((touch, untouched), (touch, None), (hover, untouched), (hover, None))
    ]
    assert [doubt.touch_probability > SURE for doubt in sure] == [True, False, False, False]


def test_a_hole_in_an_eighth_of_the_contact_is_said(rig):
    preset, untouched, touch, _ = rig
    frame = touch.read(0)
    rows, columns = np.nonzero(frame.truth.contact)
    v, u = np.indices(frame.truth.contact.shape)
    depth = frame.proximity_depth.copy()
    depth[np.hypot(v - np.median(rows), u - np.median(columns)) < np.sqrt(len(rows) / 8 / np.pi)] = 0
    patch = ContactPipeline(preset, touch.rig, untouched).process(replace(frame, proximity_depth=depth))
    assert patch.doubt.reasons == ("too little depth",)


def test_what_moves_everywhere_is_no_dent(rig):
    """Another inflation brings the whole membrane nearer; a touch there must still dent it."""
    preset, untouched, touch, _ = rig
    frame = touch.read(0)
    farther = np.where(frame.tactile_depth > 0, frame.tactile_depth + 15, 0).astype(np.uint16)
    before = replace(untouched, tactile_depth=farther)
    assert "no dent" in ContactPipeline(preset, touch.rig, before).process(frame).doubt.reasons
    before = replace(untouched, tactile_depth=np.where(farther > 0, farther + 600, 0).astype(np.uint16))
    moved, alone = (ContactPipeline(preset, touch.rig, each).process(frame).doubt for each in (before, None))
    assert moved.touch_probability == pytest.approx(alone.touch_probability, abs=0.01), "it tells nothing"


@pytest.mark.parametrize(
    ("scene", "gap_mm", "reason"), [("cube", 1.5, "smaller than the error of its boundary"), ("cup", 0.5, "no dent")]
)
def test_a_hover_that_noise_or_the_error_of_the_bias_hides_is_claimed_only_with_doubt(scene, gap_mm, reason):
    source = SimulatorSource(scene, 1, cells=CELLS, variant=Variant(gap_mm=gap_mm), sensor="worn")
    away = source.with_object_away()
    frames = list(islice(away, MIN_FRAMES))
    preset = load_preset("simulator").with_value("mask.value", (110, 255))
    preset = preset.model_copy(update={"noise": measure_noise(frames, away.rig, preset)})
    pipeline = ContactPipeline(preset, source.rig, average_untouched(frames).frame)
    claimed = [patch.doubt for patch in map(pipeline.process, islice(source, 6)) if len(patch.points)]
    assert claimed
    for doubt in claimed:
        assert doubt.touch_probability < SURE
        assert reason in doubt.reasons


def test_contact_that_only_a_larger_bias_shows_is_found_where_there_is_a_dent():
    source = open_source("sim:cup?sensor=heavy&seed=0")
    frames, frame = list(islice(source.with_object_away(), MIN_FRAMES)), source.read(81)
    preset = load_preset("simulator")
    preset = preset.model_copy(update={"noise": measure_noise(frames, source.rig, preset)})
    rests = average_untouched(frames).frame, frame, None  # against the second there is no dent
    found, level, unknown = (ContactPipeline(preset, source.rig, rest).process(frame).mask for rest in rests)
    assert np.count_nonzero(found & ~unknown & frame.truth.contact) > 200
    assert (level == unknown).all()


def test_the_table_of_faults_counts_what_is_wrong_without_a_word(monkeypatch):
    chosen = [faults.Trial("cup", variant, 0) for variant in (TOUCH, HOVER)]
    monkeypatch.setattr(faults, "trials", lambda *_: chosen)
    monkeypatch.setattr(faults, "_CELLS", CELLS)
    monkeypatch.setattr(faults, "_FRAMES", MIN_FRAMES)
    monkeypatch.setattr(faults, "FAULTS", {name: faults.FAULTS[name] for name in ("none", "no-prints")})
    (touch, hover), _ = found = list(faults.try_faults(load_preset("simulator")))
    assert touch.claimed
    assert touch.error_mm < 4
    assert not hover.claimed
    wrong = replace(touch, error_mm=9.0, probability=1.0, stated_mm=0.5)
    silent, line = (faults.faults_text([*found[0], extra]).splitlines()[1].split() for extra in (wrong, touch))
    assert int(silent[-1]) == int(line[-1]) + 1
