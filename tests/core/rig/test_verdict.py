"""The verdict on a rig: which measurement limits the boundary of a patch."""

import pytest

from tactune.core.errors import CalibrationError
from tactune.core.preset import CameraNoise, RigNoise, now
from tactune.core.rig.untouched import untouched_frame
from tactune.core.rig.verdict import judge_rig
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source

CAMERA = CameraNoise(white_m=2e-4, correlated_m=1e-3, length_px=4, changing_share=0.5, distance_m=0.28)


@pytest.fixture(scope="module")
def press():
    source = open_source("sim:cup?press=medium")
    return source.rig, source.next_frame(), untouched_frame(source)


def judged(press, test, bias_sigma_m):
    rig, frame, untouched = press
    noise = RigNoise(
        proximity=CAMERA, tactile=CAMERA, bias_sigma_m=bias_sigma_m, bias_from="contact", measured=now(), frames=60
    )
    values = {"contact_test": test, "noise": noise.model_dump(), "mask.enabled": False}  # prints would tell the bias
    return judge_rig(load_preset("simulator").with_values(values), rig, frame, untouched)


def test_a_badly_measured_bias_is_the_weakest_link(press):
    sure, unsure = judged(press, "membrane", 0.0002), judged(press, "membrane", 0.004)
    assert (sure.weakest, unsure.weakest) == ("noise", "bias")
    assert sure.error_mm < unsure.error_mm
    assert "bias" in unsure.sentence and f"{unsure.error_mm:.1f} mm" in unsure.sentence


@pytest.mark.parametrize("test", ["tolerance", "pressure"])
def test_tests_that_know_no_bias_are_judged_by_the_noise(press, test):
    assert 0.1 < judged(press, test, 0.0002).links_mm["noise"] < 10


def test_without_contact_there_is_nothing_to_judge(press):
    rig, _, untouched = press
    with pytest.raises(CalibrationError, match="no contact"):
        judge_rig(load_preset("simulator"), rig, untouched, untouched)
