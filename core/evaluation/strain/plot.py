"""Figures of strain: the curve against displacement, and the map of the last frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...model.figures import pyplot, save_figure
from .series import spikes
from .strain import StrainMeasurement


def draw_strain(
    displacement_mm: Sequence[float],
    length_percent: Sequence[float],
    width_percent: Sequence[float],
    last: StrainMeasurement,
    path: Path,
    solver_percent: Sequence[tuple[float, float]] = (),
) -> None:
    """Draw strain against displacement, and the strain at each dot of the last frame.

    Parameters
    ----------
    displacement_mm, length_percent, width_percent : sequence of float
        One value per frame, in order of time. Strains unlike those before and after are marked, not joined.
    last : StrainMeasurement
    path : Path
        A .png file.
    solver_percent : sequence of (float, float)
        True strain along length and width between visible dots, per frame; empty if unknown.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    ExportError
        The file cannot be written.
    """
    figure, (curve, *maps) = pyplot().subplots(1, 3, figsize=(15, 4.2))
    along = np.asarray(displacement_mm)
    for label, values, style in (("length", length_percent, "C0o-"), ("width", width_percent, "C1s-")):
        unlikely = spikes(along, values)
        likely = np.where(unlikely, np.nan, values)
        curve.plot(along, likely, style, markersize=4, linewidth=0.7, label=f"{label}, measured")
        curve.plot(along[unlikely], np.asarray(values)[unlikely], "kx")
    if solver_percent:
        for label, values, color in zip(
            ("length", "width"), np.transpose(solver_percent), ("navy", "maroon"), strict=True
        ):
            curve.plot(along, values, "--", color=color, label=f"{label}, solver at the dots seen")
    curve.set(xlabel="displacement, mm", ylabel="largest strain, %", title="Strain against displacement")
    curve.grid(True, alpha=0.3)
    curve.legend(fontsize=9)
    at_dots = 100 * last.at_dots()
    for axis, values, label in zip(maps, at_dots.T, ("length", "width"), strict=True):
        drawn = axis.scatter(*last.pixels.T, c=values, s=16, cmap="viridis")
        axis.set(title=f"Last frame: strain along the {label}, %", xlabel="u, px", ylabel="v, px", aspect="equal")
        axis.invert_yaxis()
        figure.colorbar(drawn, ax=axis, shrink=0.7)
    figure.tight_layout()
    save_figure(figure, path, dpi=110)
