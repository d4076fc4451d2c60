"""The command ``tactune sweep``: try preset parameters over many sources and rank them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from ...core.errors import ExportError
from .common import CliProgress, counted, default_preset, finite_or_none, warn

if TYPE_CHECKING:
    from ...core.preset import Preset
    from ...core.tuning.best import Edge, Effect, Score
    from ...core.tuning.plan import Plan, Request
    from ...core.tuning.sweep import Engine, Journal, Row
    from ...core.tuning.values import SweepFile

#: Suffix of the journal beside the table, from which an interrupted sweep continues.
JOURNAL_SUFFIX = ".runs.jsonl"
#: Number of settings shown.
TOP: Final = 10

_UNITS: Final = {"rmse_mm": "mm", "area_error": "mm2", "area": "mm2", "ms": "ms per frame"}


@dataclass(frozen=True)
class _Options:
    """The options of the command line and the sweep file, merged."""

    preset: Preset
    preset_file: Path | None
    request: Request
    objective: str | None


def sweep(
    *,
    preset: Annotated[
        str | None,
        typer.Option("--preset", "-p", metavar="FILE|NAME", help="Values of all fields that are not swept; default: "
                     "as for tactune run if all sources have the same, else default."),
    ] = None,
    source: Annotated[
        list[str] | None,
        typer.Option("--source", "-s", metavar="SOURCE", help="A recording or a simulated scene, such as "
                     "'sim:cup?press=medium'; may be repeated."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="FIELD=VALUES", help="Values of a preset field: outliers.k=10,20,30, or "
                     "LOW:HIGH:STEPS as in tolerance.t=0.005:0.03:6 (6log: in equal ratios); may be repeated. Every "
                     "combination is run."),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="fusion (the preset's own pipeline) or another method; may be repeated. A "
                     "wrong name lists all."),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option("--frames", "-n", metavar="N|A:B|A:B:STEP", help="Which frames of each source: the "
                     "first N, or A up to but not including B; default: all."),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, max=1000, metavar="N", help="Noise seeds per simulated source.")
    ] = None,
    sample: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="N combinations that cover all ranges evenly (Latin hypercube) "
                     "instead of every one; ranges need no steps: LOW:HIGH or LOW:HIGH:log."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, metavar="S", help="Seed of the sample.")] = None,
    file: Annotated[
        Path | None,
        typer.Option("--file", metavar="FILE.json", help="These options as a file, such as {\"source\": [...], "
                     "\"set\": {\"tolerance.t\": \"0.005:0.03:6log\"}}; options on the command line win."),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, max=1024, metavar="N", help="Processes; default: one per core.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler, such as tcp://10.0.0.5:8786: run on its workers, which "
                     "need this version of Tactune and see the recordings under the same paths."),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE.parquet", help="The table, one row per run; its journal "
                           "is kept beside it.")
    ] = Path("sweep.parquet"),
    replace: Annotated[
        bool, typer.Option("--replace", help="Replace a table in --out that belongs to another sweep.")
    ] = False,
    objective: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="The figure to rank by: rmse_mm, iou, area_error (with truth), ms, area, "
                     "stability (mean IoU of one frame and the next). Default: rmse_mm, stability without truth."),
    ] = None,
    best: Annotated[
        Path | None, typer.Option(metavar="FILE.json", help="Write the best parameters as a preset.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON.")] = False,
) -> None:  # fmt: skip
    """Try parameters over recordings and scenes in parallel. After Ctrl+C the same command continues."""
    from ...core.sources.registry import open_source
    from ...core.tuning.best import (
        best_preset,
        check_presentable,
        choose_objective,
        edges,
        effects,
        rank,
    )
    from ...core.tuning.plan import little_averaged, make_plan, short_clips
    from ...core.tuning.sweep import Journal, check_replaced, check_table, sweep_rows, write_table

    options = _options(file, preset, source, settings, method, frames, seeds, sample, seed, objective)
    kept = out.with_name(out.name.removesuffix(".parquet") + JOURNAL_SUFFIX)
    check_table(out, kept)
    if best is not None:
        _check_best(best, out, kept, options)
    with _engine(scheduler, jobs) as (engine, workers), CliProgress() as progress:
        plan = make_plan(
            options.preset,
            options.request,
            opener=lambda name: open_source(name, progress.preparing),
            progress=lambda name: progress.frames(0, None, f"reading {name}"),
        )
        if not replace:
            check_replaced(out, plan)
        chosen = choose_objective(options.objective, plan)
        if best is not None:
            check_presentable(plan)
        if options.request.seeds > 1 and len(plan.clips) == len(options.request.sources):
            warn("--seeds changes the noise of simulated sources only; no source is simulated")
        for sentence in (*short_clips(plan, options.request.frames), *little_averaged(plan)):
            warn(sentence)
        with Journal(kept) as journal:
            _measure(plan, journal, engine, workers, progress)
            rows = sweep_rows(plan, journal)
    write_table(out, plan, rows)
    scores = rank(plan, rows, chosen)
    found, at_edge = effects(plan, scores), edges(plan, scores)
    if as_json:
        typer.echo(json.dumps(_outcome_as_json(scores, found, at_edge, chosen, rows, out), indent=2, allow_nan=False))
    else:
        _print_outcome(plan, scores, found, at_edge, chosen)
    typer.echo(f"wrote {out}: {counted(len(rows), 'run')}", err=True)
    if failed := [row for row in rows if row["failure"]]:
        warn(f"{counted(len(failed), 'run')} failed, such as: {failed[0]['failure']}")
    if best is not None:
        _write_best(best, best_preset(plan, scores[0], chosen), options)


def _options(
    file: Path | None,
    preset: str | None,
    source: list[str] | None,
    settings: list[str] | None,
    method: list[str] | None,
    frames: str | None,
    seeds: int | None,
    sample: int | None,
    seed: int | None,
    objective: str | None,
) -> _Options:
    """Merge the sweep file and the options; options win."""
    from ...core.methods.registry import needs_untouched
    from ...core.rig.untouched import load_untouched
    from ...core.sources.presets import load_preset
    from ...core.tuning.clips import FrameRange, parse_frames
    from ...core.tuning.plan import FUSION, Request
    from ...core.tuning.values import SweepFile, load_sweep_file, make_axis, parse_axis

    told = SweepFile() if file is None else load_sweep_file(file)
    axes = {path: make_axis(path, given) for path, given in told.set.items()}
    named = [parse_axis(text) for text in settings or []]
    replaced = {axis.path for axis in named}
    sources = tuple(source or told.source)
    methods = tuple(method or told.method) or (FUSION,)
    name = preset or _preset_of_file(told, file) or _usual_preset(sources)
    which = frames if frames is not None else told.frames
    base, base_file = load_preset(name), Path(name) if Path(name).is_file() else None
    untouched = None
    if base.untouched is not None and base_file is not None and any(map(needs_untouched, methods)):
        untouched = load_untouched(base.untouched, base_file)
    return _Options(
        base,
        base_file,
        Request(
            axes=(*(axis for path, axis in axes.items() if path not in replaced), *named),
            sources=sources,
            methods=methods,
            frames=FrameRange() if which is None else parse_frames(str(which)),
            seeds=seeds or told.seeds or 1,
            sample=sample or told.sample,
            sample_seed=seed if seed is not None else told.seed or 0,
            untouched=untouched,
        ),
        objective or told.objective,
    )


def _preset_of_file(told: SweepFile, file: Path | None) -> str | None:
    """Return the preset that a sweep file names; a file beside it wins over a shipped preset."""
    if told.preset is None or file is None:
        return told.preset
    beside = file.parent / told.preset
    return str(beside) if beside.is_file() else told.preset


def _usual_preset(sources: tuple[str, ...]) -> str:
    names = {default_preset(source) for source in sources}
    return names.pop() if len(names) == 1 else "default"


@contextmanager
def _engine(scheduler: str | None, jobs: int | None) -> Iterator[tuple[Engine, int]]:
    """Yield the engine that runs the sweep and its number of parallel workers."""
    from functools import partial

    from ...core.contact.kernels.threads import available_threads
    from ...core.contact.warmup import warm_up_if_needed
    from ...core.tuning.values import SweepError
    from ...core.tuning.workers import check_joblib, connect, run_locally

    if scheduler is None:
        check_joblib()
        with CliProgress() as progress:
            warm_up_if_needed(progress.preparing)
        count = jobs or available_threads()
        yield partial(run_locally, jobs=count), count
        return
    if jobs is not None:
        raise SweepError("--jobs is for processes on this computer; remove it or --scheduler")
    with connect(scheduler) as cluster:
        yield (
            partial(cluster.run, waiting=lambda: warn("the cluster has no workers; waiting for one")),
            cluster.threads,
        )


def _measure(plan: Plan, journal: Journal, engine: Engine, workers: int, progress: CliProgress) -> None:
    """Run the missing runs with progress; after Ctrl+C, say how to continue."""
    from ...core.tuning.sweep import measure_sweep

    try:
        for done in measure_sweep(plan, journal, engine, workers):
            progress.frames(done, len(plan.runs), "runs")
    except KeyboardInterrupt:
        journal.read()
        done = sum(run.key in journal for run in plan.runs)
        warn(
            f"{done} of {counted(len(plan.runs), 'run')} are kept in {journal.path}; "
            "the same command continues from there"
        )
        raise


def _check_best(path: Path, out: Path, kept: Path, options: _Options) -> None:
    """Refuse a --best that would overwrite anything but an earlier sweep's best preset."""
    from ...core.tuning.best import FOUND_BY

    for other, what in ((out, "--out"), (kept, "the journal of the sweep")):
        if path.resolve() == other.resolve():
            raise ExportError(f"--best and {what} are both {path}; name two files")
    if path.exists() and not path.is_file():
        raise ExportError(f"--best is {path}, which is not a file; name a .json file")
    if options.preset_file is not None and path.resolve() == options.preset_file.resolve():
        raise ExportError(f"--best would replace {path}, the preset that the sweep starts from; name another file")
    if path.is_file() and FOUND_BY not in path.read_text("utf-8", errors="replace"):
        raise ExportError(f"{path} already exists and was not written by a sweep; choose another --best or remove it")


def _write_best(path: Path, preset: Preset, options: _Options) -> None:
    from ...core.preset.file import save_preset
    from ...core.rig.untouched import copy_untouched

    if preset.untouched is not None and options.preset_file is not None:
        copy_untouched(preset.untouched, options.preset_file, path)
    save_preset(preset, path)
    typer.echo(f"wrote {path}", err=True)


def _print_outcome(
    plan: Plan, scores: Sequence[Score], effects: Iterable[Effect], edges: Iterable[Edge], objective: str
) -> None:
    """Print the best settings and the mean effect of each parameter."""
    from ...core.tuning.best import OBJECTIVES

    console = Console(highlight=False, soft_wrap=True)
    larger = OBJECTIVES[objective][1]
    heading = (
        f"{objective}{f' ({_UNITS[objective]})' if objective in _UNITS else ''}, {'most' if larger else 'least'} first"
    )
    best = Table(title=f"Best {min(TOP, len(scores))} of {len(scores)} settings by {heading}", box=SIMPLE,
                 title_justify="left")  # fmt: skip
    names = _columns(plan)
    for name in names:
        best.add_column(name, no_wrap=True)
    for name in (objective, *["ms"] * (objective != "ms"), "failed or missed"):
        best.add_column(name, justify="right", no_wrap=True)
    for score in scores[:TOP]:
        times = [_number(score.ms)] * (objective != "ms")
        best.add_row(*(_value(score, name) for name in names), _number(score.value), *times, str(score.bad))
    console.print(best)
    by_value = Table(title=f"Mean {objective} over all other parameters", box=SIMPLE, title_justify="left")
    for name in ("parameter", "value"):
        by_value.add_column(name, no_wrap=True)
    for name in (objective, "runs"):
        by_value.add_column(name, justify="right")
    shown = ""
    for effect in effects:
        by_value.add_row("" if effect.path == shown else effect.path, effect.label, _number(effect.value),
                         str(effect.runs))  # fmt: skip
        shown = effect.path
    if shown:
        console.print(by_value)
    for edge in edges:
        console.print(f"{edge.sentence[:1].upper()}{edge.sentence[1:]}.")


def _outcome_as_json(
    scores: Sequence[Score],
    effects: Iterable[Effect],
    edges: Iterable[Edge],
    objective: str,
    rows: Sequence[Row],
    out: Path,
) -> dict[str, Any]:
    """Return the content of `_print_outcome` for JSON."""
    return {
        "runs": len(rows),
        "failed": sum(bool(row["failure"]) for row in rows),
        "out": str(out),
        "objective": objective,
        "top": [
            {
                "method": score.setting.method,
                "values": score.setting.values,
                "value": finite_or_none(score.value),
                "ms": finite_or_none(score.ms),
                "failed_or_missed": score.bad,
                "runs": score.runs,
            }
            for score in scores[:TOP]
        ],
        "effects": [
            {"parameter": effect.path, "value": effect.label, "mean": effect.value, "runs": effect.runs}
            for effect in effects
        ],
        "at_edge": [
            {"parameter": edge.path, "value": edge.value, "edge": "largest" if edge.largest else "smallest"}
            for edge in edges
        ],
    }


def _columns(plan: Plan) -> list[str]:
    several = len({setting.method for setting in plan.settings}) > 1
    return [*["method"] * several, *plan.paths]


def _value(score: Score, name: str) -> str:
    if name == "method":
        return score.setting.method
    value = score.setting.values[name]
    return value if isinstance(value, str) else json.dumps(value)


def _number(number: float) -> str:
    return "-" if math.isnan(number) else f"{number:.4g}"
