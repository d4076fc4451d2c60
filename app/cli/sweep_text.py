"""A sweep's outcome in words and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from ...core.tuning.best import OBJECTIVES, Edge, Effect, Score
from ...core.tuning.plan import Plan
from ...core.tuning.table import Row
from .patch_record import finite_or_none

#: Settings that are shown.
TOP: Final = 10

_UNITS: Final = {"rmse_mm": "mm", "area_error": "mm2", "area": "mm2", "ms": "ms a frame"}


def print_outcome(
    plan: Plan, scores: Sequence[Score], effects: Iterable[Effect], edges: Iterable[Edge], objective: str
) -> None:
    """Print the best settings and what each parameter does."""
    console = Console(highlight=False, soft_wrap=True)
    larger = OBJECTIVES[objective][1]
    heading = (
        f"{objective}{f' ({_UNITS[objective]})' if objective in _UNITS else ''}, {'most' if larger else 'least'} first"
    )
    best = Table(title=f"Best {min(TOP, len(scores))} of {len(scores)} settings by {heading}", box=SIMPLE,
                 title_justify="left")  # fmt: skip
    names = _columns(plan)
    for name in names:
        best.add_column(name, no_wrap=True)
    for name in (objective, *["ms"] * (objective != "ms"), "failed or missed"):
        best.add_column(name, justify="right", no_wrap=True)
    for score in scores[:TOP]:
        times = [_number(score.ms)] * (objective != "ms")
        best.add_row(*(_value(score, name) for name in names), _number(score.value), *times, str(score.bad))
    console.print(best)
    by_value = Table(title=f"Mean {objective} over all other parameters", box=SIMPLE, title_justify="left")
    for name in ("parameter", "value"):
        by_value.add_column(name, no_wrap=True)
    for name in (objective, "runs"):
        by_value.add_column(name, justify="right")
    shown = ""
    for effect in effects:
        by_value.add_row("" if effect.path == shown else effect.path, effect.label, _number(effect.value),
                         str(effect.runs))  # fmt: skip
        shown = effect.path
    if shown:
        console.print(by_value)
    for edge in edges:
        console.print(f"{edge.sentence[:1].upper()}{edge.sentence[1:]}.")


def outcome_as_json(
    plan: Plan,
    scores: Sequence[Score],
    effects: Iterable[Effect],
    edges: Iterable[Edge],
    objective: str,
    rows: Sequence[Row],
    out: Path,
) -> dict[str, Any]:
    """Return the same as `print_outcome` shows, for programs."""
    return {
        "runs": len(rows),
        "failed": sum(bool(row["failure"]) for row in rows),
        "out": str(out),
        "objective": objective,
        "top": [
            {
                "method": score.setting.method,
                "values": score.setting.values,
                "value": finite_or_none(score.value),
                "ms": finite_or_none(score.ms),
                "failed_or_missed": score.bad,
                "runs": score.runs,
            }
            for score in scores[:TOP]
        ],
        "effects": [
            {"parameter": effect.path, "value": effect.label, "mean": effect.value, "runs": effect.runs}
            for effect in effects
        ],
        "at_edge": [
            {"parameter": edge.path, "value": edge.value, "edge": "largest" if edge.largest else "smallest"}
            for edge in edges
        ],
    }


def _columns(plan: Plan) -> list[str]:
    several = len({setting.method for setting in plan.settings}) > 1
    return [*["method"] * several, *plan.paths]


def _value(score: Score, name: str) -> str:
    if name == "method":
        return score.setting.method
    value = score.setting.values[name]
    return value if isinstance(value, str) else json.dumps(value)


def _number(number: float) -> str:
    return "-" if math.isnan(number) else f"{number:.4g}"
