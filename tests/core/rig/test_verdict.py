"""The verdict on a rig, and its inflation from presses of known force."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigs import rig_noise
from tactune.core import ContactPipeline, Preset, open_source
from tactune.core.errors import CalibrationError
from tactune.core.rig.inflation import Press, fit_inflation, read_forces
from tactune.core.rig.untouched import untouched_frame
from tactune.core.rig.verdict import judge_rig
from tactune.core.sources.presets import load_preset


@pytest.fixture(scope="module")
def press():
    source = open_source("sim:cup?press=medium")
    return source.rig, source.next_frame(), untouched_frame(source)


def judged(press, test, bias_sigma_m):
    rig, frame, untouched = press
    noise = rig_noise(0.0002, 0.001, bias_sigma_m=bias_sigma_m, bias_from="contact")
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


AREAS = st.lists(st.floats(2_000, 30_000), min_size=1, max_size=20)


@given(st.floats(100, 20_000), AREAS)
def test_forces_that_follow_give_back_their_pressure(pascals, areas):
    found = fit_inflation([Press(n, 1e-6 * pascals * area, area, 0.05 * area) for n, area in enumerate(areas)])
    assert found.pascals == pytest.approx(pascals, rel=1e-6)
    assert 0.05 * pascals <= found.sigma_pa < 0.08 * pascals
    assert found.residual_n < 1e-6 * pascals


def test_a_precise_press_counts_more_and_a_spread_is_told():
    presses = [Press(0, 20.0, 10_000, 100), Press(1, 30.0, 10_000, 2_000)]
    assert fit_inflation(presses).pascals == pytest.approx(2_000, rel=0.01)
    even = [Press(n, force, 10_000, 100) for n, force in enumerate((15.0, 25.0))]
    assert fit_inflation(even).sigma_pa > 490  # both pressures differ from their mean by 500 Pa


def test_forces_of_other_frames_are_refused():
    with pytest.raises(CalibrationError, match="do not follow"):
        fit_inflation([Press(n, force, area, 100) for n, (force, area) in enumerate(((1, 20e3), (40, 2e3), (2, 25e3)))])
    with pytest.raises(CalibrationError, match="no press"):
        fit_inflation([])


def test_a_press_of_the_simulator_tells_its_pressure():
    with open_source("sim:cup?press=medium") as source:
        frame, untouched, rig = source.next_frame(), untouched_frame(source), source.rig
    truth = frame.truth
    patch = ContactPipeline(Preset(contact_test="pressure"), rig, untouched).process(frame)
    press = Press.of(patch, 7, float(np.linalg.norm(truth.force_n)))
    found = fit_inflation([press])
    assert press.weak == ("noise not measured",) and press.weak[0] in found.sentence
    assert found.sigma_pa > 1.3 * fit_inflation([press._replace(weak=())]).sigma_pa
    assert abs(found.pascals - truth.inflation_pa) < 2 * found.sigma_pa
    assert Preset().with_values(found.changes).pressure.gauge_pa == pytest.approx(found.pascals, abs=0.01)
    at_rest = ContactPipeline(Preset(contact_test="pressure"), rig, untouched).process(untouched)
    with pytest.raises(CalibrationError, match="frame 3; press"):
        Press.of(at_rest, 3, 10.0)
    for force_n in (-2.0, 1e-200, 1e200):
        with pytest.raises(CalibrationError, match="give what the scale reads"):
            Press.of(patch, 3, force_n)
    with pytest.raises(CalibrationError, match="contact test"):
        Press.of(ContactPipeline(Preset(contact_test="tolerance"), rig).process(frame), 3, 10.0)


@pytest.mark.parametrize(
    ("text", "frame", "time_s", "force_n"),
    [
        ("frame,force_n\n3,1.5\n7,2.5\n", 7, 0.0, 2.5),
        ("Frame;Force_N\n7;2,5\n", 7, 0.0, 2.5),
        ("time_s,force_n\n1,10\n0,0\n", 0, 0.25, 2.5),
        ("time_s,force_n\n0,0\n1,10\n", 0, 1.25, None),
        ("time_s,force_n\n1.7e9,0\n1700000001,10\n", 0, 1.7e9 - 4.75, 2.5),  # stamps
        ("frame,force_n\n3,1.5\n", 4, 0.0, None),
    ],
)
def test_a_log_tells_the_force_of_a_frame(tmp_path, text, frame, time_s, force_n):
    path = tmp_path / "forces.csv"
    path.write_text(text)
    found = read_forces(path).of(SimpleNamespace(sequence=frame, proximity_time_s=5.0 + time_s), 5.0)
    assert found == (None if force_n is None else pytest.approx(force_n))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "columns"),
        ("frame,force_n\n", "no row"),
        ("frame,time_s,force_n\n1,1,1\n", "columns"),
        ("frame,force\n1,1\n", "columns"),
        ("frame,force_n\n1,much\n", "line 2"),
        ("frame,force_n\n1,nan\n", "line 2"),
        ("frame,force_n\n1\n", "line 2"),
        ("frame,force_n\n1,2\n1,3\n", "twice"),
        ("\x00\xff", "columns"),
    ],
)
def test_a_log_that_is_none_is_refused(tmp_path, text, named):
    path = tmp_path / "forces.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(CalibrationError, match=named):
        read_forces(path)


def test_one_press_is_as_uncertain_as_its_noise():
    assert fit_inflation([Press(0, 20.0, 10_000, 2_000)]).sigma_pa == pytest.approx(math.hypot(400, 100))
    grams = fit_inflation([Press(0, 300.0, 10_000, 2_000)])
    assert "newtons?" in grams.sentence and "newtons?" not in fit_inflation([Press(0, 20.0, 10_000, 2_000)]).sentence
