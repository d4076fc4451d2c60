"""Suggestions: they mend what was spoiled, say what they can't know, and see the earlier ones applied."""

import math
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from rigs import calibrated, rig_noise
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import AdviceError, FrameError
from tactune.core.model.metrics import compare_with_truth
from tactune.core.preset import Preset
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
    noise = rig_noise(0.0015, 0.0, 0.285, bias_m=0.0, bias_sigma_m=0.001, bias_from="prints")
    proposal = suggest("tolerance", evidence(TOLERANCE.model_copy(update={"noise": noise})))
    assert proposal.apply(TOLERANCE).tolerance.t == pytest.approx(2 * math.hypot(1.5, 1.5) / 285, rel=0.05)
    for section, asked in (("tolerance", "noise"), ("pressure", "pressure: measure the noise")):  # and nothing else
        with pytest.raises(AdviceError, match=asked):
            suggest(section, evidence(TOLERANCE.with_value("contact_test", section)))


@pytest.mark.parametrize("spoiled_m", [0.012, -0.009])
def test_prints_tell_the_offset(evidence, spoiled_m, suggest):
    proposal = suggest(
        "alignment", evidence(TOLERANCE.with_value("alignment.depth_offset_m", spoiled_m), "sim:cup?gap=5")
    )
    assert proposal.changes["alignment.depth_offset_m"] == pytest.approx(0, abs=0.0015)
    assert "prints" in proposal.evidence and "±" in proposal.evidence


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
    preset = calibrated(SHIPPED.with_value("alignment.depth_offset_m", 0.006), 0.01)
    proposal = suggest("alignment", evidence(preset, "sim:cup?press=medium&sensor=far-offset"))
    assert proposal.changes["alignment.depth_offset_m"] == pytest.approx(0.020, abs=0.003)


@pytest.mark.parametrize(("measured_m", "changes"), [(0.0003, False), (0.0150, True)])
def test_the_bias_of_the_rig_counts_more_than_a_few_frames_unless_these_contradict_it(
    evidence, suggest, measured_m, changes
):
    known = rig_noise(0.0002, 0.001, bias_m=measured_m, bias_sigma_m=0.0003, bias_from="contact")
    shown = evidence(TOLERANCE.model_copy(update={"noise": known}))
    alone = suggest("alignment", evidence(TOLERANCE))
    proposal = suggest("alignment", shown)
    assert ("+0.3 ± 0.3 mm" in proposal.evidence) != changes
    assert not changes or proposal.evidence == alone.evidence


UNMASKED = SHIPPED.with_values({"mask.enabled": False})


@pytest.mark.parametrize("offset_m", [0.0, 0.012, -0.02])
def test_prints_are_covered_whatever_the_bias(evidence, offset_m, suggest):
    proposal = suggest("mask", evidence(UNMASKED.with_value("alignment.depth_offset_m", offset_m)))
    learned, shipped = proposal.apply(UNMASKED).mask, SHIPPED.mask
    assert np.abs(np.subtract(learned.hue, shipped.hue)).max() <= 5
    covered, lost = (float(share) for share in re.findall(r"([0-9.]+) %", proposal.evidence))
    assert covered >= 95 and lost < 1


def test_a_hue_around_red_wraps(evidence, suggest):
    shown = evidence(UNMASKED)

    def redder(frame):
        hsv = cv2.cvtColor(frame.proximity_color, cv2.COLOR_RGB2HSV)
        hsv[..., 0] = (hsv[..., 0].astype(int) + 20) % 180
        return replace(frame, proximity_color=cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB))

    red = replace(shown, frames=tuple(map(redder, shown.frames)), untouched=redder(shown.untouched))
    mended = suggest("mask", red).apply(red.preset)
    low, high = mended.mask.hue
    assert low > high
    plain = suggest("mask", shown).apply(shown.preset)
    areas = [ContactPipeline(preset, each.rig).process(each.frame).area_mm2
             for preset, each in ((mended, red), (plain, shown))]  # fmt: skip
    assert areas[0] == pytest.approx(areas[1], rel=0.02)


def test_a_pressed_frame_alone_gives_a_mask(evidence, suggest):
    proposal = suggest("mask", evidence(UNMASKED, untouched=False))
    assert "An untouched frame would tell" in proposal.evidence
    assert np.abs(np.subtract(proposal.changes["mask.hue"], SHIPPED.mask.hue)).max() <= 5


def test_small_contacts_that_look_like_prints_are_refused(evidence, suggest):
    with pytest.raises(AdviceError, match="capture an untouched frame"):
        suggest("mask", evidence(UNMASKED, "sim:octopus?press=low", untouched=False))


def test_a_membrane_without_prints_is_told(evidence, suggest):
    shown = evidence(UNMASKED)
    far = np.where(shown.untouched.proximity_depth > 0, 2400, 0).astype(np.uint16)
    with pytest.raises(AdviceError, match="no print reflects infrared"):
        suggest("mask", replace(shown, untouched=replace(shown.untouched, proximity_depth=far)))
