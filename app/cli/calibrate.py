"""The commands ``tactune calibrate`` (clicked points to an alignment) and ``tactune recheck`` (does it still hold?)."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from ...core.errors import CalibrationError, FrameError
from .common import (
    AveragedFrames,
    JsonOption,
    UntouchedSource,
    average_frames,
    emit,
    find_rig,
    open_with_progress,
    warn,
)

#: Exit status of ``recheck`` after a drift.
DRIFTED_STATUS = 1


def calibrate(
    *,
    points: Annotated[
        Path, typer.Option("--points", metavar="FILE", help="Clicked pairs: CSV as the wizard exports it.")
    ],
    rig: Annotated[
        str, typer.Option("--rig", metavar="FILE|SOURCE", help="A rig.json, a preset that has a rig, or a source.")
    ],
    model: Annotated[
        Literal["auto", "homography", "rigid"], typer.Option(help="auto: fit both and take the better one.")
    ] = "auto",
    depth_fit: Annotated[
        Literal["auto", "none", "offset"],
        typer.Option("--depth-fit", help="Also fit an offset of the tactile depth. auto: if it is certain."),
    ] = "auto",
    as_json: JsonOption = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="PRESET", help="Write the alignment into this preset, new or existing."),
    ] = None,
) -> None:
    """Fit the alignment to clicked points and report its quality."""
    from ...core.calibration import calibrate as fit
    from ...core.calibration import read_points
    from ...core.preset import Preset
    from ...core.preset.file import save_preset
    from ...core.sources.presets import load_preset

    pairs = read_points(points)
    cameras = find_rig(rig)
    base = None
    if out is not None:
        base = load_preset(out) if out.exists() else Preset().with_value("name", out.stem)
    report = fit(pairs, cameras, model, depth_fit=depth_fit)
    if out is not None and base is not None:
        save_preset(report.apply_to(base), out)
    emit(report.to_json(), report.words() + ("" if out is None else f"\nwrote {out}"), as_json)


def recheck(
    *,
    source: UntouchedSource,
    preset: Annotated[str, typer.Option("--preset", "-p", metavar="FILE|NAME", help="The preset to check.")],
    frames: AveragedFrames = 15,
    as_json: JsonOption = False,
) -> None:
    """Check whether the cameras have moved or the membrane's inflation has changed since the preset was made.

    The alignment is compared with both colour images, the membrane with the preset's untouched frame. Exit status 0
    if every check that could be made passes, 1 after a drift, 2 if nothing could be checked or the untouched frame that
    the preset names is missing. A warning names each check that could not be made. The simulator removes its object for
    this.
    """
    from ...core.calibration.recheck import recheck as recheck_alignment
    from ...core.rig.drift import compare_with_untouched
    from ...core.rig.untouched import load_untouched
    from ...core.sources.presets import load_preset

    checked = load_preset(preset)
    untouched = None if checked.untouched is None else load_untouched(checked.untouched, Path(preset))
    with open_with_progress(source, checked.cameras) as opened:
        now, rig = average_frames(opened, frames).frame, opened.rig
    found: dict[str, Any] = {}
    try:
        drift = recheck_alignment(checked, rig, now)
    except CalibrationError as error:
        warn(f"the alignment was not checked: {error}")
    else:
        numbers = {name: getattr(drift, name) for name in ("drift_px", "drift_mm", "worst_px", "stored", "found")}
        found["alignment"] = {"ok": not drift.recalibrate, "sentence": drift.sentence, **numbers}
    if untouched is None:
        warn(f"the membrane was not checked: {preset} has no untouched frame; see tactune preset capture-untouched")
    else:
        try:
            membrane = compare_with_untouched(checked, rig, now, untouched)
            found["membrane"] = {"ok": membrane.verdict == "fine", **asdict(membrane)}
        except (CalibrationError, FrameError) as error:
            warn(f"the membrane was not checked: {error}")
    if not found:
        raise CalibrationError(f"nothing of {preset} could be checked on {opened.name}; see the warnings above")
    emit(found, "\n".join(check["sentence"] for check in found.values()), as_json)
    if not all(check["ok"] for check in found.values()):
        raise typer.Exit(DRIFTED_STATUS)
