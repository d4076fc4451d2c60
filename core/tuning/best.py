"""Ranks the settings of a sweep and measures the effect of each parameter."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any, Final

from ..errors import PresetError
from ..methods.registry import fields_of, method_kind
from ..preset import Preset, now
from .plan import FUSION, Plan, Setting
from .sweep import Row
from .values import SweepError

#: Column of each objective, and whether larger is better.
OBJECTIVES: Final = {
    "rmse_mm": ("rmse_mm", False),
    "iou": ("iou", True),
    "area_error": ("area_error_mm2", False),
    "ms": ("ms", False),
    "area": ("area_mm2", True),
    "stability": ("stability", True),
}
#: Objectives that need no ground truth.
WITHOUT_TRUTH: Final = ("ms", "area", "stability")

#: Marker in the notes of each preset that a sweep has written.
FOUND_BY: Final = "found by tactune sweep"

#: A parameter with more values than this is shown in this number of groups.
_MAX_GROUPS: Final = 8
_GROUPS: Final = 5


@dataclass(frozen=True)
class Score:
    """Score of a setting over all sources and seeds.

    Attributes
    ----------
    value : float
        Objective: mean over seeds, then over sources; nan if no run has a value.
    ms : float
        Mean computation time per frame, ms.
    bad : int
        Number of failed runs plus missed frames. A setting with fewer ranks higher, before the objective is compared.
    runs : int
    """

    setting: Setting
    value: float
    ms: float
    bad: int
    runs: int


@dataclass(frozen=True)
class Effect:
    """Mean objective over all runs in which a parameter has one value, or a value of one group."""

    path: str
    label: str
    value: float
    runs: int


@dataclass(frozen=True)
class Edge:
    """A parameter whose best value is the smallest or largest value of the sweep."""

    path: str
    value: float
    largest: bool

    @property
    def sentence(self) -> str:
        """The finding as a sentence, with a remedy."""
        end, more = ("largest", "larger") if self.largest else ("smallest", "smaller")
        return f"the best {self.path}, {self.value:g}, is the {end} tried; try {more} ones, too"


def choose_objective(asked: str | None, plan: Plan) -> str:
    """Return the chosen objective. Default: the RMSE if all sources have truth, else stability.

    Raises
    ------
    SweepError
        The objective is unknown, or it needs truth and a source has none.
    """
    if asked is None:
        return "rmse_mm" if plan.has_truth else "stability"
    if asked not in OBJECTIVES:
        raise SweepError(f"there is no objective {asked!r}; choose one of {', '.join(OBJECTIVES)}")
    blind = next((clip.source for clip in plan.clips if not clip.has_truth), None)
    if blind is not None and asked not in WITHOUT_TRUTH:
        raise SweepError(f"{blind} has no ground truth, so {asked} is undefined; choose {', '.join(WITHOUT_TRUTH)}")
    return asked


def rank(plan: Plan, rows: Iterable[Row], objective: str) -> list[Score]:
    """Return the settings sorted from best to worst: by failures and misses, then by objective, then by time."""
    column, larger = OBJECTIVES[objective]
    by_setting: dict[str, list[Row]] = {}
    for row in rows:
        by_setting.setdefault(_identity(row["method"], row), []).append(row)
    scores = []
    for setting in plan.settings:
        found = by_setting.get(_identity(setting.method, setting.parameters), [])
        if found:
            bad = sum(row["missed"] + bool(row["failure"]) for row in found)
            value = _over_sources(found, column)
            if objective in WITHOUT_TRUTH and not any(row["points"] for row in found):
                value = math.nan  # a setting that finds nothing is fast and stable, but useless
            scores.append(Score(setting, value, _over_sources(found, "ms"), bad, len(found)))

    def order(score: Score) -> tuple[bool, int, float, float]:
        if math.isnan(score.value):
            return True, score.bad, 0.0, 0.0
        value = _rounded(score.value)
        return False, score.bad, -value if larger else value, score.ms

    return sorted(scores, key=order)


def effects(plan: Plan, scores: Sequence[Score]) -> list[Effect]:
    """Return the mean objective for each value of each parameter, or for groups if there are many values."""
    known = [score for score in scores if not math.isnan(score.value) and not score.bad]
    found = []
    names = [*plan.paths, *["method"] * (len({setting.method for setting in plan.settings}) > 1)]
    for path in names:
        for label, group in _groups(known, path):
            value = fmean(score.value for score in group)
            found.append(Effect(path, label, value, sum(score.runs for score in group)))
    return found


def edges(plan: Plan, scores: Sequence[Score]) -> list[Edge]:
    """Return the numeric parameters whose best value is the smallest or largest value of the sweep.

    Parameters without effect are omitted, and so are those whose value is already at the field's own limit.
    """
    if not scores or math.isnan(scores[0].value):
        return []
    found = []
    for path in plan.paths:
        best = scores[0].setting.parameters[path]
        tried = [setting.parameters[path] for setting in plan.settings]
        if not all(_is_number(value) for value in tried) or min(tried) == max(tried) or min(tried) < best < max(tried):
            continue
        largest = best == max(tried)
        span = best - (min(tried) if largest else max(tried))
        if _matters(scores, path) and _goes_beyond(plan.base, path, best, span):
            found.append(Edge(path, best, largest))
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _matters(scores: Sequence[Score], path: str) -> bool:
    """Return whether settings that differ from the best only in this parameter are worse; True if there are none."""
    best = scores[0]

    def others(setting: Setting) -> tuple[str, dict[str, Any]]:
        return setting.method, {name: value for name, value in setting.values.items() if name != path}

    alike = [score for score in scores[1:] if others(score.setting) == others(best.setting)]
    return not alike or any(score.bad != best.bad or _rounded(score.value) != _rounded(best.value) for score in alike)


def _goes_beyond(base: Preset, path: str, best: float, span: float) -> bool:
    """Return whether the field allows a value slightly beyond the best one, in the direction of ``span``."""
    try:
        base.with_value(path, best + (span / 100 if isinstance(best, float) else 1 if span > 0 else -1))
    except PresetError:
        return False
    return True


def check_presentable(plan: Plan) -> None:
    """Raise if a method cannot be stored in a preset.

    Raises
    ------
    SweepError
        The message names the method.
    """
    for setting in plan.settings:
        if setting.method != FUSION and method_kind(setting.method).fields is None:
            raise SweepError(f"no preset can name the method {setting.method}; leave --best out, or the method")


def best_preset(plan: Plan, best: Score, objective: str) -> Preset:
    """Return a preset with the best parameters; its name and notes describe the sweep.

    Raises
    ------
    SweepError
        No run gave a value of the objective.
    """
    if math.isnan(best.value):
        raise SweepError(f"no run gave {objective}, so no parameters are best; see the failures in the table")
    setting = best.setting
    sources = list(dict.fromkeys(clip.source for clip in plan.clips))
    seeds = len({clip.seed for clip in plan.clips})
    values = ", ".join(f"{path} {json.dumps(value)}" for path, value in setting.values.items()) or "none"
    told = (
        f"Best of {len(plan.settings)} settings by {objective}: {best.value:.4g}, mean over {len(sources)} sources "
        f"and {seeds} seeds ({best.ms:.2f} ms a frame), {FOUND_BY} on {now():%Y-%m-%d}. "
        f"Method {setting.method}; swept: {values}. Sources: {'; '.join(sources)}."
    )
    notes = f"{plan.base.notes}\n\n{told}".strip()
    name = f"{plan.base.name[:90]}, best {objective}"
    preset = plan.base.with_values(setting.values | fields_of(setting.method) | {"name": name})
    return preset.model_copy(update={"notes": notes[-10_000:], "created": now(), "modified": now()})


def _rounded(value: float) -> float:
    """Round a value, so that settings that differ by rounding error only are ranked by time."""
    return float(f"{value:.9g}")


def _identity(method: str, parameters: dict[str, Any]) -> str:
    from .values import result_paths

    return json.dumps([method, [parameters[path] for path in result_paths()]])


def _over_sources(rows: Sequence[Row], column: str) -> float:
    """Return the mean over seeds, then over sources."""
    by_source: dict[str, list[float]] = {}
    for row in rows:
        if row[column] is not None:
            by_source.setdefault(row["source"], []).append(row[column])
    return fmean(map(fmean, by_source.values())) if by_source else math.nan


def _groups(scores: Sequence[Score], path: str) -> list[tuple[str, list[Score]]]:
    def value(score: Score) -> Any:
        return score.setting.method if path == "method" else score.setting.parameters[path]

    by_value: dict[str, list[Score]] = {}
    for score in scores:
        by_value.setdefault(json.dumps(value(score)), []).append(score)
    if len(by_value) <= _MAX_GROUPS or not all(isinstance(value(score), int | float) for score in scores):
        return sorted(by_value.items(), key=lambda item: _sortable(json.loads(item[0])))
    ordered = sorted(scores, key=value)
    cuts = [round(len(ordered) * part / _GROUPS) for part in range(_GROUPS + 1)]
    parts = [ordered[first:last] for first, last in itertools.pairwise(cuts) if last > first]
    return [(f"{value(part[0]):g} to {value(part[-1]):g}", part) for part in parts]


def _sortable(value: Any) -> tuple[str, Any]:
    return ("", value) if isinstance(value, int | float) else (str(type(value)), str(value))
