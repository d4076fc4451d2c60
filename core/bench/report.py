"""All measurements as one page for people, docs/benchmarks.md."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ..model.files import atomic_path
from .gate import Check
from .growth import GrowthRow, growth_as_text
from .long_run import LongRunReport
from .measure import Timing
from .run import Row, rows_as_text
from .stability import StabilityReport
from .stages import StageRow


@dataclass(frozen=True)
class BenchReport:
    """Everything that one run of ``tactune bench --report`` has measured."""

    machine: str
    checks: list[Check]
    rows: list[Row]
    points: list[GrowthRow]
    sizes: list[GrowthRow]
    stages: list[StageRow]
    threads: dict[str, dict[int, Timing]]
    stability: StabilityReport
    long_run: LongRunReport


def write_report(report: BenchReport, path: Path, figures: Sequence[Path]) -> None:
    """Write the page; figures are linked relative to it.

    Raises
    ------
    ExportError
        The file cannot be written.
    """
    parts = [
        "# Benchmarks",
        "Written by `tactune bench --report docs/benchmarks.md`. Times are medians of engines that took turns in "
        f"one run; ratios compare within that run. {datetime.now(UTC):%Y-%m-%d}, {report.machine}.",
        "## What must hold",
        _code("\n".join(str(check) for check in report.checks)),
        "## Run time against error",
        "`ratio`: how many times faster than the baseline, which is the paper's pipeline in NumPy float64, OpenCV "
        "and Open3D. `differ`: pixels unlike the float64 reference. IoU and RMSE are against the scene's truth.",
        *(_image(figure, path) for figure in figures if figure.suffix == ".png"),
        _code(rows_as_text(report.rows)),
        "## Growth",
        _code(growth_as_text(report.points) + "\n\n" + growth_as_text(report.sizes)),
        "## Stages and threads",
        _code(_stages(report.stages) + "\n\n" + _threads(report.threads)),
        "## Numerical stability",
        f"{report.stability.words()}. {report.long_run.words()} (`tactune bench stability`).",
    ]
    with atomic_path(path) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", "utf-8")


def _code(text: str) -> str:
    return f"```\n{text}\n```"


def _image(figure: Path, page: Path) -> str:
    return f"![{figure.stem.replace('-', ' ')}]({Path(os.path.relpath(figure, page.parent)).as_posix()})"


def _stages(rows: list[StageRow]) -> str:
    names = list(rows[0].stage_ms) if rows else []
    lines = [f"{'ms a stage':<16}{'points':>10}" + "".join(f"{name:>12}" for name in names)]
    lines += [
        f"{row.scene:<16}{row.points:>10,}" + "".join(f"{row.stage_ms[name]:>12.3f}" for name in names) for row in rows
    ]
    return "\n".join(lines)


def _threads(scaling: dict[str, dict[int, Timing]]) -> str:
    counts: list[Any] = list(next(iter(scaling.values()))) if scaling else []
    lines = [f"{'threads':<16}" + "".join(f"{f'{count}, ms':>12}" for count in counts)]
    for scene, timings in scaling.items():
        lines.append(f"{scene:<16}" + "".join(f"{timings[count].median_ms:>12.3f}" for count in counts))
    return "\n".join(lines)
