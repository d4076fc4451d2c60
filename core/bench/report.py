"""All measurements as one page, docs/benchmarks.md, with its figures."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from ..model.figures import pyplot, save_figure
from ..model.files import atomic_path
from .gate import Check
from .registry import Job
from .run import Row, rows_as_text
from .sensors import SensorTiming
from .stability import LongRunReport, StabilityReport

_MARKERS = "osD^vP*Xh<>p"


@dataclass(frozen=True)
class BenchReport:
    """All results of one run of ``tactune bench --report``."""

    machine: str
    checks: list[Check]
    rows: list[Row]
    stability: StabilityReport
    long_run: LongRunReport


def write_report(report: BenchReport, path: Path, figures: Sequence[Path]) -> None:
    """Write the page with relative links to the figures.

    Raises
    ------
    ExportError
        The file cannot be written.
    """
    parts = [
        "# Benchmarks",
        "Written by `tactune bench --report docs/benchmarks.md`. Times are medians of engines that took turns in "
        f"one run; ratios compare within that run. {datetime.now(UTC):%Y-%m-%d}, {report.machine}.",
        "## Requirements",
        _code("\n".join(str(check) for check in report.checks)),
        "## Run time against error",
        "`ratio`: speed relative to the baseline, which is the paper's pipeline in NumPy float64, OpenCV and Open3D. "
        "`differ`: pixels that differ from the float64 reference. IoU and RMSE compare with the ground truth.",
        *(_image(figure, path) for figure in figures if figure.suffix == ".png"),
        _code(rows_as_text(report.rows)),
        "## Numerical stability",
        f"{report.stability.words()}. {report.long_run.words()} (`tactune bench stability`).",
    ]
    with atomic_path(path) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", "utf-8")


def _code(text: str) -> str:
    return f"```\n{text}\n```"


def _image(figure: Path, page: Path) -> str:
    return f"![{figure.stem.replace('-', ' ')}]({Path(os.path.relpath(figure, page.parent)).as_posix()})"


def draw_pareto(rows: list[Row], folder: Path) -> list[Path]:
    """Draw run time against RMSE for each scene with contact; return the PNG and SVG files.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    usable = [row for row in rows if row.job == Job.PIPELINE and math.isfinite(row.rmse_mm)]
    points = [(row.scene, row.engine, row.timing.median_ms, row.rmse_mm) for row in usable]
    return _draw_error_over_time(points, folder, "run-time-against-error")


def draw_sensors(timings: Sequence[SensorTiming], folder: Path) -> list[Path]:
    """Draw run time against RMSE for each sensor, one point per tolerance; return the PNG and SVG files.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    points = [(it.sensor, it.test, it.ms, it.rmse_mm) for it in timings]
    return _draw_error_over_time(points, folder, "sensors")


def _draw_error_over_time(points: list[tuple[str, str, float, float]], folder: Path, name: str) -> list[Path]:
    """Draw points (panel, series, ms, RMSE in mm): one panel for each scene or sensor."""
    panels = list(dict.fromkeys(panel for panel, *_ in points))
    if not panels:
        return []
    plt = pyplot()
    columns = min(3, len(panels))
    lines = -(-len(panels) // columns)
    figure, axes = plt.subplots(lines, columns, figsize=(5 * columns, 4 * lines + 0.9), squeeze=False)
    names = list(dict.fromkeys(series for _, series, *_ in points))
    for axis, title in zip(axes.flat, panels, strict=False):
        for number, series in enumerate(names):
            mine = [(ms, rmse_mm) for panel, its, ms, rmse_mm in points if (panel, its) == (title, series)]
            if mine:
                axis.plot(
                    *zip(*mine, strict=True), _MARKERS[number % len(_MARKERS)], color=f"C{number % 10}",
                    markersize=8 if len(mine) == 1 else 4, label=series,
                )  # fmt: skip
        axis.set(title=title, xscale="log", xlabel="median of a frame, ms", ylabel="symmetric RMSE to truth, mm")
        axis.set_ylim(0.0, 1.08 * max(rmse_mm for panel, _, _, rmse_mm in points if panel == title))
        axis.grid(True, which="both", alpha=0.3)
    for axis in list(axes.flat)[len(panels) :]:
        axis.axis("off")
    labels = {
        label: handle for axis in axes.flat for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(labels.values(), labels.keys(), loc="lower center", ncols=min(5, len(labels)), frameon=False)
    figure.tight_layout(rect=(0, 0.9 / (4 * lines + 0.9), 1, 1))
    paths = [folder / f"{name}.png", folder / f"{name}.svg"]
    save_figure(figure, *paths, dpi=110)
    return paths
