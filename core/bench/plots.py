"""The benchmark's figures: milliseconds against error, and how cost grows."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ..errors import MissingExtraError
from ..model.files import atomic_path
from .growth import GrowthRow
from .registry import Job
from .run import Row

_MARKERS = "osD^vP*Xh<>p"


def draw_pareto(rows: list[Row], folder: Path) -> list[Path]:
    """Draw run time against RMSE for each scene with contact, as PNG and SVG.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    usable = [row for row in rows if row.job == Job.PIPELINE and math.isfinite(row.rmse_mm)]
    scenes = list(dict.fromkeys(row.scene for row in usable))
    if not scenes:
        return []
    plt = _matplotlib()
    columns = min(3, len(scenes))
    lines = -(-len(scenes) // columns)
    figure, axes = plt.subplots(lines, columns, figsize=(5 * columns, 4 * lines + 0.9), squeeze=False)
    names = list(dict.fromkeys(row.engine for row in usable))
    for axis, scene in zip(axes.flat, scenes, strict=False):
        for row in (row for row in usable if row.scene == scene):
            number = names.index(row.engine)
            axis.plot(
                row.timing.median_ms, row.rmse_mm, _MARKERS[number % len(_MARKERS)], color=f"C{number % 10}",
                markersize=8, label=row.engine,
            )  # fmt: skip
        axis.set(title=scene, xscale="log", xlabel="median of a frame, ms", ylabel="symmetric RMSE to truth, mm")
        axis.set_ylim(0.0, 1.08 * max(row.rmse_mm for row in usable if row.scene == scene))
        axis.grid(True, which="both", alpha=0.3)
    for axis in list(axes.flat)[len(scenes) :]:
        axis.axis("off")
    labels = {
        label: handle for axis in axes.flat for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(labels.values(), labels.keys(), loc="lower center", ncols=min(5, len(labels)), frameon=False)
    figure.tight_layout(rect=(0, 0.9 / (4 * lines + 0.9), 1, 1))
    return _save(plt, figure, folder, "run-time-against-error")


def draw_growth(points: list[GrowthRow], sizes: list[GrowthRow], folder: Path) -> list[Path]:
    """Draw how cost grows with the points in contact and with the image size, as PNG and SVG.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    plt = _matplotlib()
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2))
    for axis, rows, places, label in (
        (left, points, [row.points for row in points], "points in contact"),
        (right, sizes, [row.width * row.height for row in sizes], "pixels (a tenth in contact)"),
    ):
        for name in rows[0].timings if rows else ():
            axis.plot(places, [row.timings[name].median_ms for row in rows], "o-", label=name)
        axis.set(xscale="log", yscale="log", xlabel=label, ylabel="median of a frame, ms")
        axis.grid(True, which="both", alpha=0.3)
        axis.legend(frameon=False)
    figure.tight_layout()
    return _save(plt, figure, folder, "growth")


def _save(plt: Any, figure: Any, folder: Path, name: str) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.png", folder / f"{name}.svg"]
    for path in paths:
        with atomic_path(path) as temporary:
            figure.savefig(temporary, format=path.suffix[1:], dpi=110)
    plt.close(figure)
    return paths


def _matplotlib() -> Any:
    try:
        import matplotlib
    except ImportError as error:
        raise MissingExtraError("the figures need matplotlib: install it with pip install 'tactune[bench]'") from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
