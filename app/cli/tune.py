"""The command ``tactune tune``: search for good preset values over recordings and scenes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from ...core.errors import ExportError, counted
from .common import CliProgress, default_preset, stop_on_signals, warn

if TYPE_CHECKING:
    from ...core.preset import Preset
    from ...core.tuning.study import Plan, Study, Trial
    from ...core.tuning.workers import Workers


class SamplerName(StrEnum):
    """How trials are chosen."""

    GRID = "grid"
    QMC = "qmc"
    TPE = "tpe"
    NSGA2 = "nsga2"


def tune(
    *,
    preset: Annotated[
        str | None,
        typer.Option("--preset", "-p", metavar="FILE|NAME", help="Where the search starts; default: as for tactune run "
                     "if all sources have the same, else default."),
    ] = None,
    source: Annotated[
        list[str] | None,
        typer.Option("--source", "-s", metavar="SOURCE", help="A recording or a simulated scene, such as "
                     "'sim:cup?press=medium'; may be repeated."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="FIELD=VALUES", help="Values of a preset field: outliers.k=10,20,30, a range "
                     "tolerance.t=0.005:0.03, or a range with steps 0.005:0.03:6 (6log: in equal ratios); may be "
                     "repeated. Default: all numbers of the preset's contact test over their sliders' ranges."),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option("--frames", "-n", metavar="N|A:B|A:B:STEP", help="Which frames of each source: the "
                     "first N, or A up to but not including B; default: all."),
    ] = None,
    objective: Annotated[
        str | None,
        typer.Option(metavar="NAME,…", help="What to optimise: rmse (mm), iou, area_error (mm2), with truth; ms, area "
                     "(mm2), stability (mean IoU of one frame and the next). Default: rmse,ms; stability,ms without "
                     "truth."),
    ] = None,
    trials: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Number of trials, those of earlier runs included; default: the whole "
                     "grid, else 60."),
    ] = None,
    sampler: Annotated[
        SamplerName | None,
        typer.Option(help="grid: every combination. qmc: quasi-random, covers evenly. tpe: learns from trials. nsga2: "
                     "evolves. Default: grid if all fields have steps and --trials is not given, else tpe."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**31, metavar="S", help="Seed of the sampler.")] = 0,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, max=1024, metavar="N", help="Processes; default: one per core.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler, such as tcp://10.0.0.5:8786: run on its workers, which "
                     "need this version of Tactune and see the recordings under the same paths."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE.json", help="Write the preset that is best by the first objective."),
    ] = None,
    study: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="All trials, for optuna-dashboard too; searches that share it work together. "
                     "Default: beside --out, else tune.study.log."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print each trial as one line of JSON when it ends.")] = False,
) -> None:  # fmt: skip
    """Search for preset values with the best error and run time. After Ctrl+C or a crash the same command continues."""
    from ...core.sources.presets import load_preset
    from ...core.sources.registry import open_source
    from ...core.tuning.clips import ALL_FRAMES, parse_frames
    from ...core.tuning.space import parse_axis
    from ...core.tuning.study import Study, make_plan

    axes = [parse_axis(text) for text in settings or []]
    chosen = ALL_FRAMES if frames is None else parse_frames(frames)
    sources = source or []
    name = preset or _usual_preset(sources)
    base, base_file = load_preset(name), Path(name) if Path(name).is_file() else None
    kept = study or (out.with_name(f"{out.stem}.study.log") if out else Path("tune.study.log"))
    if out is not None:
        _check_out(out, kept, base_file)
    with _workers(scheduler, jobs) as workers, CliProgress(quiet=as_json) as progress:
        plan = make_plan(
            base,
            axes,
            sources,
            frames=chosen,
            objectives=[word.strip() for word in (objective or "").split(",") if word.strip()],
            sampler=None if sampler is None else sampler.value,
            trials=trials,
            seed=seed,
            opener=lambda name: open_source(name, progress.preparing),
            progress=lambda name: progress.frames(0, None, f"reading {name}"),
        )
        with Study(plan, kept) as opened:
            _search(opened, workers, progress, as_json)
            found, front = opened.trials(), opened.front()
    if not front:
        failure = next((f", such as: {trial.failure}" for trial in found if trial.failure), "")
        raise ExportError(f"no trial found any contact{failure}; widen the ranges, or take frames with contact")
    if not as_json:
        _print_front(plan, found, front)
    if out is not None:
        _write_best(out, plan, front[0], len(found), base_file)


def _search(study: Study, workers: Workers, progress: CliProgress, as_json: bool) -> None:
    """Run the search with progress; after Ctrl+C, say how to continue."""
    plan = study.plan
    if as_json:
        _say({"trials": plan.trials, "objectives": plan.objectives, "study": str(study.path)})
    said: set[int] = set()
    with stop_on_signals() as stopped:
        for done in study.run(workers, stopped.is_set):
            progress.frames(done, plan.trials, "trials")
            if as_json:
                for trial in study.trials():
                    if trial.number not in said:
                        said.add(trial.number)
                        _say(vars(trial))
                _say({"front": [trial.number for trial in study.front()]})
    if stopped.is_set():
        warn(
            f"{len(study.trials())} of {counted(plan.trials, 'trial')} are kept in {study.path}; "
            "the same command continues from there"
        )
        raise typer.Exit(130)


def _say(document: dict[str, Any]) -> None:
    typer.echo(json.dumps(document, allow_nan=False))


def _usual_preset(sources: Sequence[str]) -> str:
    names = {default_preset(source) for source in sources}
    return names.pop() if len(names) == 1 else "default"


@contextmanager
def _workers(scheduler: str | None, jobs: int | None) -> Iterator[Workers]:
    """Yield local workers, or those of a cluster."""
    from ...core.contact.kernels.threads import available_threads
    from ...core.contact.warmup import warm_up_if_needed
    from ...core.tuning.space import TuneError
    from ...core.tuning.workers import cluster_workers, local_workers

    if scheduler is None:
        with CliProgress() as progress:
            warm_up_if_needed(progress.preparing)
        with local_workers(jobs or available_threads()) as workers:
            yield workers
        return
    if jobs is not None:
        raise TuneError("--jobs is for processes on this computer; remove it or --scheduler")
    with cluster_workers(scheduler) as workers:
        yield workers


def _check_out(path: Path, study: Path, base_file: Path | None) -> None:
    """Refuse an --out that cannot be written, or would overwrite anything but an earlier search's preset."""
    from ...core.model.files import check_writable
    from ...core.tuning.study import FOUND_BY

    if path.resolve() == study.resolve():
        raise ExportError(f"--out and --study are both {path}; name two files")
    if path.exists() and not path.is_file():
        raise ExportError(f"--out is {path}, which is not a file; name a .json file")
    if base_file is not None and path.resolve() == base_file.resolve():
        raise ExportError(f"--out would replace {path}, the preset that the search starts from; name another file")
    if path.is_file() and FOUND_BY not in path.read_text("utf-8", errors="replace"):
        raise ExportError(f"{path} already exists and was not written by a search; choose another --out or remove it")
    check_writable(path)


def _write_best(path: Path, plan: Plan, best: Trial, trials: int, base_file: Path | None) -> None:
    from ...core.preset.file import save_preset
    from ...core.rig.untouched import copy_untouched
    from ...core.tuning.study import tuned_preset

    preset: Preset = tuned_preset(plan, best, trials)
    if preset.untouched is not None and base_file is not None:
        copy_untouched(preset.untouched, base_file, path)
    save_preset(preset, path)
    typer.echo(f"wrote {path}: trial {best.number}", err=True)


def _print_front(plan: Plan, found: Sequence[Trial], front: Sequence[Trial]) -> None:
    """Print the trials that no other beats, and the present preset."""
    from ...core.tuning.measure import OBJECTIVES
    from ...core.tuning.space import at_edge

    table = Table(title=f"Not beaten by any of {counted(len(found), 'trial')}", box=SIMPLE, title_justify="left")
    table.add_column("trial", justify="right", no_wrap=True)
    for name in plan.objectives:
        unit = OBJECTIVES[name].unit
        table.add_column(name if unit in ("", name) else f"{name} ({unit})", justify="right", no_wrap=True)
    for axis in plan.axes:
        table.add_column(axis.path, justify="right", no_wrap=True)
    present = [trial for trial in found if trial.present and not trial.failure]
    for trial in [*front, *(trial for trial in present if trial not in front)]:
        table.add_row(
            f"{trial.number}{' (present)' if trial.present else ''}",
            *(f"{trial.figures[name]:.4g}" for name in plan.objectives),
            *(json.dumps(trial.values[axis.path]).strip('"') for axis in plan.axes),
        )
    console = Console(highlight=False, width=1000)
    console.print(table)
    for sentence in at_edge(plan.axes, front[0].values):
        console.print(f"{sentence[:1].upper()}{sentence[1:]}.")
    if failed := [trial for trial in found if trial.failure]:
        warn(f"{counted(len(failed), 'trial')} failed, such as: {failed[0].failure}")
