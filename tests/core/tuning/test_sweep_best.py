"""Ranking of settings: means over seeds and sources, failures last, ties by time."""

from __future__ import annotations

import pytest

from tactune.core.errors import TactuneError
from tactune.core.preset import Preset
from tactune.core.tuning.best import OBJECTIVES, best_preset, choose_objective, edges, effects, rank
from tactune.core.tuning.clips import Clip
from tactune.core.tuning.plan import Plan, Setting
from tactune.core.tuning.values import plain_value, result_paths

BASE = Preset(contact_test="tolerance")
FIXED = {path: plain_value(BASE, path) for path in result_paths()}


def setting(k: int, method: str = "fusion") -> Setting:
    return Setting(method, {"outliers.k": k}, FIXED | {"outliers.k": k})


def plan_of(*settings: Setting, truth: bool = True) -> Plan:
    clips = tuple(Clip(source, source, 0, range(3), "", "", truth) for source in ("one", "other"))
    return Plan(BASE, ("outliers.k",), settings, clips, "")


def row(of: Setting, source: str = "one", **measured) -> dict[str, object]:
    empty = dict.fromkeys([column for column, _ in OBJECTIVES.values()])
    about = {"source": source, "method": of.method, "missed": 0, "failure": "", "points": 9.0, "ms": 1.0}
    return {**of.parameters, **empty, **about, **measured}


def ranked(plan: Plan, rows, objective: str) -> list[int]:
    return [score.setting.values["outliers.k"] for score in rank(plan, rows, objective)]


def test_each_source_counts_alike_however_many_seeds_it_has():
    a, b = setting(1), setting(2)
    rows = [row(a, rmse_mm=1.0), row(a, rmse_mm=1.0), row(a, rmse_mm=1.0), row(a, "other", rmse_mm=4.0)]
    rows += [row(b, rmse_mm=2.0), row(b, "other", rmse_mm=2.0)]
    plan = plan_of(a, b)
    assert [score.value for score in rank(plan, rows, "rmse_mm")] == [2.0, 2.5]
    assert ranked(plan, rows, "rmse_mm") == [2, 1]


def test_larger_is_better_for_iou_and_equals_go_to_the_cheaper():
    settings = [setting(k) for k in (1, 2, 3)]
    rows = [
        row(of, iou=iou, ms=ms) for of, iou, ms in zip(settings, (0.7, 0.8, 0.8 + 1e-15), (1.0, 3.0, 4.0), strict=True)
    ]
    assert ranked(plan_of(*settings), rows, "iou") == [2, 3, 1]
    assert ranked(plan_of(*settings), rows, "ms") == [1, 2, 3]


def test_failed_and_missed_come_after_all_that_worked():
    settings = [setting(k) for k in (1, 2, 3, 4)]
    extra = ({"missed": 2}, {}, {"failure": "no"}, {"rmse_mm": None, "failure": "no"})
    rows = [row(of, **{"rmse_mm": float(i)} | more) for i, (of, more) in enumerate(zip(settings, extra, strict=True))]
    assert ranked(plan_of(*settings), rows, "rmse_mm") == [2, 3, 1, 4]


def test_without_truth_finding_nothing_is_not_best():
    settings = [setting(1), setting(2)]
    rows = [row(settings[0], ms=0.1, points=0.0), row(settings[1], ms=5.0)]
    assert ranked(plan_of(*settings, truth=False), rows, "ms") == [2, 1]


def test_the_objective_must_be_one_that_can_be_told():
    blind = plan_of(setting(1), truth=False)
    assert choose_objective(None, blind) == "stability"
    assert choose_objective("ms", blind) == "ms"
    assert choose_objective(None, plan_of(setting(1))) == "rmse_mm"
    with pytest.raises(TactuneError, match="one has no ground truth, so iou is undefined; choose ms, area, stability"):
        choose_objective("iou", blind)


@pytest.mark.parametrize(
    ("values", "errors", "expected"),
    [
        ((5, 10, 20), (3.0, 2.0, 1.0), ["the best outliers.k, 20, is the largest tried; try larger ones, too"]),
        ((5, 10, 20), (1.0, 2.0, 3.0), ["the best outliers.k, 5, is the smallest tried; try smaller ones, too"]),
        ((5, 10, 20), (2.0, 1.0, 3.0), []),
        ((5, 10, 20), (1.0, 1.0, 1.0), []),
        ((1, 10, 20), (1.0, 2.0, 3.0), []),
        ((5,), (1.0,), []),
    ],
    ids=["largest", "smallest", "within", "no difference", "nothing beyond", "one value"],
)
def test_a_best_value_at_the_edge_of_its_range_is_said(values, errors, expected):
    settings = [setting(k) for k in values]
    plan = plan_of(*settings)
    rows = [row(of, rmse_mm=error) for of, error in zip(settings, errors, strict=True)]
    assert [edge.sentence for edge in edges(plan, rank(plan, rows, "rmse_mm"))] == expected


def test_effects_are_means_over_all_other_parameters():
    settings = [setting(k, method) for method in ("fusion", "fusion-rigid") for k in (1, 2)]
    plan = plan_of(*settings)
    rows = [row(of, rmse_mm=value) for of, value in zip(settings, (1.0, 3.0, 5.0, 7.0), strict=True)]
    found = {(effect.path, effect.label): effect.value for effect in effects(plan, rank(plan, rows, "rmse_mm"))}
    assert found == {
        ("outliers.k", "1"): 3.0, ("outliers.k", "2"): 5.0,
        ("method", '"fusion"'): 2.0, ("method", '"fusion-rigid"'): 6.0,
    }  # fmt: skip


def test_the_best_method_is_written_into_the_preset():
    for method, path, value in (
        ("fusion-homography", "alignment.model", "homography"),
        ("fusion-membrane", "contact_test", "membrane"),
    ):
        plan = plan_of(setting(7, method))
        (best,) = rank(plan, [row(plan.settings[0], rmse_mm=1.0)], "rmse_mm")
        preset = best_preset(plan, best, "rmse_mm")
        assert (preset.value(path), preset.outliers.k) == (value, 7)
    (nothing,) = rank(plan, [row(plan.settings[0], failure="no")], "rmse_mm")
    with pytest.raises(TactuneError, match="no run gave rmse_mm"):
        best_preset(plan, nothing, "rmse_mm")
