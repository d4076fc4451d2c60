"""The command ``tactune tune``: search for good preset values over recordings and scenes."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...core.errors import ExportError, TactuneError, counted
from .common import INTERRUPTED_STATUS, CliProgress, say, stop_on_signals, table_text, warn

if TYPE_CHECKING:
    from ...core.sources import FrameSource
    from ...core.tuning.measure import Workers
    from ...core.tuning.plan import Plan
    from ...core.tuning.study import Study, Trial


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
        typer.Option("--set", metavar="FIELD=VALUES", help="Values of a preset field: outliers.k=10,20,30, or a range "
                     "tolerance.t=0.005:0.03 (0.005:0.03:log: in equal ratios); may be repeated. Default: all numbers "
                     "of the preset's contact test over their sliders' ranges."),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option("--frames", "-n", metavar="N|A:B|A:B:STEP", help="Which frames of each source: the "
                     "first N, or A up to but not including B; default: all."),
    ] = None,
    objective: Annotated[
        str | None,
        typer.Option(metavar="NAME,…", help="What to optimise: rmse (mm), iou, with truth; ms, stability (mean IoU of "
                     "one frame and the next). Default: rmse,ms; stability,ms without truth."),
    ] = None,
    trials: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Number of trials, those of earlier runs included; default: the whole "
                     "grid if all fields have listed values, else 60."),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, max=1024, metavar="N", help="Processes; default: one per core.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler, such as tcp://10.0.0.5:8786: run on its workers of one "
                     "thread, which need this version of Tactune and see the recordings under the same paths."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE.json", help="Write the preset that is best by the first objective."),
    ] = None,
    study: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="All trials, for optuna-dashboard too. Default: beside --out, else "
                     "tune.study.log."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print each trial as one line of JSON when it ends.")] = False,
) -> None:  # fmt: skip
    """Search for preset values with the best error and run time. After Ctrl+C or a crash the same command continues."""
    from ...core.contact.kernels.threads import available_threads
    from ...core.preset.file import save_preset
    from ...core.rig.untouched import copy_untouched
    from ...core.sources.presets import default_preset, load_preset
    from ...core.sources.registry import open_source
    from ...core.tuning.measure import cluster_workers, local_workers
    from ...core.tuning.plan import make_plan, parse_axis
    from ...core.tuning.study import Study, tuned_preset
    from ...core.warmup import warm_up_if_needed

    axes = [parse_axis(text) for text in settings or []]
    sources = source or []
    usual = {default_preset(name) for name in sources}
    name = preset if preset is not None else usual.pop() if len(usual) == 1 else "default"
    base, base_file = load_preset(name), Path(name) if Path(name).is_file() else None
    kept = study or (out.with_name(f"{out.stem}.study.log") if out else Path("tune.study.log"))
    if out is not None:
        _check_out(out, base_file)
    if scheduler and jobs:
        raise TactuneError("--jobs is for processes on this computer; remove it or --scheduler")
    with CliProgress(quiet=as_json) as progress:

        def read(name: str) -> FrameSource:
            progress.frames(0, None, f"reading {name}")
            return open_source(name, progress.preparing)

        plan = make_plan(
            base,
            axes,
            sources,
            frames=_parse_frames(frames),
            objectives=[word.strip() for word in (objective or "").split(",") if word.strip()],
            trials=trials,
            opener=read,
        )
        if not scheduler:
            warm_up_if_needed(progress.preparing)
        with cluster_workers(scheduler) if scheduler else local_workers(jobs or available_threads()) as workers:
            opened = Study(plan, kept)
            _search(opened, workers, progress, as_json)
    found, front = opened.results()
    if not front:
        failure = next((f", such as: {trial.failure}" for trial in found if trial.failure), "")
        raise ExportError(f"no trial found any contact{failure}; widen the ranges, or take frames with contact")
    if not as_json:
        _print_front(plan, found, front)
    if out is not None:
        best = tuned_preset(plan, front[0], len(found))
        _check_out(out, base_file)  # a search takes hours: another program may have taken the name
        if best.untouched is not None and base_file is not None:
            copy_untouched(best.untouched, base_file, out)
        save_preset(best, out, exclusive=not out.exists())
        say(f"wrote {out}: trial {front[0].number}", err=True)


def _check_out(path: Path, base_file: Path | None) -> None:
    """Refuse an --out that cannot be written, or would overwrite anything but an earlier search's preset."""
    from ...core.model.files import check_writable
    from ...core.tuning.study import FOUND_BY

    if base_file is not None and path.resolve() == base_file.resolve():
        raise ExportError(f"--out would replace {path}, the preset that the search starts from; name another file")
    check_writable(path)
    if path.exists() and FOUND_BY not in path.read_text("utf-8", errors="replace"):
        raise ExportError(f"{path} already exists and was not written by a search; choose another --out or remove it")


def _parse_frames(text: str | None) -> slice:
    """Read ``N``, ``A:B`` or ``A:B:STEP``; all frames without a text."""
    text = ":" if text is None else text
    if not re.fullmatch(r"[0-9]{1,9}|[0-9]{0,9}:[0-9]{0,9}(:0*[1-9][0-9]{0,8})?", text):
        raise TactuneError(f"--frames is {text!r}; write a number of frames, or FIRST:END or FIRST:END:STEP")
    return slice(*(int(part) if part else None for part in text.split(":")))


def _search(study: Study, workers: Workers, progress: CliProgress, as_json: bool) -> None:
    """Run the search with progress; after Ctrl+C, say how to continue."""
    plan = study.plan
    if as_json:
        _print_json({"trials": plan.trials, "objectives": plan.objectives, "study": str(study.path)})
    said: set[int] = set()
    with stop_on_signals() as stopped:
        for done in study.run(workers, stopped.is_set):
            progress.frames(done, plan.trials, "trials")
            if as_json:
                trials, front = study.results()
                for trial in trials:
                    if trial.number not in said:
                        said.add(trial.number)
                        _print_json(vars(trial))
                _print_json({"front": [trial.number for trial in front]})
    if stopped.is_set():
        warn(
            f"{len(study.results()[0])} of {counted(plan.trials, 'trial')} are kept in {study.path}; "
            "the same command continues from there"
        )
        raise typer.Exit(INTERRUPTED_STATUS)


def _print_json(document: dict[str, Any]) -> None:
    typer.echo(json.dumps(document, allow_nan=False))


def _print_front(plan: Plan, found: Sequence[Trial], front: Sequence[Trial]) -> None:
    """Print the trials that no other beats, and the present preset."""
    say(f"Not beaten by any of {counted(len(found), 'trial')}:")
    present = [trial for trial in found if trial.present and not trial.failure and trial not in front]
    rows = []
    for trial in [*front, *present]:
        number = f"{trial.number}{' (present)' if trial.present else ''}"
        figures = {name: trial.figures[name] for name in plan.objectives}
        rows.append({"trial": number, **figures, **{axis.path: trial.values[axis.path] for axis in plan.axes}})
    say(table_text(rows))
    for axis in plan.axes:
        best, given = front[0].values[axis.path], axis.values or (axis.low, axis.high)
        numbers = sorted(value for value in given if type(value) in (int, float))
        if len(numbers) > 1 and best in (numbers[0], numbers[-1]):
            end = "smallest" if best == numbers[0] else "largest"
            say(f"The best {axis.path}, {best:g}, is the {end} one that was allowed.")
    if failed := [trial for trial in found if trial.failure]:
        warn(f"{counted(len(failed), 'trial')} failed, such as: {failed[0].failure}")
