"""The table as text and JSON, and the patches of one scene as a figure."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from ..errors import ExportError, TactuneError
from ..methods.registry import make_method
from ..model.arrays import Float32Array
from ..model.figures import pyplot, save_figure
from ..model.files import finite_or_none
from ..preset import Preset
from ..rig.untouched import untouched_frame
from ..sources.base import FrameSource
from ..sources.registry import open_source
from .metrics import symmetric_rmse_m, truth_cloud
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
from .table_cell import FRAMES_PER_CELL, NO_CONTACT_FOUND, MakeMethod, PlannedScene, TableCell, build_method

Line = Sequence[str]

_MEASURES_NOTE = (
    "boundary_px: mean distance between the outlines of patch and truth, proximity pixels; contacts right: share of\n"
    "scenes and seeds in which the patch has as many separate contacts as the truth."
)

_NOTE = (
    "Mean over seeds ± half of its 95 % confidence interval (Student's t-distribution over the seeds); left and right\n"
    "high presses are averaged first. Averages of a press are over its objects. Fail: no patch in any of the cells;\n"
    "* no patch in some of them, which the mean leaves out. The paper's figures are for other, real objects."
)
#: The true points, and by method either its points or an error message.
Panel = tuple[Float32Array, dict[str, Float32Array | str]]

#: Upper end of the colour scale, millimetres.
MAX_DISTANCE_MM: Final = 10.0
_SUFFIXES = (".png", ".svg", ".pdf")


def table_as_text(table: Table) -> str:
    """Return the whole table as text."""
    parts = [_averages(table), _rmse(table, "main"), _other_measures(table)]
    parts += [_rmse(table, "extra"), _false_points(table), _strains(table), _failures(table)]
    seeds = f"{len(table.seeds)} seeds" if len(table.seeds) != 1 else "1 seed"
    return "\n\n".join([part for part in parts if part] + [f"{seeds}. {_NOTE}"])


def table_as_json(table: Table) -> dict[str, Any]:
    """Return averages and cells as JSON values; missing numbers are None."""
    return {
        "seeds": table.seeds,
        "confidence": {"level": CONFIDENCE, "method": "Student's t-distribution over seeds"},
        "paper": {
            name: {"rmse_mm": dict(zip(("low", "medium", "high"), rmse, strict=True)), "seconds": PAPER_SECONDS[name]}
            for name, rmse in PAPER_RMSE_MM.items()
        },
        "averages": [line for method in table.methods for line in _average_records(table, method)],
        "ms": {method: finite_or_none(table.median_ms(method)) for method in table.methods},
        "strain": scene_strains(table),
        "cells": [asdict(cell) for cell in table.cells],
    }


def _averages(table: Table) -> str:
    """Return averages per press and times, with the paper's numbers."""
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
            [
                method,
                *mine,
                number_text(table.median_ms(method), 1),
                "|",
                paper,
                *theirs,
                f"{1e3 * PAPER_SECONDS[paper]:g}",
            ]
        )
    return "Averages per press\n" + aligned([title, *lines])


def _rmse(table: Table, group: str) -> str:
    """Return the RMSE of each scene of a group."""
    rows = table.rows(group)
    if not rows:
        return ""
    lines = [["RMSE, mm", *(f"{row} {press}" for row, press in rows)]]
    for method in table.methods:
        averages = [average(table.pick(method, group, row, press), "rmse_mm") for row, press in rows]
        lines.append([method, *(_shown(it, 2) for it in averages)])
    return ("Each object\n" if group == "main" else "Further scenes\n") + aligned(lines)


def _other_measures(table: Table) -> str:
    """Return all other measures, averaged over the paper's scenes."""
    if not table.rows("main"):
        return ""
    digits = {"iou": 3, "precision": 3, "recall": 3, "area_error_mm2": 0}
    names = [name for name in MEASURES if name != "rmse_mm"]
    lines = [["over all presses", *names, "contacts right"]]
    for method in table.methods:
        cells = table.pick(method, "main")
        shown = [_shown(average(cells, name), digits.get(name, 2)) for name in names]
        lines.append([method, *shown, f"{100 * contacts_right(cells):.0f} %"])
    return f"Other measures\n{aligned(lines)}\n{_MEASURES_NOTE}"


def _false_points(table: Table) -> str:
    """Return the number of false points of each gap without contact."""
    rows = table.rows("hover")
    if not rows:
        return ""
    lines = [["false points at a gap of", *(f"{gap} mm" for _, gap in rows)]]
    for method in table.methods:
        averages = [average(table.pick(method, "hover", press=gap), "points") for _, gap in rows]
        lines.append([method, *(_shown(it, 0) for it in averages)])
    return "An object that hovers\n" + aligned(lines)


def _strains(table: Table) -> str:
    """Return the largest in-plane strain of each scene."""
    scenes = scene_strains(table)
    if not scenes:
        return ""
    lines = [["largest in-plane strain, %", "along length", "along width", "any direction"]]
    for it in scenes:
        name = " ".join(filter(None, (it["scene"], it["press"], it["side"])))
        lines.append([name, *(f"{100 * it[key]:.0f}" for key in ("length", "width", "largest"))])
    return "Strain: between neighbours of a 10 mm grid, and of any triangle of the solver's mesh\n" + aligned(lines)


def scene_strains(table: Table) -> list[dict[str, Any]]:
    """Return the solver's largest in-plane strain of each scene with contact, where it is known; 0.1 is 10 %."""
    found: dict[tuple[str, str, str], dict[str, Any]] = {}
    for cell in table.cells:
        if cell.group != "hover" and cell.max_strain is not None:
            values = {"largest": cell.max_strain, "length": cell.strain_length, "width": cell.strain_width}
            scene = {"scene": cell.row, "press": cell.press, "side": cell.side}
            found.setdefault((cell.row, cell.press, cell.side), scene | values)
    return list(found.values())


def _failures(table: Table) -> str:
    """Return the failures of each method, equal ones once."""
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


def _measures(cells: list[TableCell]) -> dict[str, Any]:
    measures: dict[str, Any] = {}
    for name in (*MEASURES, "points"):
        it = average(cells, name)
        measures[name] = {
            "mean": finite_or_none(it.mean),
            "low": finite_or_none(it.low),
            "high": finite_or_none(it.high),
        }
    failed = sum(1 for cell in cells if cell.failure)
    return {**measures, "contacts_right": finite_or_none(contacts_right(cells)), "cells": len(cells), "failed": failed}


def _shown(it: Average, digits: int) -> str:
    if it.cells and it.failed == it.cells:
        return "Fail"
    if not math.isfinite(it.mean):
        return "-"
    half = f"±{it.half_width:.{digits}f}" if math.isfinite(it.half_width) else ""
    return f"{it.mean:.{digits}f}{half}{'*' if it.failed else ''}"


def number_text(number: float, digits: int) -> str:
    """Return a number with some digits, or - if it is nan."""
    return f"{number:.{digits}f}" if math.isfinite(number) else "-"


def aligned(lines: Sequence[Line]) -> str:
    """Return lines of cells as text: the first column to the left, the others to the right."""
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def check_plot(path: Path) -> None:
    """Check, before anything is measured, that the figure can be drawn.

    Raises
    ------
    ExportError
        The suffix is not supported.
    MissingExtraError
        matplotlib is not installed.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise ExportError(f"the figure {path} has the suffix {path.suffix!r}; choose {', '.join(_SUFFIXES)}")
    pyplot()


def draw_patches(
    path: Path,
    methods: Sequence[str],
    scenes: Sequence[PlannedScene],
    preset: Preset,
    seed: int,
    make: MakeMethod = make_method,
    open_scene: Callable[[str], FrameSource] = open_source,
) -> None:
    """Draw the patches of one seed: the truth in the first row, then one row per method; one column per scene.

    Raises
    ------
    ExportError, MissingExtraError
        See `check_plot`; or the file cannot be written.
    """
    check_plot(path)
    columns = [scene for scene in scenes if scene.side != "left" and scene.group != "hover"]
    panels = [_panel(scene, methods, preset, seed, make, open_scene) for scene in columns]
    plt = pyplot()
    rows = len(methods) + 1
    figure, axes = plt.subplots(
        rows, len(columns), figsize=(1.75 * len(columns) + 1.6, 1.45 * rows + 0.9), squeeze=False, layout="constrained"
    )
    drawn = None
    for column, (scene, (truth, found)) in enumerate(zip(columns, panels, strict=True)):
        limits = _limits([truth, *(points for points in found.values() if not isinstance(points, str))])
        axes[0, column].set_title(f"{scene.row}\n{scene.press}", fontsize=10)
        axes[0, column].scatter(1e3 * truth[:, 0], 1e3 * truth[:, 1], s=0.3, color="0.45", linewidths=0)
        for row, method in enumerate(methods, start=1):
            drawn = _draw_one(axes[row, column], found[method], truth) or drawn
        for axis in axes[:, column]:
            axis.set(xlim=limits[0], ylim=limits[1][::-1], aspect="equal", xticks=[], yticks=[])
    for axis, name in zip(axes[:, 0], ("truth", *methods), strict=True):
        axis.set_ylabel(name, fontsize=9, rotation=0, ha="right", va="center")
    if drawn is not None:
        figure.colorbar(drawn, ax=axes, shrink=0.6, label="distance to the truth, mm", extend="max")
    figure.supxlabel(
        f"Under each patch: its RMSE in this one frame, with the noise of seed {seed};\n"
        "the table has means over all seeds, and over both sides of high presses.",
        fontsize=8,
    )
    save_figure(figure, path, dpi=130, bbox_inches="tight")


def _draw_one(axis: Any, points: Float32Array | str, truth: Float32Array) -> Any:
    """Draw one method's patch with its RMSE, or 'Fail'."""
    if isinstance(points, str):
        axis.text(0.5, 0.5, "Fail", transform=axis.transAxes, ha="center", va="center", color="crimson", fontsize=11)
        return None
    away_mm = 1e3 * np.asarray(cKDTree(truth).query(points)[0])
    order = np.argsort(away_mm)  # largest distances on top
    drawn = axis.scatter(
        1e3 * points[order, 0], 1e3 * points[order, 1], c=away_mm[order], s=0.3, linewidths=0,
        cmap="viridis", vmin=0, vmax=MAX_DISTANCE_MM,
    )  # fmt: skip
    axis.set_xlabel(f"{1e3 * symmetric_rmse_m(points, truth):.2f} mm", fontsize=8, labelpad=2)
    return drawn


def _panel(
    scene: PlannedScene,
    methods: Sequence[str],
    preset: Preset,
    seed: int,
    make: MakeMethod,
    open_scene: Callable[[str], FrameSource],
) -> Panel:
    """Return the truth and every method's patch in the scored frame of a scene."""
    with open_scene(f"{scene.source}&seed={seed}") as source:
        untouched, frames = untouched_frame(source), list(itertools.islice(source, FRAMES_PER_CELL))
        if not frames or frames[-1].truth is None:
            raise TactuneError(
                f"{source.name} gives no frame with ground truth, so it cannot be drawn; choose a simulated source"
            )
        truth = truth_cloud(frames[-1].truth, source.rig).points
        found: dict[str, Float32Array | str] = {}
        for name in methods:
            try:
                method = build_method(name, preset, source.rig, untouched, make)
                patch = [method.find(frame) for frame in frames[-method.remembers :]][-1]
            except TactuneError as error:
                found[name] = str(error)
            else:
                found[name] = patch.points if len(patch.points) else patch.failure or NO_CONTACT_FOUND
        return truth, found


def _limits(clouds: Sequence[Float32Array]) -> list[tuple[float, float]]:
    """Return limits of x and y, millimetres, that contain all clouds."""
    everything = np.concatenate([cloud[:, :2] for cloud in clouds]) * 1e3
    low, high = everything.min(axis=0) - 5.0, everything.max(axis=0) + 5.0
    return list(zip(low.tolist(), high.tolist(), strict=True))
