"""The commands ``tactune preset new | show | validate | schema | capture-reference``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...core.errors import PresetError, SourceError, TactuneError

if TYPE_CHECKING:
    from ...core.model.frames import Rig
    from ...core.preset import Preset

preset_commands = typer.Typer(
    help="Make, show and check presets.", no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False
)


@preset_commands.command()
def new(
    *,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The preset file to write.")],
    start: Annotated[
        str | None,
        typer.Option("--from", metavar="FILE|NAME", help="A preset to start from; default: the paper's values."),
    ] = None,
    rig: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|SOURCE",
            help="The rig it is for: a rig.json, another preset, or a source of frames; default: that of --from.",
        ),
    ] = None,
    alignment: Annotated[
        str | None, typer.Option(metavar="homography|rigid", help="Short for --set alignment.model=...")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="FIELD=VALUE",
            help="Any field by its path, such as mask.hue=[150,170] or tolerance.t=0.01; may be repeated. "
            "Setting a field of mask, outliers, range or region turns that section on, one of membrane chooses "
            "that contact test.",
        ),
    ] = None,
    name: Annotated[str | None, typer.Option(metavar="NAME", help="Default: the file's name.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is already there.")] = False,
) -> None:
    """Write a new preset: the paper's values or another preset's, changed as you say."""
    from ...core.preset import Preset, now
    from ...core.preset.file import load_preset, save_preset
    from ...core.rig.untouched import copy_reference
    from .settings import parse_settings

    if out.exists() and not force:
        raise PresetError(f"{out} is already there; choose another name or add --force to replace it")
    values: dict[str, Any] = {"name": name or out.stem}
    if alignment is not None:
        values["alignment.model"] = alignment
    values |= parse_settings(settings or [])
    base = Preset() if start is None else load_preset(start)
    made_for = base.rig if rig is None else find_rig(rig)
    if made_for is None:
        given = "the paper's values name" if start is None else f"the preset {start} names"
        raise PresetError(f"{given} no rig; add --rig with a rig.json, another preset or a source of frames")
    preset = base.model_copy(update={"rig": made_for, "created": now(), "modified": now()}).with_values(values)
    if start is not None and preset.reference is not None:
        copy_reference(preset.reference, Path(start), out)
    save_preset(preset, out)
    typer.echo(f"wrote {out}")
    if base.rig is not None and base.rig != made_for:
        note = f"cameras, alignment and reference are still those of {start}, made for another rig; calibrate anew."
        typer.echo(f"note: {note}", err=True)
    _tell_notes(preset)


@preset_commands.command()
def show(preset: Annotated[str, typer.Argument(metavar="FILE|NAME", help="A file or a shipped preset.")]) -> None:
    """Print a preset as JSON, brought to the present schema version."""
    from ...core.preset.file import load_preset, preset_json

    typer.echo(preset_json(load_preset(preset)), nl=False)


@preset_commands.command()
def validate(presets: Annotated[list[str], typer.Argument(metavar="FILE...")]) -> None:
    """Check preset files; the exit status is 2 if one of them cannot be used."""
    from ...core.preset.file import load_preset_and_note

    bad = 0
    for origin in presets:
        try:
            preset, older = load_preset_and_note(origin)
        except TactuneError as error:
            bad += 1
            typer.echo(f"tactune: {error}", err=True)
        else:
            typer.echo(f"{origin}: good, {_describe(preset)}" + (f", {older}" if older else ""))
            _tell_notes(preset)
    if bad:
        raise typer.Exit(2)


@preset_commands.command("capture-reference")
def capture_reference(
    *,
    source: Annotated[
        str, typer.Option("--source", "-s", metavar="SOURCE", help="Frames while nothing touches the membrane.")
    ],
    preset: Annotated[Path, typer.Option("--preset", "-p", metavar="FILE", help="The preset file to put it into.")],
    frames: Annotated[
        int, typer.Option("--frames", "-n", min=1, max=1000, metavar="N", help="How many frames to average.")
    ] = 15,
    force: Annotated[bool, typer.Option("--force", help="Keep it though the preset finds contact on it.")] = False,
) -> None:
    """Average frames of the untouched membrane into a preset's reference, for methods and checks that compare with it.

    Frames in which the preset itself finds contact are refused. The simulator takes its object away meanwhile. The
    reference is a file beside the preset.
    """
    from .reference import capture_into

    capture_into(preset, source, frames, force=force)


@preset_commands.command()
def schema() -> None:
    """Print the JSON Schema of preset files."""
    from ...core.preset.file import json_schema

    typer.echo(json.dumps(json_schema(), indent=2))


def find_rig(name: str) -> Rig:
    """Return the rig of a rig file, of a preset or of a source of frames."""
    from ...core.model.rig_file import load_rig, read_json_object
    from ...core.preset.file import load_preset

    path = Path(name)
    if path.is_file() and path.suffix == ".json":
        if "schema" not in read_json_object(path):
            return load_rig(path)
        rig = load_preset(path).rig
        if rig is None:
            raise SourceError(f"the preset {path} serves any rig and names none; give a rig.json or a source of frames")
        return rig

    from .run import open_with_progress

    with open_with_progress(name) as source:
        return source.rig


def _tell_notes(preset: Preset) -> None:
    from ...core.preset.notes import preset_notes

    for sentence in preset_notes(preset):
        typer.echo(f"note: {sentence}", err=True)


def _describe(preset: Preset) -> str:
    cameras = (
        f"for {preset.rig.proximity.model} {preset.rig.proximity.serial} and "
        f"{preset.rig.tactile.model} {preset.rig.tactile.serial}".replace("  ", " ").rstrip()
        if preset.rig
        else "for any rig"
    )
    return f"preset {preset.name!r} {cameras}"
