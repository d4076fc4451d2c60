"""The command ``tactune strain``: membrane strain from a printed dot grid."""

from __future__ import annotations

import itertools
import json
import sys
from collections import deque
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...core.errors import SourceError, counted
from ...core.model.files import check_writable, write_csv
from .common import (
    CliProgress,
    FrameCount,
    default_preset,
    number_of_frames,
    open_with_progress,
    warn,
)

if TYPE_CHECKING:
    from ...core.evaluation.strain.strain import StrainMeasurement
    from ...core.model.frames import SensorFrame


@dataclass(frozen=True)
class StrainRecord:
    """The result of one frame; strain fields are None if ``problem`` gives the cause.

    True strains are the simulator's: over all pairs of neighbouring dots, and over pairs that the tactile camera sees.
    """

    sequence: int
    displacement_mm: float | None
    strain_length_percent: float | None
    strain_width_percent: float | None
    strain_length_sigma_percent: float | None
    strain_width_sigma_percent: float | None
    dots: int
    problem: str
    averaged_frames: int = 1
    true_strain_length_percent: float | None = None
    true_strain_width_percent: float | None = None
    true_strain_length_seen_percent: float | None = None
    true_strain_width_seen_percent: float | None = None


def strain(
    *,
    source: Annotated[
        str, typer.Option("--source", "-s", metavar="SOURCE", help="As for tactune run, such as 'sim:cup?grid=dots'.")
    ] = "sim:cup?grid=dots",
    preset: Annotated[
        str | None,
        typer.Option(
            "--preset", "-p", metavar="FILE|NAME", help="Gives the untouched frame and, for live sources, the cameras."
        ),
    ] = None,
    spacing_mm: Annotated[
        float, typer.Option("--spacing-mm", metavar="MM", help="Distance between neighbouring dots on the flat sheet.")
    ] = 10.0,
    frames: FrameCount = None,
    average: Annotated[
        int,
        typer.Option(
            "--average",
            "-a",
            min=1,
            max=30,
            metavar="N",
            help="Average up to N of the last frames while the membrane does not move.",
        ),
    ] = 1,
    json_lines: Annotated[bool, typer.Option("--json", help="Print one JSON line per frame and no table.")] = False,
    csv_file: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the table to a file.")] = None,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE.png", help="Draw strain against displacement (extra bench)."),
    ] = None,
) -> None:
    """Measure membrane strain from a printed grid of dots.

    The displacement is relative to the untouched frame of the preset or the source, else to the first frame. On the
    simulator the solver's strain is shown beside: between dots that the camera sees, in brackets between all dots.
    """
    from ...core.evaluation.strain.average import average_still
    from ...core.evaluation.strain.strain import StrainError, check_spacing, indentation_m, measure_strain
    from ...core.rig.untouched import kept_untouched
    from ...core.sources.presets import load_preset

    if plot is not None and plot.suffix.lower() != ".png":
        raise typer.BadParameter(f"--plot is {plot}; give a file that ends in .png")
    for target in filter(None, (csv_file, plot)):
        check_writable(target)
    check_spacing(spacing_mm / 1e3)
    origin = preset or default_preset(source)
    chosen = load_preset(origin)
    records: list[StrainRecord] = []
    measured: StrainMeasurement | None = None
    latest: deque[SensorFrame] = deque(maxlen=average)
    with (
        open_with_progress(source, chosen.cameras) as opened,
        CliProgress(quiet=json_lines and sys.stdout.isatty()) as bar,
    ):
        total, kept = number_of_frames(opened, frames), kept_untouched(chosen, origin, opened)
        untouched = kept.frame
        warn(*kept.warnings)
        bar.preparing(0.01, f"measuring strain in {counted(total, 'frame') if total else 'every frame'}")
        bar.frames(0, total)
        for frame in itertools.islice(opened, total):
            untouched = untouched or frame
            latest.append(frame)
            quiet, averaged = average_still(list(latest), opened.rig)
            try:
                displacement = 1e3 * indentation_m(quiet, untouched, opened.rig)
                measured = measure_strain(quiet, opened.rig, spacing_mm / 1e3)
                record = _record(quiet, displacement, measured, averaged)
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
        write_csv(csv_file, [asdict(record) for record in records])
    if plot is not None:
        _draw(records, measured, plot)
    if not json_lines:
        typer.echo(_table(records))
        for written in filter(None, (csv_file, plot)):
            typer.echo(f"wrote {written}")


def _record(frame: SensorFrame, displacement_mm: float, measured: StrainMeasurement, averaged: int) -> StrainRecord:
    length, width = measured.length, measured.width
    known = frame.truth.strain if frame.truth is not None else None
    strains = (known.length, known.width, known.length_seen, known.width_seen) if known is not None else ()
    return StrainRecord(
        frame.sequence,
        round(displacement_mm, 3),
        round(100 * length.largest, 2),
        round(100 * width.largest, 2),
        round(100 * length.largest_sigma, 2),
        round(100 * width.largest_sigma, 2),
        measured.dots,
        "",
        averaged,
        *(round(100 * strain, 2) for strain in strains),
    )


def _table(records: list[StrainRecord]) -> str:
    """Return a table with one line per frame."""
    known = any(record.true_strain_length_percent is not None for record in records)
    solver = "  solver: seen (all) along length %     along width %"
    lines = ["frame  displacement mm  strain along length %  along width %  dots" + solver * known]
    for record in records:
        if record.problem:
            lines.append(f"{record.sequence:5d}  {record.problem}")
        else:
            length = f"{record.strain_length_percent:.1f} ± {record.strain_length_sigma_percent:.1f}"
            width = f"{record.strain_width_percent:.1f} ± {record.strain_width_sigma_percent:.1f}"
            lines.append(
                f"{record.sequence:5d}  {record.displacement_mm:15.1f}  {length:>21}  {width:>13}  {record.dots:4d}"
                + _solver(record)
            )
    return "\n".join(lines)


def _solver(record: StrainRecord) -> str:
    if record.true_strain_length_percent is None:
        return ""
    length = f"{record.true_strain_length_seen_percent:.1f} ({record.true_strain_length_percent:.1f})"
    return f"{length:>35}{f'{record.true_strain_width_seen_percent:.1f} ({record.true_strain_width_percent:.1f})':>18}"


def _draw(records: list[StrainRecord], last: StrainMeasurement, path: Path) -> None:
    from ...core.evaluation.strain.plot import draw_strain

    shown = [record for record in records if not record.problem]
    displacement, length, width, *solver = (
        [getattr(record, name) for record in shown]
        for name in (
            "displacement_mm",
            "strain_length_percent",
            "strain_width_percent",
            "true_strain_length_seen_percent",
            "true_strain_width_seen_percent",
        )
    )
    known = list(zip(*solver, strict=True))
    draw_strain(displacement, length, width, last, path, [] if (None, None) in known else known)
