"""Suggest all: it mends what was spoiled, says what it can't know, and computes sections one after the other."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import AdviceError, FrameError
from tactune.core.model.metrics import compare_with_truth
from tactune.core.preset import CameraNoise, Preset, RigNoise, now
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source
from tactune.core.tuning.advice.proposal import Evidence
from tactune.core.tuning.advice.suggest import SECTIONS, suggest_all

SHIPPED = load_preset("simulator")
TOLERANCE = SHIPPED.with_value("contact_test", "tolerance")


#: What spoils the shipped preset.
SPOILED = {
    "mask off": {"mask.enabled": False},
    "another colour": {"mask.hue": (40, 80)},
    "offset": {"alignment.depth_offset_m": 0.012},
    "tolerance test": {"contact_test": "tolerance", "tolerance.t": 0.05},
    "all": {
        "mask.enabled": False,
        "alignment.depth_offset_m": 0.012,
        "contact_test": "tolerance",
        "tolerance.t": 0.05,
    },
}


def rmse_mm(preset, rig, frame):
    patch = ContactPipeline(preset, rig).process(frame)
    return compare_with_truth(patch, frame.truth, rig)["rmse_mm"]


def test_a_spoiled_preset_is_brought_back(evidence):
    shown = evidence(SHIPPED)
    good = rmse_mm(SHIPPED, shown.rig, shown.frame)
    for name, values in SPOILED.items():
        preset = SHIPPED.with_values(values)
        mended = suggest_all(replace(shown, preset=preset)).merged.apply(preset)
        assert rmse_mm(mended, shown.rig, shown.frame) <= 1.1 * good, name
        assert mended.contact_test == "membrane"
    assert rmse_mm(preset, shown.rig, shown.frame) > 3 * good


def test_nothing_is_changed_in_the_shipped_preset(evidence):
    proposals = suggest_all(evidence(SHIPPED))
    assert [part.section for part in proposals.parts] == ["mask", "contact_test", "alignment"]
    assert not proposals.refusals
    assert not proposals.merged.changes
    assert all(part.evidence for part in proposals.parts)


def test_later_sections_see_the_earlier_ones_applied(evidence, suggest):
    preset = TOLERANCE.with_values({"mask.enabled": False, "tolerance.t": 0.03})
    shown = evidence(preset, "sim:cup?gap=5", untouched=True)
    # nothing presses, so only prints tell the bias; these have a colour only after the mask was suggested
    with pytest.raises(AdviceError, match="can't be told from a gap"):
        suggest("alignment", shown)
    proposals = suggest_all(shown)
    assert "alignment" in [part.section for part in proposals.parts]
    assert {"mask", "contact_test"} <= {path.partition(".")[0] for path in proposals.merged.changes}
    # the membrane test was suggested, so the sections of the tolerance test are not
    assert {part.section for part in proposals.parts}.isdisjoint({"tolerance", "outliers"})


def test_a_refused_section_does_not_stop_the_others(evidence):
    blind = evidence(SHIPPED.with_value("mask.enabled", False))
    frame = replace(blind.frame, tactile_depth=np.zeros_like(blind.frame.tactile_depth))
    proposals = suggest_all(replace(blind, frames=(frame,)))
    assert "mask" in [part.section for part in proposals.parts]
    assert set(suggest_all(replace(blind, frames=(frame,), untouched=None)).refusals) >= {"mask", "contact_test"}


def test_the_real_pair_is_centred(shared_data):
    with open_source(f"folder:{shared_data / 'real_pair'}") as source:
        rig, frame = source.rig, source.next_frame()
    preset = Preset().with_values({"contact_test": "tolerance", "tolerance.t": 0.02, "outliers.enabled": False})
    proposals = suggest_all(Evidence(preset, rig, (frame,)))
    mended = proposals.merged.apply(preset)
    assert mended.alignment.depth_offset_m == pytest.approx(0.0169, abs=0.0015)
    assert mended.contact_test == "tolerance"
    patch = ContactPipeline(mended, rig).process(frame)
    assert patch.mask.sum() > 0.8 * np.isfinite(patch.relative_difference).sum()
    # what one frame without a membrane can't tell
    assert set(proposals.refusals) == {"mask", "tolerance"}


def test_an_unknown_section_and_a_frame_of_another_rig_are_refused(evidence, make_rig):
    with pytest.raises(AdviceError, match="musk; choose from mask, contact_test"):
        suggest_all(evidence(SHIPPED), sections=["musk"])
    with pytest.raises(FrameError, match="the rig says"):
        suggest_all(replace(evidence(SHIPPED), rig=make_rig()))


def test_progress_rises_and_may_cancel(evidence):
    told = []

    def report(share, words):
        assert words
        told.append(share)

    suggest_all(evidence(TOLERANCE), report, SECTIONS)
    assert told == sorted(told)
    assert told[0] >= 0 and told[-1] == 1

    def cancel(share, words):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        suggest_all(evidence(TOLERANCE), cancel)


def test_the_tolerance_follows_from_the_noise_of_the_rig(evidence, suggest):
    camera = CameraNoise(white_m=0.0015, correlated_m=0.0, length_px=0.0, changing_share=1.0, distance_m=0.285)
    noise = RigNoise(
        proximity=camera, tactile=camera, bias_m=0.0, bias_sigma_m=0.001, bias_from="prints", measured=now(), frames=60
    )
    proposal = suggest("tolerance", evidence(TOLERANCE.model_copy(update={"noise": noise})))
    assert proposal.apply(TOLERANCE).tolerance.t == pytest.approx(2 * math.hypot(1.5, 1.5) / 285, rel=0.05)
    with pytest.raises(AdviceError, match="noise"):
        suggest("tolerance", evidence(TOLERANCE))
