"""The suggested mask covers the prints and spares the rest, wherever it was learned."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import AdviceError
from tactune.core.sources.presets import load_preset

SHIPPED = load_preset("simulator")
NO_MASK = SHIPPED.with_values({"mask.enabled": False})


@pytest.mark.parametrize("offset_m", [0.0, 0.012, -0.02])
def test_prints_are_covered_whatever_the_bias(evidence, offset_m, suggest):
    proposal = suggest("mask", evidence(NO_MASK.with_value("alignment.depth_offset_m", offset_m)))
    learned, shipped = proposal.apply(NO_MASK).mask, SHIPPED.mask
    assert np.abs(np.subtract(learned.hue, shipped.hue)).max() <= 5
    covered, lost = (float(share) for share in re.findall(r"([0-9.]+) %", proposal.evidence))
    assert covered >= 95 and lost < 1


def test_a_hue_around_red_wraps(evidence, suggest):
    shown = evidence(NO_MASK)

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
    proposal = suggest("mask", evidence(NO_MASK, untouched=False))
    assert "An untouched frame would tell" in proposal.evidence
    assert np.abs(np.subtract(proposal.changes["mask.hue"], SHIPPED.mask.hue)).max() <= 5


def test_small_contacts_that_look_like_prints_are_refused(evidence, suggest):
    with pytest.raises(AdviceError, match="capture an untouched frame"):
        suggest("mask", evidence(NO_MASK, "sim:octopus?press=low", untouched=False))


def test_a_mask_that_does_as_well_is_kept(evidence, suggest):
    proposal = suggest("mask", evidence(SHIPPED))
    assert not proposal.changes
    assert "covers" in proposal.expected


def test_a_membrane_without_prints_is_told(evidence, suggest):
    shown = evidence(NO_MASK)
    far = np.where(shown.untouched.proximity_depth > 0, 2400, 0).astype(np.uint16)
    with pytest.raises(AdviceError, match="no print reflects infrared"):
        suggest("mask", replace(shown, untouched=replace(shown.untouched, proximity_depth=far)))
