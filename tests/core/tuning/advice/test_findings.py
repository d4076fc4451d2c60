"""Findings: each is found where it holds, and nothing is found with the shipped preset on the simulator."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from rigs import calibrated, rig_noise
from tactune.core.contact.masking import masked_share
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source
from tactune.core.tuning.advice.findings import Examiner

SHIPPED = load_preset("simulator")
TOLERANCE = SHIPPED.with_values({"contact_test": "tolerance"})
NO_MASK = SHIPPED.with_values({"mask.enabled": False})
PRESSED, UNTOUCHED = "sim:cup?press=medium", "sim:cup?press=none"


def noise(white_m, bias_m=0.0):
    return rig_noise(white_m, bias_m=bias_m, bias_sigma_m=0.0005, bias_from="prints")


@lru_cache(maxsize=2)
def scene(name):
    with open_source(name) as source:
        return source.rig, source.next_frame()


def findings(preset, rig, frame, untouched=None):
    """The findings on a frame, by name; without an untouched frame, but for the one that says so."""
    patch = ContactPipeline(preset, rig, untouched).process(frame)
    found = {found.name: found for found in Examiner(rig).findings(frame, patch, preset, untouched)}
    if untouched is None:
        found.pop("unknown_dent", None)
    return found


def mended(finding, preset, rig, frame, untouched=None):
    """Whether the finding's proposal removes it."""
    return finding.name not in findings(finding.proposal.apply(preset), rig, frame, untouched)


@pytest.mark.parametrize("sensor", ["datasheet", "l515-d405", "worn", "far-offset"])
@pytest.mark.parametrize("name", [UNTOUCHED, PRESSED])
def test_the_shipped_preset_gives_no_finding(name, sensor):
    """But for a sensor whose cameras disagree by 17 mm and 1 %: that is found."""
    rig, frame = scene(f"{name}&sensor={sensor}")
    _, untouched = scene(f"{UNTOUCHED}&sensor={sensor}")
    found = findings(SHIPPED, rig, frame, untouched)
    assert set(found) == ({"peak"} if sensor == "far-offset" else set())


def test_a_touch_that_is_doubted_without_the_untouched_frame_asks_for_it():
    (rig, frame), (_, untouched) = scene("sim:octopus?press=low"), scene(UNTOUCHED)
    alone, beside = (ContactPipeline(SHIPPED, rig, each).process(frame) for each in (None, untouched))
    named = [
        {each.name: each for each in Examiner(rig).findings(frame, patch, SHIPPED, None)} for patch in (alone, beside)
    ]
    assert named[0]["unknown_dent"].action == "capture_untouched"
    assert "unknown_dent" not in named[1]


class TestPeak:
    """The cameras disagree."""

    @pytest.mark.parametrize("preset", [SHIPPED, TOLERANCE])
    @pytest.mark.parametrize("offset_m", [0.012, -0.012])
    def test_finds_a_spoiled_depth_offset(self, preset, offset_m):
        rig, frame = scene(PRESSED)
        spoiled = preset.with_values({"alignment.depth_offset_m": offset_m})
        found = findings(spoiled, rig, frame)["peak"]
        assert found.proposal.apply(spoiled).alignment.depth_offset_m == pytest.approx(0, abs=0.0012)
        assert f"{-1e3 * offset_m:+.0f}"[:2].replace("-", "−") in found.sentence
        assert mended(found, spoiled, rig, frame)

    @pytest.mark.parametrize("test", ["membrane", "tolerance"])
    def test_finds_it_in_firm_contact_without_a_mask(self, test):
        rig, frame = scene(PRESSED)
        spoiled = NO_MASK.with_values({"alignment.depth_offset_m": 0.012, "contact_test": test})
        found = findings(spoiled, rig, frame)["peak"]
        assert "firm contact" in found.proposal.evidence
        assert found.proposal.changes["alignment.depth_offset_m"] == pytest.approx(0, abs=0.0015)

    def test_a_bias_that_was_measured_with_the_rig_is_corrected(self):
        rig, frame = scene(f"{PRESSED}&sensor=far-offset")
        assert findings(SHIPPED, rig, frame)["peak"].action == "measure_noise"  # the membrane test corrects by it
        known = SHIPPED.model_copy(update={"noise": noise(0.001, bias_m=0.020)})
        assert findings(known, rig, frame) == {}
        tolerance = TOLERANCE.with_value("alignment.depth_offset_m", 0.004)
        tolerance = tolerance.model_copy(update={"noise": noise(0.001, bias_m=0.016)})
        found = findings(tolerance, rig, frame)["peak"]
        changed = found.proposal.apply(tolerance)
        total_m = changed.noise.bias_m + changed.alignment.depth_offset_m
        assert total_m == pytest.approx(0.020)  # the measured bias holds after the offset


@pytest.mark.parametrize("camera", ["proximity", "tactile"])
@pytest.mark.parametrize("preset", [SHIPPED, TOLERANCE])
def test_a_camera_without_depth(camera, preset):
    rig, frame = scene(PRESSED)
    blind = replace(frame, **{f"{camera}_depth": np.zeros_like(getattr(frame, f"{camera}_depth"))})
    found = findings(preset, rig, blind)
    assert list(found) == ["no_depth"]
    assert f"The {camera} camera measures no depth in 100 %" in found["no_depth"].sentence
    assert found["no_depth"].action == "camera_settings"


@pytest.mark.parametrize(("unit_m", "distance"), [(0.01, "29 m"), (0.001, "2.9 m"), (0.000001, "0.0029 m")])
def test_a_depth_unit_that_puts_the_membrane_where_it_cannot_be(unit_m, distance):
    rig, frame = scene(PRESSED)
    rig = rig.model_copy(update={"tactile": rig.tactile.model_copy(update={"depth_unit_m": unit_m})})
    finding = findings(SHIPPED, rig, frame)["depth_unit"]
    assert distance in finding.sentence and f"{unit_m:g}" in finding.sentence
    assert finding.explains_empty


def test_a_mask_that_covers_the_image():
    rig, frame = scene(PRESSED)
    covered = SHIPPED.with_values({"mask.hue": (0, 179), "mask.saturation": (0, 255), "mask.value": (60, 255)})
    found = findings(covered, rig, frame)["covering_mask"]
    share = masked_share(frame.proximity_color, covered.mask)
    assert 0.5 < share < 1.0
    assert f"covers {100 * share:.1f} % of the colour image" in found.sentence, "the number that the panel shows"
    assert mended(found, covered, rig, frame)


@pytest.mark.parametrize("preset", [NO_MASK, TOLERANCE.with_values({"mask.enabled": False})])
def test_contact_of_nothing_but_prints(preset):
    rig, frame = scene(UNTOUCHED)
    found = findings(preset, rig, frame)["prints"]
    after = found.proposal.apply(preset)
    assert (
        ContactPipeline(after, rig).process(frame).area_mm2
        < 0.05 * ContactPipeline(preset, rig).process(frame).area_mm2
    )
    assert mended(found, preset, rig, frame)


@pytest.mark.parametrize("offset_m", [0.008, -0.008])
def test_prints_beside_contact_do_not_hide_themselves_or_an_offset(offset_m):
    rig, frame = scene(PRESSED)
    preset = NO_MASK.with_values({"alignment.depth_offset_m": offset_m})
    found = findings(preset, rig, frame)
    assert set(found) == {"peak", "prints"}
    assert "groups of contact have one colour" in found["prints"].sentence
    masked = found["prints"].proposal.apply(preset)
    assert set(findings(masked, rig, frame)) == {"peak"}
    both = found["peak"].proposal.apply(masked)
    assert findings(both, rig, frame) == {}
    mended_area, shipped_area = (ContactPipeline(used, rig).process(frame).area_mm2 for used in (both, SHIPPED))
    assert mended_area == pytest.approx(shipped_area, rel=0.05)


def test_small_contact_while_the_bias_is_not_known():
    rig, frame = scene("sim:cup?press=low")
    v, u = np.nonzero(frame.truth.contact)
    box = int(u.min()), int(v.min()), int(np.ptp(u)), int(np.ptp(v))
    no_prints = NO_MASK.with_values({"region.enabled": True, "region.rectangle": box})
    found = findings(no_prints, rig, frame)["unknown_bias"]
    assert found.action == "measure_noise" and "mask" not in found.sentence
    rig_o, with_prints = scene("sim:octopus?press=low")
    found = findings(NO_MASK, rig_o, with_prints)["unknown_bias"]
    assert "The mask is off" in found.sentence and mended(found, NO_MASK, rig_o, with_prints)
    measured = no_prints.model_copy(update={"noise": noise(0.001)})
    assert "unknown_bias" not in findings(measured, rig, frame)
    assert "unknown_bias" not in findings(SHIPPED, rig, frame)  # prints tell the bias


def test_a_membrane_without_a_visible_bulge():
    rig, frame = scene(PRESSED)
    counts = round(0.3 / rig.tactile.depth_unit_m)
    flat = replace(frame, tactile_depth=np.full_like(frame.tactile_depth, counts))
    found = findings(SHIPPED, rig, flat)["bulge"]
    assert "assumes 3 per m" in found.sentence
    assert mended(found, SHIPPED, rig, flat)
    few = np.zeros_like(frame.tactile_depth)
    few[200:260, 220:300] = frame.tactile_depth[200:260, 220:300]
    patch = ContactPipeline(SHIPPED, rig).process(replace(frame, tactile_depth=few))
    assert np.isnan(patch.membrane.curvature_per_m)
    assert patch.membrane.used_curvature_per_m == 10.0


class TestFalseContact:
    """Contact on the untouched membrane."""

    def test_large_false_contact_leads_to_the_measurement_of_the_rig(self):
        rig, untouched = scene(UNTOUCHED)
        _, pressed = scene(PRESSED)
        found = findings(NO_MASK, rig, pressed, untouched)["false_contact"]
        assert found.sentence.startswith("The untouched frame has")
        assert found.proposal is None
        assert found.action == "measure_noise"

    def test_it_is_looked_for_again_after_a_change_of_the_preset(self):
        rig, untouched = scene(UNTOUCHED)
        examiner = Examiner(rig)
        for preset, expected in ((NO_MASK, True), (SHIPPED, False)):
            patch = ContactPipeline(preset, rig).process(untouched)
            found = {finding.name for finding in examiner.findings(untouched, patch, preset, untouched)}
            assert ("false_contact" in found) == expected

    def test_small_false_contact_leads_to_a_larger_smallest_contact(self):
        rig, untouched = scene(f"{UNTOUCHED}&sensor=heavy&seed=2")
        loose = NO_MASK.with_values({"membrane.min_area_mm2": 0.0})
        found = findings(loose, rig, untouched, untouched)["false_contact"]
        assert found.field == "membrane.min_area_mm2"
        assert mended(found, loose, rig, untouched, untouched)

    def test_contact_on_a_membrane_at_rest(self):
        """The membrane is where it was, so an object that hovers is taken for contact."""
        rig, untouched = scene(UNTOUCHED)
        loose = TOLERANCE.with_values({"tolerance.t": 0.03})
        _, hovering = scene("sim:cup?gap=5")
        found = findings(loose, rig, hovering, untouched)
        assert "where it was" in found["false_contact"].sentence
        _, pressed = scene(PRESSED)
        assert "false_contact" not in findings(TOLERANCE, rig, pressed, untouched)


@pytest.mark.parametrize(
    ("factor", "supported", "is_found"),
    [
        (0.3, None, True),
        (1.0, None, False),
        (2.0, None, False),
        (6.0, None, True),
        (1.0, 0.03, True),
        (6.0, 0.03, False),
    ],
)
def test_a_tolerance_that_does_not_fit_noise_and_calibration_is_found(factor, supported, is_found):
    rig, frame = scene(PRESSED)
    due = 2 * np.hypot(0.0008, 0.0008) / 0.3  # twice the deviation of the difference, at the distance of the noise
    preset = TOLERANCE.with_value("tolerance.t", factor * due).model_copy(update={"noise": noise(0.0008)})
    if supported is not None:
        preset = calibrated(preset, supported)
    found = findings(preset, rig, frame)
    assert ("unfit_tolerance" in found) == is_found
    if is_found:
        assert mended(found["unfit_tolerance"], preset, rig, frame)
