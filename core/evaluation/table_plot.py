"""The table's figure: every method's patches in a grid, coloured by how far they are from the truth."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from ..errors import ExportError, MissingExtraError, TactuneError
from ..methods.registry import make_method
from ..model.arrays import Float32Array
from ..model.files import atomic_path
from ..preset import Preset
from ..rig.untouched import untouched_frame
from ..sources.base import FrameSource
from ..sources.registry import open_source
from .cells import FRAMES_A_CELL, NO_CONTACT_FOUND, MakeMethod, build_method
from .metrics import symmetric_rmse_m, truth_cloud
from .scene_plan import PlannedScene

#: Truth and, by method, points or the reason why there are none.
Panel = tuple[Float32Array, dict[str, Float32Array | str]]

#: Where the colours end, millimetres.
FARTHEST_MM: Final = 10.0
_SUFFIXES = (".png", ".svg", ".pdf")


def check_plot(path: Path) -> None:
    """Refuse before anything is measured what could not be drawn afterwards.

    Raises
    ------
    ExportError
        The suffix is none that can be drawn.
    MissingExtraError
        matplotlib is not installed.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise ExportError(f"the figure {path} has the suffix {path.suffix!r}; choose {', '.join(_SUFFIXES)}")
    _matplotlib()


def draw_patches(
    path: Path,
    methods: Sequence[str],
    scenes: Sequence[PlannedScene],
    preset: Preset,
    seed: int,
    make: MakeMethod = make_method,
    open_scene: Callable[[str], FrameSource] = open_source,
) -> None:
    """Draw the patches of one seed: a row a method under the truth, a column an object and press.

    Raises
    ------
    ExportError, MissingExtraError
        As `check_plot`, or the place cannot be written.
    """
    check_plot(path)
    columns = [scene for scene in scenes if scene.side != "left" and scene.group != "hover"]
    panels = [_panel(scene, methods, preset, seed, make, open_scene) for scene in columns]
    plt = _matplotlib()
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
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format=path.suffix[1:].lower(), dpi=130, bbox_inches="tight")
    plt.close(figure)


def _draw_one(axis: Any, points: Float32Array | str, truth: Float32Array) -> Any:
    """Draw one method's patch, and its RMSE or why there is none."""
    if isinstance(points, str):
        axis.text(0.5, 0.5, "Fail", transform=axis.transAxes, ha="center", va="center", color="crimson", fontsize=11)
        return None
    away_mm = 1e3 * np.asarray(cKDTree(truth).query(points)[0])
    order = np.argsort(away_mm)  # the worst on top
    drawn = axis.scatter(
        1e3 * points[order, 0], 1e3 * points[order, 1], c=away_mm[order], s=0.3, linewidths=0,
        cmap="viridis", vmin=0, vmax=FARTHEST_MM,
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
    """Find every method's patch in the frame of a scene that the table judges."""
    with open_scene(f"{scene.source}&seed={seed}") as source:
        untouched, frames = untouched_frame(source), list(itertools.islice(source, FRAMES_A_CELL))
        if not frames or frames[-1].truth is None:
            raise TactuneError(
                f"{source.name} gives no frame with truth, so it cannot be drawn; choose a simulated one"
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
    """Return limits of x and y in mm that show all clouds."""
    everything = np.concatenate([cloud[:, :2] for cloud in clouds]) * 1e3
    low, high = everything.min(axis=0) - 5.0, everything.max(axis=0) + 5.0
    return list(zip(low.tolist(), high.tolist(), strict=True))


def _matplotlib() -> Any:
    try:
        import matplotlib
    except ImportError as error:
        raise MissingExtraError("the figure needs matplotlib: install it with pip install 'tactune[bench]'") from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
