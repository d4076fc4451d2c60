"""The commands ``tactune evaluate``: methods and patches against the truth."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import typer

from ...core.errors import TactuneError, counted
from ...core.model.files import finite_or_none, write_csv
from .common import CliProgress, tell_notes, warn
from .scan import evaluate_recording

if TYPE_CHECKING:
    from ...core.evaluation.sensor_cases import SensorTable
    from ...core.evaluation.sensor_table import RigKnowledge, SensorPlan
    from ...core.evaluation.table import TablePlan

Result = TypeVar("Result")

evaluate_commands = typer.Typer(
    help="Compare with ground truth: all methods on simulated scenes, a patch with another cloud, or "
    "recordings with a painted scan of the object.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
)

evaluate_commands.command("recording")(evaluate_recording)

_PAPER = "the paper's"
#: Default number of seeds, and that with --sensors.
_SEEDS, _SENSOR_SEEDS = 5, 2


@evaluate_commands.command()
def table(
    *,
    methods: Annotated[
        str, typer.Option(metavar="A,B", help="Methods, separated by commas, or 'all'; a wrong name lists all methods.")
    ] = "all",
    objects: Annotated[
        str, typer.Option(metavar="A,B", help="Objects: octopus, cup, cube, two; with --held-out mug, hand.")
    ] = _PAPER,
    presses: Annotated[str, typer.Option(metavar="A,B", help="Presses: low, medium, high.")] = "low,medium,high",
    seeds: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1000,
            metavar="N",
            help=f"Noise seeds per scene; default: {_SEEDS}, with --sensors {_SENSOR_SEEDS}.",
        ),
    ] = None,
    extra: Annotated[
        bool,
        typer.Option(help="Also stiff and wrinkled membranes, two objects, and hovering objects without contact."),
    ] = True,
    held_out: Annotated[
        bool,
        typer.Option(
            "--held-out",
            help="Use objects and seeds (with --sensors also sensors and membranes) that no method was developed on.",
        ),
    ] = False,
    sensors: Annotated[
        str | None,
        typer.Option(
            metavar="A,B",
            help="Compare the membrane test with the tolerance test, also with the best tolerance of each frame, on "
            "these sensors of the simulator, or 'all'; a wrong name lists all sensors.",
        ),
    ] = None,
    membranes: Annotated[
        str, typer.Option(metavar="A,B", help="With --sensors: membranes of the simulator, or 'all'.")
    ] = "all",
    rig: Annotated[
        Literal["measured", "unmeasured"],
        typer.Option(
            help="With --sensors: measure the noise and bias of each rig for the membrane test first, or not."
        ),
    ] = "measured",
    check: Annotated[
        bool,
        typer.Option("--check", help="With --sensors: exit status 1 if a case does not hold."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="With --sensors: also write sensors.md, sensors.csv and cells.csv."),
    ] = None,
    preset: Annotated[
        str, typer.Option("--preset", "-p", metavar="FILE|NAME", help="The preset of all methods but straight.")
    ] = "simulator",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    csv_file: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Also write one line per table cell.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Also draw the patches of the first seed (extra bench).")
    ] = None,
    work: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for finished table cells, so that an interrupted run can continue; default: the cache.",
        ),
    ] = None,
) -> None:
    """Compare methods on simulated scenes (sensor datasheet) beside the paper's figures; with --sensors, on others."""
    if sensors is not None:
        if methods != "all" or plot is not None or csv_file is not None:
            raise TactuneError(
                "--sensors has its own methods and files; use --out in place of --methods, --csv, --plot"
            )
        plan_of_sensors = plan_sensor_table(
            sensors, membranes, "all" if objects == _PAPER else objects, presses, seeds or _SENSOR_SEEDS,
            held_out=held_out, preset=preset, rig=rig, work=work,
        )  # fmt: skip
        raise typer.Exit(print_sensor_table(plan_of_sensors, as_json=as_json, out=out, check=check))
    if membranes != "all" or rig != "measured" or check or out is not None:
        raise TactuneError("--membranes, --rig, --check and --out belong to --sensors; add --sensors all")
    from ...core.evaluation.table import Table, measure_table
    from ...core.evaluation.table_report import check_plot, draw_patches, table_as_json, table_as_text

    plan = _plan(methods, objects, presses, seeds or _SEEDS, extra=extra, held_out=held_out, preset=preset, work=work)
    tell_notes(plan.preset)
    if plot is not None:
        check_plot(plot)
    words = "{0.row} {0.press}, {0.method}"
    finished = Table(measured(measure_table(plan), plan, "cell", words))
    if csv_file is not None:
        write_csv(csv_file, [asdict(cell) for cell in finished.cells])
        typer.echo(f"wrote {csv_file}", err=True)
    typer.echo(json.dumps(table_as_json(finished), indent=2, allow_nan=False) if as_json else table_as_text(finished))
    if plot is not None:
        draw_patches(plot, plan.methods, plan.scenes, plan.preset, plan.seeds[0])
        typer.echo(f"wrote {plot}", err=True)


@evaluate_commands.command("patch")
def evaluate_patch(
    *,
    patch: Annotated[Path, typer.Option(metavar="FILE", help="A cloud: .ply, .npz or .csv, metres.")],
    truth: Annotated[Path, typer.Option(metavar="FILE", help="The true cloud, in the same frame.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Compare the clouds of two files: RMSE, Hausdorff, 95th percentile and Chamfer distance."""
    from ...core.evaluation.metrics import cloud_distances
    from ...core.output.cloud_files import read_points, unit_doubt

    clouds = {}
    for path in (patch, truth):
        clouds[path], dropped = read_points(path)
        if dropped:
            warn(f"{path}: {counted(dropped, 'point')} of {dropped + len(clouds[path])} ignored because of nan values")
        if len(clouds[path]) == 0:
            raise TactuneError(f"{path} holds no points, so there is no distance to it; choose a frame with contact")
        if doubt := unit_doubt(clouds[path], path):
            warn(doubt)
    apart = asdict(cloud_distances(clouds[patch], clouds[truth]))
    numbers = {f"{name.removesuffix('_m')}_mm": finite_or_none(1e3 * value) for name, value in apart.items()}
    counts = {"patch_points": len(clouds[patch]), "truth_points": len(clouds[truth])}
    if as_json:
        typer.echo(json.dumps(counts | numbers, allow_nan=False))
        return
    typer.echo(f"{counted(counts['patch_points'], 'point')} against {counted(counts['truth_points'], 'point')}")
    for name, number in numbers.items():
        words = name.removesuffix("_mm").replace("_", " ")
        typer.echo(f"{words:24s}" + ("-" if number is None else f"{number:10.3f} mm"))


def _plan(
    methods: str,
    objects: str,
    presses: str,
    seeds: int,
    *,
    extra: bool,
    held_out: bool,
    preset: str,
    work: Path | None,
) -> TablePlan:
    """Turn the options into a plan; wrong options are refused before anything is measured."""
    from ...core.evaluation.table import TablePlan, seeds_from
    from ...core.evaluation.table_cell import FIRST_HELD_OUT_SEED, OBJECTS, plan_scenes, table_methods
    from ...core.methods.registry import check_known
    from ...core.sources.presets import load_preset
    from ...core.sources.simulator.scenes import HELD_OUT

    names = table_methods() if methods == "all" else listed("--methods", methods)
    check_known(names, table_methods())
    usual = HELD_OUT if held_out else OBJECTS
    return TablePlan(
        names,
        tuple(
            plan_scenes(
                usual if objects == _PAPER else listed("--objects", objects), listed("--presses", presses),
                extra=extra, held_out=held_out,
            )
        ),
        seeds_from(FIRST_HELD_OUT_SEED if held_out else 0, seeds),
        load_preset(preset),
        work or default_work(),
    )  # fmt: skip


def plan_sensor_table(
    sensors: str,
    membranes: str,
    objects: str,
    presses: str,
    seeds: int,
    *,
    held_out: bool,
    preset: str,
    rig: RigKnowledge,
    work: Path | None,
) -> SensorPlan:
    """Turn the options into a plan. Names are separated by commas, or are ``all``.

    Raises
    ------
    TactuneError
        A name is unknown, or held out without ``held_out``.
    """
    from ...core.evaluation.sensor_table import SensorPlan, plan_sensors
    from ...core.evaluation.table import seeds_from
    from ...core.evaluation.table_cell import FIRST_HELD_OUT_SEED
    from ...core.sources.presets import load_preset

    def chosen(option: str, text: str) -> tuple[str, ...]:
        return () if text == "all" else listed(option, text)

    return SensorPlan(
        plan_sensors(
            chosen("--sensors", sensors), chosen("--membranes", membranes), chosen("--objects", objects),
            listed("--presses", presses), held_out=held_out,
        ),
        seeds_from(FIRST_HELD_OUT_SEED if held_out else 0, seeds),
        load_preset(preset),
        work or default_work(),
        rig,
    )  # fmt: skip


def print_sensor_table(plan: SensorPlan, *, as_json: bool, out: Path | None, check: bool) -> int:
    """Measure and print the table; return the exit status."""
    from ...core.evaluation.sensor_report import sensors_as_json, sensors_as_text, write_report

    tell_notes(plan.preset)
    table = measure_sensor_table(plan)
    if out is not None:
        for path in write_report(table, out):
            typer.echo(f"wrote {path}", err=True)
    typer.echo(json.dumps(sensors_as_json(table), indent=2, allow_nan=False) if as_json else sensors_as_text(table))
    return 1 if check and table.failing else 0


def measure_sensor_table(plan: SensorPlan) -> SensorTable:
    """Measure one frame after another."""
    from ...core.evaluation.sensor_cases import sensor_table
    from ...core.evaluation.sensor_table import measure_sensors

    words = "{0[0].sensor}, {0[0].membrane}, {0[0].press}"
    frames = measured(measure_sensors(plan), plan, "frame", words)
    return sensor_table([cell for frame in frames for cell in frame])


def measured(results: Iterator[Result], plan: TablePlan | SensorPlan, unit: str, words: str) -> list[Result]:
    """Return all results of a plan with progress; after Ctrl+C, say how to continue.

    Parameters
    ----------
    results : iterator
        Measures one after the other, and keeps them in ``plan.work``.
    plan : TablePlan or SensorPlan
    unit : str
        What a result is called.
    words : str
        Format of the progress line, with the result as its argument.
    """
    done: list[Result] = []
    with CliProgress() as progress:
        progress.frames(0, plan.count, f"{unit}s")
        try:
            for result in results:
                done.append(result)
                progress.frames(len(done), plan.count, words.format(result))
        except KeyboardInterrupt:
            kept = f"{len(done)} of {counted(plan.count, unit)} are kept in {plan.work}"
            warn(f"{kept}; the same command continues from there")
            raise
    return done


def default_work() -> Path:
    """Return the folder of finished table cells in the cache."""
    from platformdirs import user_cache_dir

    return Path(user_cache_dir("tactune")) / "evaluation"


def listed(option: str, text: str) -> tuple[str, ...]:
    """Return the names of an option, separated by commas.

    Raises
    ------
    TactuneError
        There is none.
    """
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not names:
        raise TactuneError(f"{option} is {text!r}; give names, separated by commas")
    return names
