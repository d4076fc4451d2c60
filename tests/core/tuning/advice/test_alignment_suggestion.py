"""The suggested depth offset: found on prints, in contact, or refused."""

import pytest

from tactune.core.errors import AdviceError
from tactune.core.model.alignment import CalibrationRecord, ModelSummary
from tactune.core.preset import CameraNoise, RigNoise, now
from tactune.core.sources.presets import load_preset

SHIPPED = load_preset("simulator")
TOLERANCE = SHIPPED.with_value("contact_test", "tolerance")
NO_MASK = TOLERANCE.with_value("mask.enabled", False)


@pytest.mark.parametrize("spoiled_m", [0.012, -0.009])
def test_prints_tell_the_offset(evidence, spoiled_m, suggest):
    proposal = suggest(
        "alignment", evidence(TOLERANCE.with_value("alignment.depth_offset_m", spoiled_m), "sim:cup?gap=5")
    )
    assert proposal.changes["alignment.depth_offset_m"] == pytest.approx(0, abs=0.0015)
    assert "prints" in proposal.evidence and "±" in proposal.evidence


def test_firm_contact_tells_the_offset_without_prints(evidence, suggest):
    shown = evidence(NO_MASK.with_value("alignment.depth_offset_m", 0.012), "sim:cup?press=medium&sensor=datasheet")
    proposal = suggest("alignment", shown)
    assert proposal.changes["alignment.depth_offset_m"] == pytest.approx(0, abs=0.0025)


def test_an_object_that_hovers_is_not_taken_for_a_bias(evidence, suggest):
    with pytest.raises(AdviceError, match="can't be told from a gap"):
        suggest("alignment", evidence(NO_MASK, "sim:cup?gap=5", untouched=False))


def test_the_membrane_test_needs_no_offset(evidence, suggest):
    far = "sim:cup?press=medium&sensor=far-offset"
    kept = suggest("alignment", evidence(SHIPPED, far))
    assert not kept.changes
    assert "by itself" in kept.expected
    reset = suggest("alignment", evidence(SHIPPED.with_value("alignment.depth_offset_m", 0.006), far))
    assert reset.changes == {"alignment.depth_offset_m": 0.0}
    measured = suggest("alignment", evidence(TOLERANCE, far))
    assert measured.changes["alignment.depth_offset_m"] == pytest.approx(0.020, abs=0.003)


def test_a_calibrated_offset_is_corrected_not_reset(evidence, suggest):
    quality = ModelSummary(alignment_px=1, alignment_bound_95_px=1, boundary_error_mm=1, supported_tolerance=0.01)
    record = CalibrationRecord(date=now(), model="rigid", quality=quality)
    alignment = SHIPPED.alignment.model_copy(update={"depth_offset_m": 0.006, "calibration": record})
    preset = SHIPPED.model_copy(update={"alignment": alignment})
    proposal = suggest("alignment", evidence(preset, "sim:cup?press=medium&sensor=far-offset"))
    assert proposal.changes["alignment.depth_offset_m"] == pytest.approx(0.020, abs=0.003)


@pytest.mark.parametrize(("measured_m", "changes"), [(0.0003, False), (0.0150, True)])
def test_the_bias_of_the_rig_counts_more_than_a_few_frames_unless_these_contradict_it(
    evidence, suggest, measured_m, changes
):
    camera = CameraNoise(white_m=2e-4, correlated_m=1e-3, length_px=4, changing_share=0.5, distance_m=0.28)
    known = RigNoise(
        proximity=camera,
        tactile=camera,
        bias_m=measured_m,
        bias_sigma_m=0.0003,
        bias_from="contact",
        measured=now(),
        frames=60,
    )
    shown = evidence(TOLERANCE.model_copy(update={"noise": known}))
    alone = suggest("alignment", evidence(TOLERANCE))
    proposal = suggest("alignment", shown)
    assert ("+0.3 mm" in proposal.evidence) != changes
    assert not changes or proposal.evidence == alone.evidence
