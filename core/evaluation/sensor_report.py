"""A table of sensors as text, Markdown, JSON and CSV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from ..model.files import atomic_path, finite_or_none, write_csv
from .sensor_cases import (
    BEST_FIXED,
    MAX_OVER_ORACLE,
    MIN_TOUCHED_MM2,
    ORACLE,
    SHOWN,
    SensorCase,
    SensorTable,
    finite_mean,
    worst_case,
)
from .sensor_table import AVERAGED, SHIPPED
from .table_cell import NO_CONTACT_FOUND, STRAIGHT
from .table_report import aligned, number_text

_NOTE: Final = (
    "RMSE: symmetric, in mm, mean over membranes, objects and seeds. t: the best fixed tolerance, one for all.\n"
    "oracle: the tolerance test with the best t of each frame, chosen with the truth. ratio: {shipped} / oracle,\n"
    "on frames where both have a patch. worst: the membrane with the largest ratio. empty: frames without a patch\n"
    "although at least {area:g} mm2 touch; in brackets those where less touches, which the mean leaves out.\n"
    "ms: median time per frame of {shipped} and {averaged}. mean: of the cases in which every method has a number."
)


def sensors_as_text(table: SensorTable) -> str:
    """Return the whole table as text."""
    parts = [_press(table, press) for press in table.presses]
    return "\n\n".join(
        [*parts, _NOTE.format(shipped=SHIPPED, averaged=AVERAGED, area=MIN_TOUCHED_MM2), _summary(table)]
    )


def sensors_as_json(table: SensorTable) -> dict[str, Any]:
    """Return the cases as JSON values; missing numbers are None."""
    return {
        "seeds": table.seeds,
        "best_fixed_t": finite_or_none(table.best_t),
        "max_over_oracle": MAX_OVER_ORACLE,
        "holds": not table.failing,
        "cases": [_record(case) for case in table.cases],
        "ms": {name: finite_or_none(table.median_ms(name)) for name in (STRAIGHT, SHIPPED, AVERAGED)},
    }


def write_report(table: SensorTable, folder: Path) -> list[Path]:
    """Write ``sensors.md``, ``sensors.csv`` (one line per case) and ``cells.csv`` (one line per table cell).

    Raises
    ------
    ExportError
        A file cannot be written.
    """
    paths = [folder / name for name in ("sensors.md", "sensors.csv", "cells.csv")]
    with atomic_path(paths[0]) as temporary:
        seeds = ", ".join(map(str, table.seeds))
        parts = ["# Sensors", f"Written by `tactune evaluate table --sensors`. Seeds: {seeds}.",
                 f"```\n{sensors_as_text(table)}\n```"]  # fmt: skip
        temporary.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    write_csv(paths[1], [_record(case) for case in table.cases])
    write_csv(paths[2], [asdict(cell) for cell in table.cells])
    return paths


def _press(table: SensorTable, press: str) -> str:
    """Return one block: the sensors at one press, and their mean."""
    methods = [STRAIGHT, f"t={table.best_t:g}", ORACLE, "membrane", "averaged"]
    title = [press, *methods, "ratio", "worst", "", "empty", "ms", "averaged ms"]
    lines = [_line(table, sensor, sensor, press) for sensor in table.sensors if table.pick(sensor, press)]
    return aligned([title, *lines, _line(table, "mean", "", press)])


def _line(table: SensorTable, name: str, sensor: str, press: str) -> list[str]:
    """Return one line; without a sensor, the mean over the cases in which every method has a number."""
    cases = table.pick(sensor, press)
    known = cases if sensor else [case for case in cases if all(map(math.isfinite, case.rmse_mm.values()))]
    worst = worst_case(cases)
    where = "" if worst is None else worst.membrane if sensor else f"{worst.sensor}, {worst.membrane}"
    empty, small = sum(case.empty + case.failed for case in cases), sum(case.empty_small for case in cases)
    return [
        name,
        *(number_text(finite_mean(case.rmse_mm[method] for case in known), 2) for method in SHOWN),
        number_text(finite_mean(case.over_oracle for case in known), 2),
        where,
        number_text(worst.over_oracle if worst is not None else math.nan, 2),
        f"{empty}" + (f" ({small})" if small else ""),
        number_text(table.median_ms(SHIPPED, sensor, press), 1),
        number_text(table.median_ms(AVERAGED, sensor, press), 1),
    ]


def _summary(table: SensorTable) -> str:
    """Return how many cases hold, and those that do not."""
    cases = table.cases
    lines = [
        f"{SHIPPED} <= tolerance test with t = {table.best_t:g}: {_count(cases, 'holds_best')}",
        f"{SHIPPED} <= {MAX_OVER_ORACLE:g} x oracle: {_count(cases, 'holds_oracle')}",
        f"a patch wherever {MIN_TOUCHED_MM2:g} mm2 touch: {_count(cases, 'holds_found')}",
        f"all three: {_count(cases, 'holds')}",
    ]
    if table.failing:
        lines += ["", "Cases that do not hold", aligned([_FAILING, *map(_failing, table.failing)])]
    errors = {
        f"{cell.sensor}, {cell.membrane}: {cell.failure}": None
        for cell in table.cells
        if cell.method == SHIPPED and cell.failure not in ("", NO_CONTACT_FOUND)
    }
    if errors:
        lines += ["", "Errors", *errors]
    return "\n".join(lines)


_FAILING: Final = ("sensor", "membrane", "press", "RMSE, mm", "/ best t", "/ oracle", "empty")


def _failing(case: SensorCase) -> Sequence[str]:
    def marked(ratio: float, holds: bool) -> str:
        return number_text(ratio, 3) + ("" if holds else " *")

    return (
        case.sensor,
        case.membrane,
        case.press,
        number_text(case.rmse_mm[SHIPPED], 2),
        marked(case.over_best, case.holds_best),
        marked(case.over_oracle, case.holds_oracle),
        f"{case.empty + case.failed} of {case.frames}" + ("" if case.holds_found else " *"),
    )


def _count(cases: Sequence[SensorCase], line: str) -> str:
    return f"{sum(getattr(case, line) for case in cases)} of {len(cases)} cases"


def _record(case: SensorCase) -> dict[str, Any]:
    names = {BEST_FIXED: "best_fixed", SHIPPED: "shipped", AVERAGED: "averaged"}
    return {
        "sensor": case.sensor,
        "membrane": case.membrane,
        "press": case.press,
        **{f"{names.get(method, method)}_mm": finite_or_none(case.rmse_mm[method]) for method in SHOWN},
        "over_best": finite_or_none(case.over_best),
        "over_oracle": finite_or_none(case.over_oracle),
        "frames": case.frames,
        "empty": case.empty,
        "empty_small": case.empty_small,
        "failed": case.failed,
        "holds": case.holds,
    }
