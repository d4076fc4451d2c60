"""The command ``tactune recheck``: whether a preset's calibration and reference still hold."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...core.errors import CalibrationError, FrameError

if TYPE_CHECKING:
    from ...core.rig.drift import MembraneDrift

#: Exit status where something has drifted.
DRIFTED_STATUS = 1


def recheck(
    *,
    source: Annotated[
        str, typer.Option("--source", "-s", metavar="SOURCE", help="Frames while nothing touches the membrane.")
    ],
    preset: Annotated[str, typer.Option("--preset", "-p", metavar="FILE|NAME", help="The preset to check.")],
    frames: Annotated[
        int, typer.Option("--frames", "-n", min=1, max=1000, metavar="N", help="How many frames to average.")
    ] = 15,
    as_json: Annotated[bool, typer.Option("--json", help="Print the measurements as JSON.")] = False,
) -> None:
    """Look whether the cameras have moved or the membrane's inflation has changed since the preset was made.

    The alignment is compared with what both colour cameras see, the untouched membrane with the preset's
    reference. Exit status 0 where what could be checked holds, 1 where something has
    drifted; what could not be checked is said. A reference that the preset names must be there. The simulator's object
    is taken away, so there only its noise differs.
    """
    from ...core.calibration.recheck import recheck as recheck_alignment
    from ...core.preset.file import load_preset
    from ...core.rig.drift import compare_with_reference
    from ...core.rig.untouched import load_reference
    from .reference import average
    from .run import open_with_progress, warn

    checked = load_preset(preset)
    reference = None if checked.reference is None else load_reference(checked.reference, Path(preset))
    with open_with_progress(source, checked.cameras) as opened:
        now, rig = average(opened, frames).frame, opened.rig
    found: dict[str, Any] = {}
    try:
        drift = recheck_alignment(checked, rig, now)
    except CalibrationError as error:
        warn(f"the alignment was not checked: {error}")
    else:
        numbers = {name: getattr(drift, name) for name in ("drift_px", "drift_mm", "worst_px", "stored", "found")}
        found["alignment"] = {"ok": not drift.recalibrate, "sentence": drift.sentence, **numbers}
    if reference is None:
        warn(f"the membrane was not checked: {preset} has no reference; see tactune preset capture-reference")
    else:
        try:
            found["membrane"] = _membrane_record(compare_with_reference(checked, rig, now, reference))
        except (CalibrationError, FrameError) as error:
            warn(f"the membrane was not checked: {error}")
    if not found:
        raise CalibrationError(f"nothing of {preset} could be checked on {opened.name}; see the reasons above")
    if as_json:
        typer.echo(json.dumps(found, indent=2, allow_nan=False))
    else:
        typer.echo("\n".join(check["sentence"] for check in found.values()))
    if not all(check["ok"] for check in found.values()):
        raise typer.Exit(DRIFTED_STATUS)


def _membrane_record(drift: MembraneDrift) -> dict[str, Any]:
    """Return the numbers, in metres as their names say."""
    return {"ok": drift.verdict == "fine", **asdict(drift)}
