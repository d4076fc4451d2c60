"""Curves of missed and false contact, and the fields that follow from examples or from noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import AdviceError
from tactune.core.model.clouds import pixel_areas_m2
from tactune.core.model.metrics import compare_with_truth
from tactune.core.sources.presets import load_preset
from tactune.core.tuning.advice.fields import TRIED, error_curve
from tactune.core.tuning.advice.proposal import Example
from tactune.core.tuning.advice.suggest import suggest

SHIPPED = load_preset("simulator")
TOLERANCE = SHIPPED.with_value("contact_test", "tolerance")
PATHS = [path for fields in TRIED.values() for path in fields]


def test_a_larger_tolerance_misses_less_and_invents_more(evidence):
    plain = TOLERANCE.with_values({"outliers.enabled": False, "outliers.min_cluster_area_mm2": 0.0})
    curve = error_curve("tolerance.t", evidence(plain, painted=True))
    assert (np.diff(curve.values) > 0).all()
    assert (np.diff(curve.missed_mm2) <= 0).all() and curve.missed_mm2[0] > 2 * curve.missed_mm2[-1]
    assert (np.diff(curve.false_mm2) >= 0).all() and curve.false_mm2[-1] > 100
    assert plain.tolerance.t in curve.values


@pytest.mark.parametrize("path", PATHS)
def test_the_proposed_value_is_nearly_the_best(evidence, path):
    curve = error_curve(path, evidence(TOLERANCE, painted=True))
    error = curve.error[curve.values == curve.proposed]
    assert error.size == 1
    assert error[0] <= curve.error.min() + 0.01
    assert TOLERANCE.value(path) in curve.values


def test_finding_nothing_is_never_the_best(evidence):
    # much more false contact than contact, whatever t is
    shown = evidence(TOLERANCE, "sim:octopus?press=medium&sensor=heavy", painted=True)
    curve = error_curve("tolerance.t", shown)
    proposed = curve.values == curve.proposed
    contact_mm2 = curve.missed_mm2.max()  # nothing is found
    assert curve.missed_mm2[proposed] < 0.6 * contact_mm2
    assert (curve.missed_mm2 + curve.false_mm2)[proposed] > (curve.missed_mm2 + curve.false_mm2).min()


def test_areas_are_those_of_the_patch(evidence):
    shown = evidence(TOLERANCE, untouched=False, painted=True)
    frame, rig = shown.examples[0].frame, shown.rig
    found, contact = ContactPipeline(TOLERANCE, rig).process(frame).mask, frame.truth.contact
    areas = 1e6 * pixel_areas_m2(
        frame.proximity_depth * np.float32(rig.proximity.depth_unit_m), rig.proximity.intrinsics
    )
    missed, false = error_curve("tolerance.t", shown).at(TOLERANCE.tolerance.t)
    assert false == pytest.approx(areas[found & ~contact].sum(), rel=1e-6)
    seen = contact & (frame.proximity_depth > 0)
    assert missed == pytest.approx(areas[seen & ~found].sum(), rel=0.03)


def test_only_known_pixels_count(evidence):
    shown = evidence(TOLERANCE, untouched=False, painted=True)
    contact = shown.examples[0].contact
    inside = replace(shown, examples=(Example(shown.examples[0].frame, contact, known=contact),))
    curve = error_curve("tolerance.t", inside)
    assert not curve.false_mm2.any() and curve.missed_mm2.any()


def test_equal_errors_keep_the_present_value(evidence):
    # nothing is painted, so no value of the largest gap misses or invents anything
    curve = error_curve("membrane.gap_m", evidence(SHIPPED.with_value("membrane.gap_m", 0.0003)))
    assert not curve.error.any()
    assert curve.proposed == 0.0003


def test_a_patch_that_covers_more_but_invents_contact_far_away_is_not_proposed(evidence):
    shown = evidence(TOLERANCE, painted=True)
    frame, rig = shown.examples[0].frame, shown.rig
    curve = error_curve("tolerance.t", shown)
    [covers_most] = curve.values[curve.error == curve.error.min()]
    rmse = []
    for t in (TOLERANCE.tolerance.t, curve.proposed, covers_most):
        patch = ContactPipeline(TOLERANCE.with_value("tolerance.t", t), rig).process(frame)
        rmse.append(compare_with_truth(patch, frame.truth, rig)["rmse_mm"])
    assert rmse[1] <= 1.02 * rmse[0] < rmse[2]


@pytest.mark.parametrize(
    ("section", "bad"),
    [
        ("tolerance", {"tolerance.t": 0.05}),
        ("outliers", {"outliers.min_cluster_area_mm2": 9000.0}),
        ("membrane", {"contact_test": "membrane", "membrane.gap_m": 0.003, "membrane.trust_m": 0.1}),
    ],
)
def test_examples_lower_the_error(evidence, section, bad):
    preset = TOLERANCE.with_values(bad)
    shown = evidence(preset, painted=True)
    proposal = suggest(section, shown)
    path = next(iter(TRIED[section]))
    before, after = (
        sum(error_curve(path, replace(shown, preset=each)).at(each.value(path)))
        for each in (preset, proposal.apply(preset))
    )
    assert after < 0.9 * before
    assert not proposal.weak
    assert f"{after:.0f} mm²" in proposal.evidence


def test_without_contact_t_follows_from_the_noise_and_is_weak(evidence):
    found = {
        sensor: suggest("tolerance", evidence(TOLERANCE, f"sim:cup?press=medium&sensor={sensor}"))
        for sensor in ("datasheet", "heavy")
    }
    assert all(proposal.weak and "weaker" in proposal.evidence for proposal in found.values())
    small, large = (found[sensor].apply(TOLERANCE).tolerance.t for sensor in ("datasheet", "heavy"))
    # datasheet: 1.15 mm of noise, heavy: 2.4 mm, at 285 mm distance
    assert small == pytest.approx(2 * 1.15 / 285, rel=0.15)
    assert large == pytest.approx(2 * 2.4 / 285, rel=0.15)


def test_noise_needs_two_frames_at_rest(evidence):
    shown = evidence(TOLERANCE)
    with pytest.raises(AdviceError, match="one frame"):
        suggest("tolerance", replace(shown, frames=shown.frames[:1]))
    with pytest.raises(AdviceError, match="moves"):
        suggest("tolerance", evidence(TOLERANCE, "sim:cup"))


@pytest.mark.parametrize(("field", "least"), [("membrane.min_area_mm2", 15), ("outliers.min_cluster_area_mm2", 20)])
def test_too_small_groups_are_dropped_and_larger_ones_left_alone(evidence, field, least):
    section = field.partition(".")[0]
    raised = suggest(section, evidence(TOLERANCE.with_value(field, 0.0)))
    assert raised.changes[field] >= least
    assert raised.weak
    assert not suggest(section, evidence(TOLERANCE.with_value(field, 200.0))).changes
