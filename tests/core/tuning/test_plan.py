"""The plan of a search: texts, ranges, grids, default ranges, and errors before the first trial."""

import pytest

from tactune.core.errors import TactuneError
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset
from tactune.core.tuning.plan import check_axes, default_axes, grid_of, parse_axis

BASE = Preset().with_value("contact_test", "tolerance")


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
