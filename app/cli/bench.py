"""The commands ``tactune bench``, ``tactune bench stability`` and ``tactune bench memory``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from ...core.errors import TactuneError, counted
from .common import SOURCE, CliProgress, PresetOption, SourceOption, default_preset, open_with_progress
from .evaluate import measure_sensor_table, plan_sensor_table

#: Frames over which ``tactune bench memory`` measures.
MEASURED_FRAMES = 50

bench_commands = typer.Typer(
    help="Measure run time and error of the pipeline beside other implementations.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@bench_commands.callback(invoke_without_command=True)
def bench(
    context: typer.Context,
    *,
    scenes: Annotated[
        str, typer.Option("--scenes", metavar="A,B", help="Scenes, separated by commas; 'all' for every one.")
    ] = "all",
    engines: Annotated[
        str, typer.Option("--engines", metavar="A,B", help="Engines besides the baseline; 'all' for every one.")
    ] = "all",
    rounds: Annotated[int, typer.Option("--rounds", min=3, metavar="N", help="Rounds per engine.")] = 15,
    gate: Annotated[
        bool, typer.Option("--gate", help="Check only the promised speed; exit status 1 if a check fails.")
    ] = False,
    sensors: Annotated[
        str | None,
        typer.Option(
            "--sensors",
            metavar="A,B",
            help="Compare run time and error of the contact tests on these simulated sensors, or 'all', instead.",
        ),
    ] = None,
    plots: Annotated[
        Path | None, typer.Option("--plots", metavar="DIR", help="Draw the figures into this folder (extra bench).")
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option("--report", metavar="FILE.md", help="Measure everything and write a Markdown page with figures."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Compare all engines on all scenes; with --gate, check the promised speed; with --sensors, the contact tests."""
    if context.invoked_subcommand is not None:
        return
    if gate:
        raise typer.Exit(_run_gate(rounds, as_json))
    if sensors is not None:
        _compare_sensors(sensors, plots, as_json)
        return
    if report is not None:
        _write_report(report, rounds)
        return
    _compare(_names(scenes), _names(engines), rounds, plots, as_json)


@bench_commands.command()
def stability(
    *,
    frames: Annotated[
        int, typer.Option("--frames", min=1, metavar="N", help="Number of seeded random frames.")
    ] = 10_000,
    changes: Annotated[
        int, typer.Option("--changes", min=0, metavar="N", help="Then change parameters and frames N times.")
    ] = 0,
    seed: Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Seed of the frames.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Compare the compiled pipeline with a float64 reference on random and adversarial frames.

    Exit status 1 if a pixel differs by more than rounding explains, or a cached result differs from a new one.
    """
    from dataclasses import asdict

    from ...core.bench.stability import check_long_run, check_stability

    with CliProgress(quiet=as_json) as progress:
        report = check_stability(frames, seed, lambda share: progress.preparing(share, "comparing frames"))
        run = check_long_run(changes, seed, lambda share: progress.preparing(share, "changing parameters and frames"))
    if as_json:
        typer.echo(json.dumps({"stability": asdict(report), "long_run": asdict(run)}))
    else:
        typer.echo(report.words())
        if changes:
            typer.echo(run.words())
    raise typer.Exit(1 if report.unexplained or run.different else 0)


@bench_commands.command()
def memory(
    *,
    source: SourceOption = SOURCE,
    preset: PresetOption = None,
    frames: Annotated[
        int, typer.Option("--frames", min=1, metavar="N", help="Number of frames, processed in turn.")
    ] = 10,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Measure the memory that Python and NumPy allocate per frame, and that of patch.points."""
    from dataclasses import replace
    from itertools import cycle, islice

    from ...core.bench.measure import allocation
    from ...core.contact.pipeline import ContactPipeline
    from ...core.errors import SourceError
    from ...core.sources.presets import load_preset

    used = load_preset(preset or default_preset(source))
    with open_with_progress(source, used.cameras) as opened:
        shown = list(islice(opened, frames))
        pipeline = ContactPipeline(used, opened.rig)
    if not shown:
        raise SourceError(f"{opened.name} gave no frames; check the source")
    turn = cycle(shown)
    largest = max((pipeline.process(frame) for frame in shown), key=lambda patch: len(patch.points))
    frame_bytes = allocation(lambda: pipeline.process(replace(next(turn))), MEASURED_FRAMES)
    facts = {
        "source": opened.name,
        "contact_test": used.contact_test,
        "most_points": len(largest.points),
        "points_bytes": largest.points.nbytes,
        "contiguous": largest.points.flags.c_contiguous,
        "copied_when_read": largest.points is not largest.points,
        "frame_bytes": frame_bytes.peak_bytes,
        "left_bytes": frame_bytes.left_bytes,
    }
    if as_json:
        typer.echo(json.dumps(facts))
        return
    kind = f"{largest.points.dtype}, {'' if facts['contiguous'] else 'not '}C-contiguous"
    kind += f", {'' if facts['copied_when_read'] else 'not '}copied when read"
    typer.echo(f"{opened.name}, {used.contact_test} test, {counted(len(shown), 'frame')}")
    typer.echo(f"patch.points: up to {largest.points.shape}, {kind}, {facts['points_bytes']:,} bytes")
    typer.echo(f"processing a frame: at most {facts['frame_bytes']:,} bytes, its patch included")
    typer.echo(f"left after {MEASURED_FRAMES} frames: {facts['left_bytes']:,} bytes")


def _names(text: str) -> list[str]:
    """Split a comma-separated list; empty for ``all``."""
    return [] if text == "all" else [name.strip() for name in text.split(",") if name.strip()]


def _run_gate(rounds: int, as_json: bool) -> int:
    from ...core.bench.gate import run_gate
    from ...core.bench.measure import machine_facts

    _need("open3d")
    with CliProgress(quiet=as_json) as progress:
        checks = run_gate(rounds, progress.preparing)
    if as_json:
        lines = [{"words": c.words, "measured": c.measured, "wanted": c.wanted, "holds": c.holds} for c in checks]
        typer.echo(json.dumps({"machine": machine_facts(), "checks": lines}, indent=2))
    else:
        typer.echo(_machine_line(machine_facts()))
        for check in checks:
            typer.echo(str(check))
    return 0 if all(check.holds for check in checks) else 1


def _compare(scenes: list[str], engines: list[str], rounds: int, plots: Path | None, as_json: bool) -> None:
    from ...core.bench.measure import machine_facts
    from ...core.bench.registry import Job
    from ...core.bench.run import compare_engines, rows_as_json, rows_as_text
    from ...core.bench.scenes import scene_names

    facts = machine_facts()
    with CliProgress(quiet=as_json) as progress:
        rows = compare_engines(
            scenes or scene_names(), list(Job), rounds=rounds, only=engines, progress=progress.preparing
        )
    if as_json:
        typer.echo(json.dumps({"machine": facts, "rows": rows_as_json(rows)}, indent=2, allow_nan=False))
    else:
        typer.echo(_machine_line(facts) + "\n\n" + rows_as_text(rows))
    if plots is not None:
        from ...core.bench.report import draw_pareto

        for path in draw_pareto(rows, plots):
            typer.echo(f"wrote {path}", err=as_json)


def _compare_sensors(sensors: str, plots: Path | None, as_json: bool) -> None:
    """Measure the contact tests on the cup at all presses, each sensor with one seed."""
    from dataclasses import asdict

    from ...core.bench.measure import machine_facts
    from ...core.bench.report import draw_sensors
    from ...core.bench.sensors import sensor_timings, timings_as_text

    plan = plan_sensor_table(
        sensors, "standard", "cup", "low,medium,high", 1, held_out=False, preset="simulator", rig="measured", work=None
    )
    timings = sensor_timings(measure_sensor_table(plan).cells)
    facts = machine_facts()
    if as_json:
        typer.echo(json.dumps({"machine": facts, "sensors": [asdict(it) for it in timings]}, indent=2))
    else:
        typer.echo(_machine_line(facts) + "\n\n" + timings_as_text(timings))
    for path in draw_sensors(timings, plots) if plots is not None else []:
        typer.echo(f"wrote {path}", err=as_json)


def _write_report(path: Path, rounds: int) -> None:
    """Measure everything and write the page; its figure goes into ``images/bench`` beside it."""
    from ...core.bench.gate import run_gate
    from ...core.bench.measure import machine_facts
    from ...core.bench.registry import Job
    from ...core.bench.report import BenchReport, draw_pareto, write_report
    from ...core.bench.run import compare_engines
    from ...core.bench.scenes import scene_names
    from ...core.bench.stability import check_long_run, check_stability

    _need("open3d")
    machine = _machine_line(machine_facts())
    with CliProgress() as progress:
        measured = BenchReport(
            machine=machine,
            checks=run_gate(rounds, progress.preparing),
            rows=compare_engines(scene_names(), list(Job), rounds=rounds, progress=progress.preparing),
            stability=check_stability(10_000, 0, lambda share: progress.preparing(share, "comparing frames")),
            long_run=check_long_run(20_000, 0, lambda share: progress.preparing(share, "changing parameters")),
        )
    write_report(measured, path, draw_pareto(measured.rows, path.parent / "images" / "bench"))
    typer.echo(f"wrote {path}")


def _machine_line(facts: dict[str, Any]) -> str:
    packages = ", ".join(f"{name} {number}" for name, number in facts["packages"].items() if number)
    return (
        f"{facts['processor']}, {facts['cores']} cores, {facts['memory_gib']} GiB, load {facts['load_1min']}; "
        f"{facts['system']}, Python {facts['python']}; {packages}"
    )


def _need(package: str) -> None:
    from importlib.util import find_spec

    if find_spec(package) is None:
        raise TactuneError(f"the gate compares with {package}, which is not installed: pip install 'tactune[bench]'")
