"""The commands ``tactune preset new | show | validate | schema`` and those that measure the rig into a preset."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...core.errors import CalibrationError, PresetError, RigMismatchError, counted
from .common import (
    CliProgress,
    PresetOption,
    SetOption,
    UntouchedSource,
    average_frames,
    chosen_preset,
    counted_out,
    find_rig,
    live_frames,
    measured_elsewhere,
    number_of_frames,
    open_pipeline,
    open_with_progress,
    parse_settings,
    refuse_existing,
    say,
    stop_on_signals,
    tell_notes,
    warn,
)

if TYPE_CHECKING:
    from ...core.preset import Preset

#: Number of frames of which the rig's noise is measured.
_MEASURED = 60

_MeasuredOut = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="FILE", help="The preset file to write; default: the file of --preset."),
]

preset_commands = typer.Typer(help="Make, show, check and improve presets and rigs.", no_args_is_help=True)


@preset_commands.command()
def new(
    *,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The preset file to write.")],
    start: Annotated[
        str | None,
        typer.Option("--from", metavar="FILE|NAME", help="The preset to start from; default: the paper's values."),
    ] = None,
    rig: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|SOURCE",
            help="The preset's rig: a rig.json, another preset, or a source of frames; default: that of --from.",
        ),
    ] = None,
    settings: SetOption = None,
) -> None:
    """Write a new preset. It has the paper's values or those of another preset, changed by --set."""
    from ...core.contact.checks import for_rig
    from ...core.preset import Preset, now
    from ...core.preset.file import save_preset
    from ...core.rig.untouched import copy_untouched
    from ...core.sources.presets import load_preset

    refuse_existing(out)
    values = {"name": out.stem, **parse_settings(settings)}
    base = Preset() if start is None else load_preset(start)
    made_for = base.rig if rig is None else find_rig(rig)
    if made_for is None:
        origin = "the paper's preset names" if start is None else f"the preset {start} names"
        raise PresetError(f"{origin} no rig; add --rig with a rig.json, another preset or a source of frames")
    if not made_for.has_proximity and base.test.needs_proximity:
        base = base.with_values({"contact_test": "pressure"})
    preset = for_rig(base, made_for).model_copy(update={"created": now(), "modified": now()}).with_values(values)
    if start is not None and preset.untouched is not None:
        copy_untouched(preset.untouched, Path(start), out)
    save_preset(preset, out, exclusive=True)
    say(f"wrote {out}")
    if base.rig is not None and base.rig != made_for and made_for.has_proximity:
        warn(f"cameras and alignment are those of {start}, made for another rig; calibrate again")
    if left := measured_elsewhere(base, made_for):
        warn(f"{left}: measured on other cameras and left out; measure again")
    tell_notes(preset)


@preset_commands.command()
def show(preset: Annotated[str, typer.Argument(metavar="FILE|NAME", help="A file or a shipped preset.")]) -> None:
    """Print a preset as JSON in the current schema version."""
    from ...core.preset.file import preset_json
    from ...core.sources.presets import load_preset

    typer.echo(preset_json(load_preset(preset)), nl=False)


@preset_commands.command()
def validate(preset: Annotated[str, typer.Argument(metavar="FILE", help="A preset file or a recording.")]) -> None:
    """Check a preset file."""
    from ...core.rig.untouched import load_untouched
    from ...core.sources.presets import load_preset_and_note

    loaded, older = load_preset_and_note(preset)
    if loaded.untouched is not None:
        load_untouched(loaded.untouched, Path(preset))
    cameras = () if loaded.rig is None else loaded.rig.cameras
    made_for = " and ".join(f"{camera.model} {camera.serial}".strip() for camera in cameras) or "any rig"
    say(f"{preset}: good, preset {loaded.name!r} for {made_for}" + (f", {older}" if older else ""))
    tell_notes(loaded)


@preset_commands.command("capture-untouched")
def capture_untouched(
    *,
    source: UntouchedSource,
    preset: Annotated[Path, typer.Option("--preset", "-p", metavar="FILE", help="The preset file to change.")],
    force: Annotated[
        bool, typer.Option("--force", help="Keep the frame even if the preset finds contact in it.")
    ] = False,
) -> None:
    """Average frames of the untouched membrane.

    The mean is stored with a preset, in a file beside it; some methods and ``tactune check`` compare with it. Frames in
    which the preset finds contact are refused, which it can with a mask, or by the untouched frame that it had. The
    simulator removes its object for this.
    """
    from ...core.contact.checks import for_rig
    from ...core.contact.pipeline import ContactPipeline
    from ...core.preset import now
    from ...core.preset.file import save_preset
    from ...core.rig.untouched import kept_untouched, save_untouched
    from ...core.sources.presets import load_preset
    from ...core.sources.simulator.simulator_source import SimulatorSource
    from ...core.warmup import warm_up_if_needed

    check_target(preset, str(preset))
    chosen = load_preset(preset)
    with open_with_progress(source, chosen) as opened:
        captured = average_frames(opened)
        recorded = opened.length is not None and not isinstance(opened, SimulatorSource)
        # Without a mask prints would count as contact, and some tests compare with the frame before.
        compares, before = chosen.test.needs_untouched, kept_untouched(chosen, preset, opened).frame
        finds = before is not None if compares else chosen.mask.enabled and opened.rig.has_proximity
        if not force and finds:
            with CliProgress() as progress:
                warm_up_if_needed(progress.preparing)
            try:
                patch = ContactPipeline(chosen, opened.rig, before if compares else None).process(captured.frame)
            except RigMismatchError:
                if not compares:
                    raise
                patch = None  # the frame before is of no use, perhaps flat
            if patch is not None and len(patch.points):
                raise CalibrationError(
                    f"the preset finds contact of {patch.area_mm2:,.0f} mm2 on a membrane that should be untouched; "
                    "remove what touches the membrane or is close to it, and capture again, or keep it with --force"
                )
    record = save_untouched(captured.frame, captured.frames, preset)
    if not opened.rig.has_proximity:  # no alignment names the rig
        chosen = for_rig(chosen, opened.rig)
    save_preset(chosen.model_copy(update={"untouched": record, "modified": now()}), preset)
    where = f", from frame {captured.frame.sequence} on: make sure that nothing touches the membrane there"
    say(f"averaged {counted(captured.frames, 'frame')} of {opened.name}{where if recorded else ''}")
    say(f"wrote {preset.parent / record.file}, named in {preset}")


@preset_commands.command("measure-rig")
def measure_rig(
    *,
    source: Annotated[
        str, typer.Option("--source", "-s", metavar="SOURCE", help="Frames of a scene at rest, at least 10.")
    ],
    preset: PresetOption = None,
    out: _MeasuredOut = None,
) -> None:
    """Measure the cameras' noise and bias.

    Both are stored in a preset. The scene must be at rest. The bias between the cameras is measured on prints of the
    mask's colour, which both cameras see, and where an object is pressed firmly. Without --out and without a preset
    file nothing is written. The simulator removes its object for this.
    """
    from ...core.rig.noise import describe, measure_noise
    from ...core.rig.untouched import find_untouched, frames_to_average

    target = _target(out, preset)
    chosen, origin = chosen_preset(preset, source)
    with open_with_progress(source, chosen) as opened, CliProgress() as progress:
        found = find_untouched(chosen, origin, opened, progress.preparing)
        with frames_to_average(opened, _MEASURED, progress.preparing) as shown:
            frames = list(counted_out(shown, _MEASURED, progress))
        warn(*found.warnings)
        noise = measure_noise(frames, opened.rig, chosen, found.frame, progress.preparing)
    if noise.frames < _MEASURED:
        warn(f"the source has only {noise.frames} of the {_MEASURED} frames to measure at rest")
    say("\n".join(describe(noise)))
    _keep(chosen.with_value("noise", noise.model_dump()), origin, target)


@preset_commands.command("calibrate-force")
def calibrate_force(
    *,
    source: Annotated[str, typer.Option("--source", "-s", metavar="SOURCE", help="Frames in which an object presses.")],
    forces: Annotated[
        Path,
        typer.Option(
            metavar="FILE",
            help="A CSV file with the columns frame (as tactune run prints it) or time_s (since the first frame, or "
            "stamps as of --json), and force_n: what a scale or a force sensor read.",
        ),
    ],
    preset: PresetOption = None,
    out: _MeasuredOut = None,
) -> None:
    """Measure the inflation from presses on a scale.

    The pressure is stored in a preset, and the contact test pressure then gives newtons and pascals. One firm press
    suffices; more show how well they follow.
    """
    from ...core.rig.inflation import Press, fit_inflation, read_forces

    target = _target(out, preset)
    log = read_forces(forces)
    chosen, origin = chosen_preset(preset, source)
    presses: list[Press] = []
    unused: list[str] = []
    start_s: float | None = None
    measuring = chosen.with_value("contact_test", "pressure")
    with open_pipeline(source, measuring, origin) as (opened, pipeline), stop_on_signals() as stopped:
        total = number_of_frames(opened, None)
        if total is None:
            raise CalibrationError(f"{opened.name} is live, and a log belongs to a recording; record the presses first")
        with CliProgress() as progress:
            for done, frame in enumerate(live_frames(opened, total, stopped)):
                progress.frames(done + 1, total)
                start_s = frame.proximity_time_s if start_s is None else start_s
                force_n = log.of(frame, start_s)
                if force_n is None:
                    continue
                try:
                    presses.append(Press.of(pipeline.process(frame), frame.sequence, force_n))
                except CalibrationError as error:
                    unused.append(str(error))
    if stopped.is_set():
        raise KeyboardInterrupt
    if not presses:
        nowhere = f"no row of {forces} belongs to a frame of {source}; time_s counts from its first frame, or in stamps"
        raise CalibrationError(unused[0] if unused else nowhere)
    if unused:
        warn(f"{len(unused)} of {counted(len(unused) + len(presses), 'force')} not used: {unused[0]}")
    found = fit_inflation(presses)
    say(found.sentence)
    _keep(chosen.with_values(found.changes), origin, target)


@preset_commands.command()
def schema() -> None:
    """Print the JSON Schema of preset files."""
    from ...core.preset.preset import json_schema

    typer.echo(json.dumps(json_schema(), indent=2))


def _target(out: Path | None, preset: str | None) -> Path | None:
    """Return where a measurement is stored, which is checked before it is made; None if nowhere."""
    target = out or (None if preset is None else Path(preset))
    if target is not None:
        check_target(target, preset)
    return target


def _keep(measured: Preset, origin: str, target: Path | None) -> None:
    """Write a preset with what was measured, or say that it is not kept."""
    if target is None:
        warn("nothing was written; add --out FILE, or --preset with a preset file, to keep the measurement")
        return
    save_changed(measured, origin, target)
    say(f"wrote {target}")


def check_target(target: Path, preset: str | None) -> None:
    """Raise unless a changed preset can be written there: into a new file, or the preset's own."""
    own = preset is not None and target == Path(preset)
    if target.suffix == ".mcap" or (own and not target.is_file()):
        raise PresetError(
            f"{target} is no preset file, so nothing can be stored in it; make one with "
            f"tactune preset new --from default --rig SOURCE --out {target.with_suffix('.json')}"
        )
    if not own:
        refuse_existing(target)


def save_changed(preset: Preset, origin: str, target: Path) -> None:
    """Write a preset that was made from another one, ``origin``, and its untouched frame beside it."""
    from ...core.preset import now
    from ...core.preset.file import save_preset, shipped_presets
    from ...core.rig.untouched import copy_untouched

    if preset.untouched is not None:
        copy_untouched(preset.untouched, Path(origin), target)
    name = target.stem if origin in shipped_presets() else preset.name
    own = Path(origin).exists() and target.exists() and target.samefile(origin)
    save_preset(preset.model_copy(update={"name": name, "modified": now()}), target, exclusive=not own)
