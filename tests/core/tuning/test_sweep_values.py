"""Values of a sweep's parameters: texts, ranges, grids, samples, and errors before the first run."""

from __future__ import annotations

import numpy as np
import pytest

from tactune.core.errors import TactuneError
from tactune.core.preset import Preset
from tactune.core.tuning.values import (
    MAX_RUNS,
    check_contact_test,
    check_switched_on,
    checked_axis,
    grid,
    grid_size,
    make_axis,
    parse_axis,
    sample,
)

BASE = Preset()


def values(text: str) -> list[object]:
    axis = checked_axis(parse_axis(text), BASE)
    return [combination[axis.path] for combination in grid([axis], BASE)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("outliers.k=10,20,30", [10, 20, 30]),
        ("outliers.k=10:30:3", [10, 20, 30]),
        ("outliers.k=1:3:9", [1, 2, 3]),
        ("tolerance.t=0.01:0.03:5", [0.01, 0.015, 0.02, 0.025, 0.03]),
        ("tolerance.t=0.001:0.1:3log", [0.001, 0.01, 0.1]),
        ("tolerance.t=0.02,0.02", [0.02]),
        ("contact_test=tolerance,membrane", ["tolerance", "membrane"]),
        ("mask.enabled=true,false", [True, False]),
        ("mask.hue=[145,175],[10,20]", [[145, 175], [10, 20]]),
        (" outliers.ratio = 1, 2.5 ", [1.0, 2.5]),
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
        ("tolerance.t=0.5:2:3", "tolerance.t is 2"),
        ("tolerance.t=NaN", "tolerance.t is"),
        ("tolerance.t=", "no value"),
        ("tolerance.t=,", "no value"),
        ("tolerance.t=0.03:0.01:5", "empty"),
        ("tolerance.t=0.01:0.01:5", "empty"),
        ("tolerance.t=a:b:5", "no range"),
        ("tolerance.t=0:0.1:5log", "above 0"),
        ("tolerance.t=0.1:0.2:1", "2 to"),
        ("tolerance.t=0.1:0.2:999999999999999999999", "2 to"),
        ("outliers.k=1.5", "outliers.k is 1.5"),
        ("outliers.k=0:10:3", "outliers.k is 0"),
        ("contact_test=1:2:3", "not a number"),
        ("name=a,b", "cannot be swept"),
        ("alignment.calibration=null", "cannot be swept"),
        ("cameras.tactile_delay_s=0.1", "cannot be swept"),
        ("untouched=null", "cannot be swept"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(text, words):
    with pytest.raises(TactuneError, match=words):
        values(text)


def test_a_field_of_a_section_that_is_off_is_refused_since_it_changes_nothing():
    hue = parse_axis("mask.hue=[1,2]")
    with pytest.raises(TactuneError, match=r"add --set mask\.enabled=true"):
        check_switched_on([hue], BASE)
    check_switched_on([hue, parse_axis("mask.enabled=true")], BASE)
    check_switched_on([hue], BASE.with_value("mask.enabled", True))


def test_a_field_of_the_other_contact_test_is_refused():
    gap, both = parse_axis("membrane.gap_m=0.001"), parse_axis("contact_test=tolerance,membrane")
    with pytest.raises(TactuneError, match="add --set contact_test=membrane"):
        check_contact_test([gap], BASE.with_value("contact_test", "tolerance"))
    with pytest.raises(TactuneError, match=r"outliers\.k changes nothing while contact_test is membrane"):
        check_contact_test([parse_axis("outliers.k=5")], BASE)
    check_contact_test([gap, both], BASE)


def test_a_grid_has_every_combination_once():
    axes = [parse_axis("outliers.k=10,20,30"), parse_axis("tolerance.t=0.01:0.02:2")]
    found = [tuple(combination.values()) for combination in grid(axes, BASE)]
    assert grid_size(axes) == len(found) == len(set(found)) == 6
    with pytest.raises(TactuneError, match="no number of steps"):
        grid_size([parse_axis("tolerance.t=0.01:0.02")])
    assert grid_size([make_axis("tolerance.t", f"0:1:{MAX_RUNS}")] * 3) == MAX_RUNS**3


def test_a_sample_covers_each_axis_evenly_and_its_seed_decides():
    axes = [parse_axis("tolerance.t=0.001:0.1:log"), parse_axis("outliers.k=10,20"), parse_axis("outliers.ratio=1:3")]
    found = list(sample(axes, BASE, 40, seed=1))
    assert found == list(sample(axes, BASE, 40, seed=1)) != list(sample(axes, BASE, 40, seed=2))
    shares = np.log10([combination["tolerance.t"] for combination in found]) / 2 + 1.5
    assert sorted(np.floor(40 * shares).astype(int)) == list(range(40)), "one in each fortieth of the range"
    assert sum(combination["outliers.k"] == 10 for combination in found) == 20
    assert all(1 <= combination["outliers.ratio"] <= 3 for combination in found)
