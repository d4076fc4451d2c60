"""``tactune evaluate table --sensors``: the shipped contact test on many simulated sensors and membranes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import typer

from ...core.errors import TactuneError, counted
from .common import CliProgress, tell_notes, warn

if TYPE_CHECKING:
    from ...core.evaluation.sensor_cases import SensorTable
    from ...core.evaluation.sensor_table import RigKnowledge, SensorPlan
    from ...core.evaluation.table import TablePlan

Result = TypeVar("Result")


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
