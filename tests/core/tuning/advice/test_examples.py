"""Curves of missed and false contact, and the fields that follow from examples or from noise."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tactune.core.errors import AdviceError
from tactune.core.preset import CameraNoise, RigNoise, now
from tactune.core.sources.presets import load_preset
from tactune.core.tuning.advice.fields import TRIED, error_curve

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
    shown = evidence(TOLERANCE, "sim:cup?press=medium&sensor=heavy", painted=True)
    curve = error_curve("tolerance.t", shown)
    proposed = curve.values == curve.proposed
    contact_mm2 = curve.missed_mm2.max()  # nothing is found
    assert curve.missed_mm2[proposed] < 0.6 * contact_mm2
    assert (curve.missed_mm2 + curve.false_mm2)[proposed] > (curve.missed_mm2 + curve.false_mm2).min()


def test_equal_errors_keep_the_present_value(evidence):
    # nothing is painted, so no value of the largest gap misses or invents anything
    curve = error_curve("membrane.gap_m", evidence(SHIPPED.with_value("membrane.gap_m", 0.0003)))
    assert not curve.error.any()
    assert curve.proposed == 0.0003


@pytest.mark.parametrize(
    ("section", "bad"),
    [
        ("tolerance", {"tolerance.t": 0.05}),
        ("outliers", {"outliers.min_cluster_area_mm2": 9000.0}),
        ("membrane", {"contact_test": "membrane", "membrane.gap_m": 0.003, "membrane.trust_m": 0.1}),
    ],
)
def test_examples_lower_the_error(evidence, section, bad, suggest):
    preset = TOLERANCE.with_values(bad)
    shown = evidence(preset, painted=True)
    proposal = suggest(section, shown)
    path = next(iter(TRIED[section]))
    before, after = (
        sum(error_curve(path, replace(shown, preset=each)).at(each.value(path)))
        for each in (preset, proposal.apply(preset))
    )
    assert after < 0.9 * before
    assert f"{after:.0f} mm²" in proposal.evidence


def test_without_contact_t_follows_from_the_noise_of_the_rig(evidence, suggest):
    camera = CameraNoise(white_m=0.0015, correlated_m=0.0, length_px=0.0, changing_share=1.0, distance_m=0.285)
    noise = RigNoise(
        proximity=camera, tactile=camera, bias_m=0.0, bias_sigma_m=0.001, bias_from="prints", measured=now(), frames=60
    )
    proposal = suggest("tolerance", evidence(TOLERANCE.model_copy(update={"noise": noise})))
    assert "weaker" in proposal.evidence
    assert proposal.apply(TOLERANCE).tolerance.t == pytest.approx(2 * math.hypot(1.5, 1.5) / 285, rel=0.05)
    for section, remedy in (("tolerance", "measure the rig's noise"), ("outliers", "mark it in a frame")):
        with pytest.raises(AdviceError, match=remedy):
            suggest(section, evidence(TOLERANCE))
