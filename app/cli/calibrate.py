"""The commands ``tactune calibrate``, ``tactune check`` and ``tactune preset create-rig``."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Literal

import typer

from ...core.errors import CalibrationError
from .common import (
    PresetOption,
    UntouchedSource,
    average_frames,
    chosen_preset,
    find_rig,
    measured_elsewhere,
    open_with_progress,
    say,
    warn,
)

#: Exit status of ``check`` after a drift.
DRIFTED_STATUS = 1
_LENS_HELP = (
    "Lens of the {} camera, perhaps with its model: [MODEL=]FILE of ROS, Kalibr (FILE:cam0) or OpenCV, or K.txt, "
    "[MODEL=]fx,fy,cx,cy in px, [MODEL=]DIR with pictures of a chessboard, MODEL (L515, D405 or D435) for the maker's "
    "values."
)


def calibrate(
    *,
    points: Annotated[Path, typer.Option(metavar="FILE", help="Clicked pairs: CSV as the wizard exports it.")],
    rig: Annotated[str, typer.Option(metavar="FILE|SOURCE", help="A rig.json, a preset that has a rig, or a source.")],
    model: Annotated[
        Literal["auto", "homography", "rigid"], typer.Option(help="auto: fit both and take the better one.")
    ] = "auto",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="PRESET", help="Write the alignment into this preset, new or existing."),
    ] = None,
) -> None:
    """Fit the alignment to clicked points and report its quality."""
    from ...core.calibration.calibrate import calibrate as fit
    from ...core.calibration.points import read_points
    from ...core.preset import Preset
    from ...core.preset.file import save_preset
    from ...core.sources.presets import load_preset

    pairs = read_points(points)
    cameras = find_rig(rig)
    base, new = None, False
    if out is not None:
        new = not out.exists()
        base = Preset().with_value("name", out.stem) if new else load_preset(out)
    report = fit(pairs, cameras, model)
    if out is not None and base is not None:
        save_preset(report.apply_to(base), out, exclusive=new)
        if left := measured_elsewhere(base, cameras):
            warn(f"{out} was made for other cameras; if its {left} were measured on them, measure them again")
    if as_json:
        typer.echo(json.dumps(report.to_json(), indent=2, allow_nan=False))
    else:
        say(report.words() + ("" if out is None else f"\nwrote {out}"))


def check(
    *,
    source: UntouchedSource,
    preset: PresetOption = None,
) -> None:
    """Check whether the cameras or the membrane have changed.

    For a robot's start: have the cameras moved, or the inflation, since the preset was made? The alignment is compared
    with both colour images, the membrane with the preset's untouched frame. Prints one line. Exit status: 0 if all that
    could be checked is still good; 1 after a drift; 2 if nothing could be checked, something touches the membrane, or
    the preset's untouched frame is missing. A warning names what was not checked. A recording is searched for where
    nothing touches; the simulator removes its object for this.
    """
    from ...core.rig.untouched import load_untouched

    checked, origin = chosen_preset(preset, source)
    untouched = None
    if checked.untouched is not None:
        untouched = load_untouched(checked.untouched, Path(origin))  # if it is missing, before the source is opened
    with open_with_progress(source, checked) as opened:
        from ...core.rig.drift import check_rig  # after a wrong source was told

        found = check_rig(checked, Path(origin), opened.rig, average_frames(opened).frame, untouched)
    if found.state == "unknown":
        raise CalibrationError(found.sentence)
    warn(*found.unchecked)
    say(found.sentence)
    if found.state == "drifted":
        raise typer.Exit(DRIFTED_STATUS)


def create_rig(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Images of one frame, numbered subfolders, or rgb and depth (TUM, BOP)."),
    ],
    *,
    proximity: Annotated[str | None, typer.Option(metavar="LENS", help=_LENS_HELP.format("proximity"))] = None,
    tactile: Annotated[str | None, typer.Option(metavar="LENS", help=_LENS_HELP.format("tactile"))] = None,
    color: Annotated[
        str | None,
        typer.Option(metavar="LENS", help="The same of the proximity colour, where it is not aligned to the depth."),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(
            metavar="UNIT",
            help="Length of a depth count: mm, metres such as 0.00025 or 1/5000, or proximity=UNIT,tactile=UNIT.",
        ),
    ] = None,
    corners: Annotated[str, typer.Option(metavar="CxR", help="Inner corners of the chessboard.")] = "9x6",
) -> None:
    """Write the rig.json of a folder of images.

    What files beside the images state is taken from them, such as BOP's scene_camera.json. What is assumed or missing
    is said. Without a camchain of both cameras their pose is a matter of tactune calibrate.
    """
    from ...core.calibration.rig_from_folder import rig_from_folder
    from ...core.sources.folder import write_rig

    board = re.fullmatch(r"([0-9]{1,3})x([0-9]{1,3})", corners)
    if board is None:
        raise typer.BadParameter(f"--corners is {corners!r}; write the inner corners as 9x6")
    options = {"proximity": proximity, "tactile": tactile, "color": color}
    found = rig_from_folder(folder, options, unit, (int(board[1]), int(board[2])))
    warn(*found.warnings)
    write_rig(folder, found.rig, found.forms)
    say("\n".join([*found.notes, f"wrote {folder / 'rig.json'}"]))
