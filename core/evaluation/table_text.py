"""The table as text, JSON and CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from ..model.files import atomic_path
from .cells import Cell
from .table import (
    CONFIDENCE,
    MEASURES,
    PAPER_RMSE_MM,
    PAPER_SECONDS,
    Average,
    Table,
    average,
    contacts_right,
    paper_method,
)

Line = Sequence[str]

_MEASURES_NOTE = (
    "boundary_px: mean distance between the outlines of patch and truth, proximity pixels; contacts right: share of\n"
    "scenes and seeds in which the patch has as many separate contacts as the truth."
)

_NOTE = (
    "Mean over seeds ± half of its 95 % confidence interval (Student's t-distribution over the seeds); left and right\n"
    "high presses are averaged first. Averages of a press are over its objects. Fail: no patch in any of the cells;\n"
    "* no patch in some of them, which are left out. The paper's figures are of other, real objects."
)


def table_as_text(table: Table) -> str:
    """Return the whole table for a person."""
    parts = [_averages(table), _rmse(table, "main"), _other_measures(table)]
    parts += [_rmse(table, "extra"), _false_points(table), _strains(table), _failures(table)]
    seeds = f"{len(table.seeds)} seeds" if len(table.seeds) != 1 else "1 seed"
    return "\n\n".join([part for part in parts if part] + [f"{seeds}. {_NOTE}"])


def table_as_json(table: Table) -> dict[str, Any]:
    """Return averages and cells, ready for JSON; what does not exist is None."""
    return {
        "seeds": table.seeds,
        "confidence": {"level": CONFIDENCE, "method": "Student's t-distribution over seeds"},
        "paper": {
            name: {"rmse_mm": dict(zip(("low", "medium", "high"), rmse, strict=True)), "seconds": PAPER_SECONDS[name]}
            for name, rmse in PAPER_RMSE_MM.items()
        },
        "averages": [line for method in table.methods for line in _average_records(table, method)],
        "ms": {method: _none(table.median_ms(method)) for method in table.methods},
        "strain": scene_strains(table),
        "cells": [asdict(cell) for cell in table.cells],
    }


def write_csv(table: Table, path: Path) -> None:
    """Write a line a cell, empty where a number does not exist; the file appears whole or not at all.

    Raises
    ------
    ExportError
        The place cannot be written.
    """
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Cell)])
        writer.writeheader()
        writer.writerows(asdict(cell) for cell in table.cells)


def _averages(table: Table) -> str:
    """Averages per press and times, the paper's beside them."""
    presses = table.presses()
    if not presses:
        return ""
    title = ["RMSE, mm", *presses, "ms", "|", "paper's", *presses, "ms"]
    lines = []
    for method in table.methods:
        paper = paper_method(method)
        mine = [_shown(average(table.pick(method, "main", press=press), "rmse_mm"), 2) for press in presses]
        known = dict(zip(("low", "medium", "high"), PAPER_RMSE_MM[paper], strict=True))
        theirs = [f"{known[press]:.2f}" for press in presses]
        lines.append(
            [method, *mine, _number(table.median_ms(method), 1), "|", paper, *theirs, f"{1e3 * PAPER_SECONDS[paper]:g}"]
        )
    return "Averages per press\n" + _aligned([title, *lines])


def _rmse(table: Table, group: str) -> str:
    """RMSE of each scene of a group."""
    rows = table.rows(group)
    if not rows:
        return ""
    lines = [["RMSE, mm", *(f"{row} {press}" for row, press in rows)]]
    for method in table.methods:
        averages = [average(table.pick(method, group, row, press), "rmse_mm") for row, press in rows]
        lines.append([method, *(_shown(it, 2) for it in averages)])
    return ("Each object\n" if group == "main" else "Further scenes\n") + _aligned(lines)


def _other_measures(table: Table) -> str:
    """All other measures, over all of the paper's cells."""
    if not table.rows("main"):
        return ""
    digits = {"iou": 3, "precision": 3, "recall": 3, "area_error_mm2": 0}
    names = [name for name in MEASURES if name != "rmse_mm"]
    lines = [["over all presses", *names, "contacts right"]]
    for method in table.methods:
        cells = table.pick(method, "main")
        shown = [_shown(average(cells, name), digits.get(name, 2)) for name in names]
        lines.append([method, *shown, f"{100 * contacts_right(cells):.0f} %"])
    return f"Other measures\n{_aligned(lines)}\n{_MEASURES_NOTE}"


def _false_points(table: Table) -> str:
    """Points where nothing touches."""
    rows = table.rows("hover")
    if not rows:
        return ""
    lines = [["false points at a gap of", *(f"{gap} mm" for _, gap in rows)]]
    for method in table.methods:
        averages = [average(table.pick(method, "hover", press=gap), "points") for _, gap in rows]
        lines.append([method, *(_shown(it, 0) for it in averages)])
    return "An object that hovers\n" + _aligned(lines)


def _strains(table: Table) -> str:
    """The largest in-plane strain of each scene."""
    scenes = scene_strains(table)
    if not scenes:
        return ""
    lines = [["largest in-plane strain, %", "along length", "along width", "any direction"]]
    for it in scenes:
        name = " ".join(filter(None, (it["scene"], it["press"], it["side"])))
        lines.append([name, *(f"{100 * it[key]:.0f}" for key in ("length", "width", "largest"))])
    return "Strain: between neighbours of a 10 mm grid, and of any triangle of the solver's mesh\n" + _aligned(lines)


def scene_strains(table: Table) -> list[dict[str, Any]]:
    """Return the solver's largest in-plane strain of each scene with contact where it is known, 0.1 for 10 %."""
    found: dict[tuple[str, str, str], dict[str, Any]] = {}
    for cell in table.cells:
        if cell.group != "hover" and cell.max_strain is not None:
            values = {"largest": cell.max_strain, "length": cell.strain_length, "width": cell.strain_width}
            scene = {"scene": cell.row, "press": cell.press, "side": cell.side}
            found.setdefault((cell.row, cell.press, cell.side), scene | values)
    return list(found.values())


def _failures(table: Table) -> str:
    """Every reason for a failure, once a method."""
    found: dict[tuple[str, str], list[str]] = {}
    for cell in table.cells:
        if cell.failure:
            found.setdefault((cell.method, cell.failure), []).append(f"{cell.row} {cell.press}")
    lines = [f"{method}: {', '.join(dict.fromkeys(scenes))}: {reason}" for (method, reason), scenes in found.items()]
    return "\n".join(["Failures", *lines]) if lines else ""


def _average_records(table: Table, method: str) -> list[dict[str, Any]]:
    records = []
    for press in table.presses():
        cells = table.pick(method, "main", press=press)
        records.append({"method": method, "press": press, **_measures(cells)})
    for group in ("main", "extra", "hover"):
        for row, press in table.rows(group):
            cells = table.pick(method, group, row, press)
            if cells:
                records.append({"method": method, "group": group, "scene": row, "press": press, **_measures(cells)})
    return records


def _measures(cells: list[Cell]) -> dict[str, Any]:
    measures: dict[str, Any] = {}
    for name in (*MEASURES, "points"):
        it = average(cells, name)
        measures[name] = {"mean": _none(it.mean), "low": _none(it.low), "high": _none(it.high)}
    failed = sum(1 for cell in cells if cell.failure)
    return {**measures, "contacts_right": _none(contacts_right(cells)), "cells": len(cells), "failed": failed}


def _shown(it: Average, digits: int) -> str:
    if it.cells and it.failed == it.cells:
        return "Fail"
    if not math.isfinite(it.mean):
        return "-"
    half = f"±{it.half_width:.{digits}f}" if math.isfinite(it.half_width) else ""
    return f"{it.mean:.{digits}f}{half}{'*' if it.failed else ''}"


def _number(number: float, digits: int) -> str:
    return f"{number:.{digits}f}" if math.isfinite(number) else "-"


def _none(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _aligned(lines: Sequence[Line]) -> str:
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
