"""The commands ``tactune lab``: what a paper needs. Everything of the lab is imported inside the commands."""

from __future__ import annotations

import itertools
import json
from collections import deque
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import urlencode

import typer

from ...core.errors import SourceError, TactuneError, counted
from ...core.model.files import UNITS_M, MeshUnit, check_writable, finite_or_none, write_csv
from .common import (
    SOURCE,
    CliProgress,
    FrameCount,
    PresetOption,
    SetOption,
    SourceOption,
    chosen_preset,
    number_of_frames,
    open_with_progress,
    parse_settings,
    say,
    table_text,
    usable,
    warn,
)

if TYPE_CHECKING:
    from ...core.lab.faults import Outcome
    from ...core.lab.scan import PaintSettings
    from ...core.lab.single_camera import Find
    from ...core.lab.strain import StrainMeasurement
    from ...core.lab.table import Cell
    from ...core.model.frames import SensorFrame
    from ...core.preset import Preset
    from ...core.sources import FrameSource

Record = dict[str, Any]
#: Rounds of each engine of the benchmark.
_ROUNDS = 15

NamesOption = Annotated[
    str,
    typer.Option(metavar="A,B", help="Names with commas between, or 'all'; a wrong one lists those that there are."),
]
CsvOption = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Also write the lines to a CSV file.")]

lab_commands = typer.Typer(help="For papers (extra lab): tables, strain, scans, run times.", no_args_is_help=True)


@lab_commands.command()
def table(
    *,
    methods: NamesOption = "all",
    objects: NamesOption = "all",
    presses: NamesOption = "low,medium,high",
    sensors: NamesOption = "l515-d405",
    membranes: NamesOption = "all",
    seeds: Annotated[int, typer.Option(min=1, max=1000, metavar="N", help="Noise seeds per press.")] = 2,
    held_out: Annotated[
        bool,
        typer.Option("--held-out", help="Use sensors, a membrane, objects and seeds that no method was developed on."),
    ] = False,
    csv_file: CsvOption = None,
) -> None:
    """Compare methods on simulated presses with known truth. They run on one or more sensors."""
    from platformdirs import user_cache_dir

    from ...core.lab.table import cell_line, measure_table, plan_table, table_text, time_table
    from ...core.sources.presets import load_preset

    check_writable(csv_file)
    plan = plan_table(
        load_preset("simulator"),
        Path(user_cache_dir("tactune")) / "table",
        methods=_names(methods),
        objects=_names(objects),
        presses=_names(presses),
        sensors=_names(sensors),
        membranes=_names(membranes),
        seeds=seeds,
        held_out=held_out,
    )
    cells: list[Cell] = []
    done = 0
    try:
        for press in measure_table(plan):
            done += 1
            cells += press
            say(f"{done}/{plan.presses} {cell_line(press)}", err=True)
        times = time_table(plan)
    except KeyboardInterrupt:
        warn(f"{done} of {counted(plan.presses, 'press')} are kept in {plan.work}; the same command goes on from there")
        raise
    if csv_file is not None:
        write_csv(csv_file, [asdict(cell) for cell in cells])
    order = {name: place for place, name in enumerate(plan.methods)}
    cells.sort(key=lambda cell: order[cell.method])
    say(table_text(cells, times))


@lab_commands.command()
def faults(
    *,
    sensor: Annotated[str, typer.Option(metavar="NAME", help="Sensor of the simulator.")] = "l515-d405",
    held_out: Annotated[
        bool, typer.Option("--held-out", help="Use objects and a membrane that nothing was developed on.")
    ] = False,
    settings: SetOption = None,
) -> None:
    """Show what breaks in a measured rig, and whether patches say so.

    Lays twelve faults over simulated touches and hovers, and counts wrong patches that carry no doubt.
    """
    from ...core.lab.faults import faults_text, try_faults
    from ...core.sources.presets import load_preset
    from ...core.sources.simulator.scenes import read_name

    read_name("?" + urlencode({"sensor": sensor}))  # refuses an unknown sensor
    preset = load_preset("simulator").with_values(parse_settings(settings))
    outcomes: list[Outcome] = []
    for fault in try_faults(preset, sensor, held_out=held_out):
        outcomes += fault
        typer.echo(fault[0].fault, err=True)
    typer.echo(faults_text(outcomes))


def _names(text: str) -> tuple[str, ...]:
    """Return the names of an option, separated by commas; none for ``all``."""
    return () if text == "all" else tuple(dict.fromkeys(name.strip() for name in text.split(",")))


# Strain


@lab_commands.command()
def strain(
    *,
    source: SourceOption = "sim:cup?grid=dots",
    preset: PresetOption = None,
    spacing_mm: Annotated[
        float,
        typer.Option(min=1, max=100, metavar="MM", help="Distance between dots on the flat sheet."),
    ] = 10.0,
    frames: FrameCount = None,
    average: Annotated[
        int, typer.Option(min=1, max=30, metavar="N", help="Average up to N frames while the membrane is at rest.")
    ] = 1,
    csv_file: CsvOption = None,
) -> None:
    """Measure membrane strain from a printed grid of dots.

    On the simulator the solver's strain is shown beside: between dots that the camera sees, and between all.
    """
    from ...core.lab.strain import StrainError, average_still, measure_strain

    check_writable(csv_file)
    chosen, _ = chosen_preset(preset, source)
    records: list[Record] = []
    latest: deque[SensorFrame] = deque(maxlen=average)
    with open_with_progress(source, chosen) as opened, CliProgress() as progress:
        total = number_of_frames(opened, frames)
        for frame in itertools.islice(opened, total):
            latest.append(frame)
            still, averaged = average_still(list(latest))
            try:
                measured = measure_strain(still, opened.rig, spacing_mm / 1e3)
                record = _strain_record(still, measured) | {"averaged_frames": averaged, "problem": ""}
            except StrainError as error:
                record = {"sequence": frame.sequence, "problem": str(error)}
            records.append(record)
            progress.frames(len(records), total)
    if not records:
        raise SourceError(f"{source} gave no frames; check the source")
    if all(record["problem"] for record in records):
        raise StrainError(records[0]["problem"])
    if csv_file is not None:
        names = dict.fromkeys(name for record in records for name in record)
        write_csv(csv_file, [names | record for record in records])
    say(table_text(records))


def _strain_record(frame: SensorFrame, measured: StrainMeasurement) -> Record:
    """Return the largest strains; on the simulator those of its solver too, once for the dots in view."""
    record: Record = {
        "sequence": frame.sequence,
        "length_percent": round(100 * measured.length.largest, 2),
        "width_percent": round(100 * measured.width.largest, 2),
        "dots": len(measured.pixels),
    }
    known = frame.truth.strain if frame.truth is not None else None
    if known is not None:
        names = ("length", "width", "length_all", "width_all")
        strains = (known.length_seen, known.width_seen, known.length, known.width)
        record |= {f"solver_{name}_percent": round(100 * value, 2) for name, value in zip(names, strains, strict=True)}
    return record


# Truth from a painted scan


@lab_commands.command()
def scan(
    *,
    source: SourceOption = SOURCE,
    scan: Annotated[
        Path, typer.Option(metavar="FILE", help="The object's painted scan: .ply or .obj, coloured or textured.")
    ],
    transform: Annotated[
        Path,
        typer.Option(metavar="FILE", help="Pose of the scan in the proximity camera: four lines of four numbers."),
    ],
    methods: NamesOption = "",
    frame: Annotated[int, typer.Option(min=0, metavar="N", help="The first frame, from 0.")] = 0,
    frames: FrameCount = None,
    preset: PresetOption = None,
    unit: Annotated[MeshUnit, typer.Option(help="Unit of the scan's numbers.")] = "m",
    paint: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="Touched paint: hue=[150,179] (0-179; may wrap), saturation=[40,255], value=[60,255], "
            "least_area_mm2=20. May be repeated.",
        ),
    ] = None,
    csv_file: CsvOption = None,
) -> None:
    """Compare methods with the contact on a painted 3D scan.

    Thermochromic paint on the object shows where it was touched. Without --methods the preset's own test is compared.
    """
    from ...core.lab import scan as lab_scan
    from ...core.lab.methods import check_methods, method_names, patch_area_mm2

    check_writable(csv_file)
    settings, unit_m = _paint(paint or []), UNITS_M[unit]
    names = () if not methods else _names(methods) or method_names()
    check_methods(names)
    pose = lab_scan.load_transform(transform)
    chosen, origin = chosen_preset(preset, source)
    loaded = lab_scan.load_scan(scan, unit_m)
    contact = lab_scan.painted_contact(loaded, settings)
    if not contact.any():
        raise TactuneError(f"{scan} has no spot of the touched paint's colour ({settings}); change it with --paint")
    truth = lab_scan.scan_truth(loaded, contact, pose)
    records: list[Record] = []
    empty = {"rmse_mm": None, "area_error_mm2": None, "failure": ""}
    with open_with_progress(source, chosen) as opened:
        if opened.length is None and frames is None:
            raise TactuneError(f"{source} is endless; say how many frames to compare, such as --frames 30")
        finds = _finds(names, chosen, origin, opened)
        for each in itertools.islice(opened, frame, None if frames is None else frame + frames):
            for name, find in finds.items():
                record: Record = {"sequence": each.sequence, "method": name, "points": 0, **empty}
                try:
                    patch = find(each)
                    scores = lab_scan.score_against_scan(patch.points, patch_area_mm2(patch), truth)
                    record |= {key: finite_or_none(value) for key, value in scores.items()}
                    record["points"] = len(patch.points)
                except TactuneError as error:
                    record["failure"] = str(error)
                records.append(record)
    if not records:
        raise SourceError(f"{source} has no frame {frame}; check --frame and the source")
    if csv_file is not None:
        write_csv(csv_file, records)
    say(f"painted contact: {truth.area_mm2:.0f} mm2")
    say(table_text(records))


def _finds(names: tuple[str, ...], preset: Preset, origin: str, source: FrameSource) -> dict[str, Find]:
    """Return the methods by name, without those that cannot work here; without a name, the preset's own pipeline."""
    from ...core.contact.pipeline import ContactPipeline
    from ...core.lab.methods import make_method
    from ...core.rig.untouched import find_untouched

    if not names:
        return {"preset": ContactPipeline(preset, source.rig).process}
    untouched, finds = usable(find_untouched(preset, origin, source)), {}
    for name in names:
        try:
            finds[name] = make_method(name, preset, source.rig, untouched)
        except TactuneError as error:
            warn(f"skipped: {error}")
    return finds


def _paint(words: list[str]) -> PaintSettings:
    """Turn ``NAME=VALUE`` texts such as ``hue=[150,179]`` into settings; the others keep their defaults."""
    from ...core.lab.scan import PAINT, PaintSettings
    from ...core.model.rig_file import validating
    from ...core.preset.preset import json_or_word

    values = PAINT.model_dump()
    for word in words:
        name, _, text = word.partition("=")
        values[name] = json_or_word(text)
    with validating("--paint", "paint", TactuneError):
        return PaintSettings.model_validate_json(json.dumps(values))


# Speed


@lab_commands.command()
def bench(
    *,
    gate: Annotated[
        bool, typer.Option("--gate", help="Check only the promised speed; exit status 1 if a check fails.")
    ] = False,
) -> None:
    """Measure the pipeline's run time and error.

    NumPy, OpenCV and Open3D stand beside it; --gate checks the promised speed.
    """
    from ...core.lab import bench as lab_bench

    head = lab_bench.machine_words()
    with CliProgress() as progress:
        if gate:
            checks = lab_bench.run_gate(_ROUNDS, progress.preparing)
        else:
            scenes, engines = list(lab_bench.SCENES), list(lab_bench.ENGINES)
            rows = lab_bench.compare_engines(scenes, engines, _ROUNDS, progress.preparing)
    say("\n".join([head, *map(str, checks)]) if gate else f"{head}\n\n{lab_bench.rows_text(rows)}")
    if gate and not all(check.holds for check in checks):
        raise typer.Exit(1)
