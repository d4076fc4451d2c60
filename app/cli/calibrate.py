"""The command ``tactune calibrate``: clicked points in, alignment and quality report out."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Model(StrEnum):
    """What is fitted."""

    AUTO = "auto"
    HOMOGRAPHY = "homography"
    RIGID = "rigid"


def calibrate(
    *,
    points: Annotated[
        Path,
        typer.Option("--points", metavar="FILE", help="Clicked pairs: CSV as the wizard exports it, or QGIS .points."),
    ],
    rig: Annotated[
        str, typer.Option("--rig", metavar="FILE|SOURCE", help="A rig.json, a preset that has a rig, or a source.")
    ],
    model: Annotated[Model, typer.Option(help="auto: fit both and take the better one.")] = Model.AUTO,
    depth_scale: Annotated[
        bool, typer.Option("--depth-scale", help="Fit a scale and an offset of the tactile depth, too.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="PRESET", help="Write the alignment into this preset, new or existing."),
    ] = None,
) -> None:
    """Fit the alignment to clicked points and say how good it is."""
    from ...core.calibration import calibrate as fit
    from ...core.calibration import read_points
    from ...core.preset import Preset
    from ...core.preset.file import load_preset, save_preset
    from .preset import find_rig

    pairs = read_points(points)
    cameras = find_rig(rig)
    base = None
    if out is not None:
        base = load_preset(out) if out.exists() else Preset().with_value("name", out.stem)
    report = fit(pairs, cameras, model.value, depth_scale=depth_scale)
    if out is not None and base is not None:
        save_preset(report.apply_to(base), out)
    if as_json:
        typer.echo(json.dumps(report.to_json(), indent=2, allow_nan=False))
    else:
        typer.echo(report.words())
        if out is not None:
            typer.echo(f"wrote {out}")
