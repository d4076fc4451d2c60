"""The plan of a search, and how a trial is measured."""

import time

import pytest

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import TactuneError
from tactune.core.sources.presets import load_preset
from tactune.core.tuning.measure import measure
from tactune.core.tuning.plan import check_axes, default_axes, grid_of, make_plan, parse_axis

BASE = load_preset("default").with_value("contact_test", "tolerance")


def values(text):
    (axis,) = check_axes([parse_axis(text)], BASE)
    return [point[axis.path] for point in grid_of([axis])]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("outliers.k=10,20,30", [10, 20, 30]),
        ("tolerance.t=0.02,0.02", [0.02]),
        ("contact_test=tolerance,membrane", ["tolerance", "membrane"]),
        ("mask.enabled=true,false", [True, False]),
        (" outliers.ratio = 1, 2.5 ", [1.0, 2.5]),
        ("alignment.homography.H_p_t=null", [None]),
    ],
)
def test_texts_become_the_values_that_a_preset_holds(text, expected):
    assert values(text) == expected
    assert all(type(found) is type(wanted) for found, wanted in zip(values(text), expected, strict=True))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("tolerance", "no ="),
        ("tolerance.tt=0.1", "did you mean tolerance.t"),
        ("tolerance.t=2", "tolerance.t is 2"),
        ("tolerance.t=0.5:2", "tolerance.t is 2"),
        ("tolerance.t=,", "no value"),
        ("tolerance.t=0.03:0.01", "no range"),
        ("tolerance.t=a:b", "no range"),
        ("tolerance.t=0:0.1:log", "above 0"),
        ("outliers.k=1.5", "outliers.k is 1.5"),
        ("outliers.k=10,abc", "outliers.k is 'abc'"),
        ("contact_test=1:2", "contact_test is 1"),
        ("mask.enabled=0:1", "should be true or false"),
        ("name=a,b", "cannot vary"),
        ("cameras.tactile_delay_s=0.1", "cannot vary"),
        ("untouched=null", "cannot vary"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(text, words):
    with pytest.raises(TactuneError, match=words):
        values(text)


def test_without_a_choice_the_numbers_of_the_contact_test_vary_around_their_present_values():
    preset = load_preset("simulator")
    axes = {axis.path: axis for axis in default_axes(preset)}
    assert set(axes) == {"membrane.gap_m", "membrane.trust_m", "membrane.shape_px", "membrane.min_area_mm2"}
    tolerance = preset.with_values({"contact_test": "tolerance", "tolerance.t": 0.5, "outliers.enabled": False})
    axes = {axis.path: axis for axis in default_axes(tolerance)}
    assert set(axes) == {"tolerance.t"}
    assert axes["tolerance.t"].log and axes["tolerance.t"].holds(0.5)


def plan_of(*sources):
    return make_plan(BASE, [], sources, objectives=["stability", "ms"])


def figures_of(plan, *trials):
    measured = measure(plan, trials)
    assert not any(failure for _, failure in measured)
    return [figures for figures, _ in measured]


def test_trials_do_not_affect_each_other_whatever_their_order(recording):
    trials = [
        {"contact_test": test, "tolerance.t": t, "outliers.k": k, "membrane.frames": frames}
        for frames, test in ((1, "tolerance"), (1, "membrane"), (2, "membrane"))
        for k in (20, 5)
        for t in (0.01, 0.005)
    ]
    alone = [figures_of(plan_of(recording), trial)[0] for trial in trials]
    together = figures_of(plan_of(recording), *trials)
    for figures in (*alone, *together):
        assert figures.pop("ms") > 0
    assert alone == together
    assert len({figures["points"] for figures in alone}) > 4


def test_time_in_which_others_have_the_processor_does_not_count(recording, monkeypatch):
    original = ContactPipeline.process

    def process(self, frame):
        patch = original(self, frame)
        time.sleep(0.2)  # as if another process had the processor
        return patch

    monkeypatch.setattr(ContactPipeline, "process", process)
    (found,) = figures_of(plan_of(recording), {})
    assert 0 < found["ms"] < 0.5 * 200


def test_finding_nothing_never_pays(recording):
    hidden = {"range.enabled": True, "range.limits_m": [1, 2]}
    bad = {"tolerance.t": 0.2}
    nothing, much = figures_of(plan_of(recording), hidden, bad)
    assert (nothing["points"], nothing["iou"]) == (0, 0)
    assert nothing["rmse"] > much["rmse"] > 0


def test_values_that_cannot_be_used_are_a_failure_of_their_trial_alone(recording):
    (_, wrong), (_, right) = measure(plan_of(recording), [{"range.limits_m": [2, 1]}, {}])
    assert "near limit" in wrong and right == ""
