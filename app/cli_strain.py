"""The command ``tactune strain``: how far the membrane is stretched, from the dots printed on it."""

from __future__ import annotations

import csv
import io
import itertools
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..core.atomic import atomic_path
from ..core.errors import SourceError
from . import defaults

if TYPE_CHECKING:
    from ..core.evaluation.strain import StrainMeasurement


@dataclass(frozen=True)
class StrainRecord:
    """What is said of one frame; strain fields are None where ``problem`` says why."""

    sequence: int
    displacement_mm: float | None
    strain_length_percent: float | None
    strain_width_percent: float | None
    strain_length_sigma_percent: float | None
    strain_width_sigma_percent: float | None
    dots: int
    problem: str


def strain(
    *,
    source: Annotated[
        str, typer.Option("--source", "-s", metavar="SOURCE", help="As for tactune run, such as 'sim:cup?grid=dots'.")
    ] = "sim:cup?grid=dots",
    preset: Annotated[
        str | None,
        typer.Option("--preset", "-p", metavar="FILE|NAME", help="Its camera settings are used for live sources."),
    ] = None,
    spacing_mm: Annotated[
        float, typer.Option("--spacing-mm", metavar="MM", help="Distance of neighbouring dots on the flat sheet.")
    ] = 10.0,
    frames: Annotated[
        int | None, typer.Option("--frames", "-n", min=1, metavar="N", help="Stop after so many; default: all.")
    ] = None,
    json_lines: Annotated[bool, typer.Option("--json", help="Print a JSON line a frame, no table.")] = False,
    csv_file: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the table to a file.")] = None,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE.png", help="Draw strain against displacement (extra bench)."),
    ] = None,
) -> None:
    """Measure membrane strain from a printed grid of dots.

    The displacement is against the first frame, or the source's reference frame where it has one.
    """
    from ..core.evaluation.strain import StrainError, check_spacing, indentation_m, measure_strain
    from ..core.preset_file import load_preset
    from .cli_progress import CliProgress
    from .cli_run import number_of_frames, open_with_progress

    if plot is not None and plot.suffix.lower() != ".png":
        raise typer.BadParameter(f"--plot is {plot}; give a file that ends in .png")
    check_spacing(spacing_mm / 1e3)
    cameras = load_preset(preset or defaults.default_preset(source)).cameras
    records: list[StrainRecord] = []
    measured: StrainMeasurement | None = None
    with open_with_progress(source, cameras) as opened, CliProgress(quiet=json_lines and sys.stdout.isatty()) as bar:
        total, reference = number_of_frames(opened, frames), opened.reference()
        for frame in itertools.islice(opened, total):
            reference = reference or frame
            try:
                displacement = 1e3 * indentation_m(frame, reference, opened.rig)
                measured = measure_strain(frame, opened.rig, spacing_mm / 1e3)
                record = _record(frame.sequence, displacement, measured)
            except StrainError as error:
                record = StrainRecord(frame.sequence, None, None, None, None, None, 0, str(error))
            records.append(record)
            if json_lines:
                typer.echo(json.dumps(asdict(record), allow_nan=False))
            bar.frames(len(records), total)
    if not records:
        raise SourceError(f"{source} gave no frames; check the source")
    if measured is None:
        raise StrainError(records[0].problem)
    if csv_file is not None:
        _write_csv(records, csv_file)
    if plot is not None:
        _draw(records, measured, plot)
    if not json_lines:
        typer.echo(_table(records))
        for written in filter(None, (csv_file, plot)):
            typer.echo(f"wrote {written}")


def _record(sequence: int, displacement_mm: float, measured: StrainMeasurement) -> StrainRecord:
    length, width = measured.length, measured.width
    return StrainRecord(
        sequence,
        round(displacement_mm, 3),
        round(100 * length.largest, 2),
        round(100 * width.largest, 2),
        round(100 * length.largest_sigma, 2),
        round(100 * width.largest_sigma, 2),
        measured.dots,
        "",
    )


def _table(records: list[StrainRecord]) -> str:
    """Return a line a frame for a person."""
    lines = ["frame  displacement mm  strain along length %  along width %  dots"]
    for record in records:
        if record.problem:
            lines.append(f"{record.sequence:5d}  {record.problem}")
        else:
            length = f"{record.strain_length_percent:.1f} +- {record.strain_length_sigma_percent:.1f}"
            width = f"{record.strain_width_percent:.1f} +- {record.strain_width_sigma_percent:.1f}"
            lines.append(
                f"{record.sequence:5d}  {record.displacement_mm:15.1f}  {length:>21}  {width:>13}  {record.dots:4d}"
            )
    return "\n".join(lines)


def _write_csv(records: list[StrainRecord], path: Path) -> None:
    text = io.StringIO(newline="")
    rows = [asdict(record) for record in records]
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with atomic_path(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def _draw(records: list[StrainRecord], last: StrainMeasurement, path: Path) -> None:
    from ..core.evaluation.strain_plot import draw_strain

    columns = [
        (record.displacement_mm, record.strain_length_percent, record.strain_width_percent)
        for record in records
        if record.displacement_mm is not None
        and record.strain_length_percent is not None
        and record.strain_width_percent is not None
    ]
    displacement, length, width = zip(*columns, strict=True)
    draw_strain(displacement, length, width, last, path)
