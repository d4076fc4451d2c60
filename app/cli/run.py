"""The command ``tactune run``: frames in, patches out."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from shlex import quote
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ...core.errors import counted, foreign
from ...core.model.files import check_writable, finite_or_none
from .common import (
    SOURCE,
    CliProgress,
    FrameCount,
    PresetOption,
    SetOption,
    SourceOption,
    TopicsOption,
    TruthOption,
    chosen_preset,
    live_frames,
    number_of_frames,
    open_pipeline,
    parse_settings,
    say,
    stop_on_signals,
    tell_of_stop,
    usable,
    warn,
    with_topics,
)

if TYPE_CHECKING:
    from ...core.contact.pipeline import ContactPatch, ContactPipeline
    from ...core.estimation.tilt import Tilt
    from ...core.model.frames import GroundTruth, Rig, SensorFrame
    from ...core.preset import Preset
    from ...core.rig.drift import WatchReport
    from ...core.sources import FrameSource
    from ...core.tuning.advice.proposal import Finding

    SavePatch = Callable[[int, ContactPatch, SensorFrame], None]  # with the frame's number
    Estimator = Callable[[ContactPatch], Tilt]
    Look = Callable[[SensorFrame], None]

Record = dict[str, Any]

#: Frames, the newest, that the summary looks at, so that memory stays small however long it runs.
_SUMMARY_FRAMES = 100_000
#: Suffix of recordings and of bags of patches.
MCAP_SUFFIX = ".mcap"
#: Keys that ``--truth`` adds to a record beside ``touched``, with their units.
TRUTH_KEYS = {"iou": "", "precision": "", "recall": "", "rmse_mm": " mm"}

Estimate = Literal["tilt"]
EstimateOption = Annotated[
    Estimate | None,
    typer.Option(help="Add roll, pitch and long axis of each patch with their standard deviations."),
]


def _place(text: str) -> Path:
    if not text:
        raise typer.BadParameter("it is empty; name a folder, . for this one, or a file that ends in .mcap")
    if (path := Path(text)).suffix != MCAP_SUFFIX and path.is_file():
        raise typer.BadParameter(f"{foreign(text)} is a file; name a folder, or a file that ends in .mcap")
    return path


def run(
    *,
    source: SourceOption = SOURCE,
    topics: TopicsOption = None,
    preset: PresetOption = None,
    frames: FrameCount = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", parser=_place, metavar="DIR|FILE.mcap", help="A folder for .npz files, or a ROS 2 bag."
        ),
    ] = None,
    json_lines: Annotated[
        bool, typer.Option("--json", help="Print a line of JSON for each frame; no summary.")
    ] = False,
    truth: TruthOption = False,
    settings: SetOption = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Warn if a camera has moved or the pressure has changed.")
    ] = False,
    estimate: EstimateOption = None,
) -> None:
    """Compute contact patches without a window.

    Prints a line for each frame, unless patches are written to --out, and a summary. Ctrl+C ends it, too. The exit
    status is then 130, but 0 for live cameras, which have no other end.
    """
    if estimate is not None and not json_lines:
        raise typer.BadParameter("--estimate is printed with --json; add it")
    from ...core.tuning.advice.findings import EXAMINED_EVERY, Examiner

    source = with_topics(source, topics)
    chosen, origin = chosen_preset(preset, source)
    chosen = chosen.with_values(parse_settings(settings))
    if out is not None:
        check_writable(out / "patch" if out.suffix != MCAP_SUFFIX else out)  # before anything is computed
    with open_pipeline(source, chosen, origin) as (opened, pipeline):
        tilt, total = make_tilt(estimate, chosen, opened.rig), number_of_frames(opened, frames)
        examiner = Examiner(opened.rig)
        found: tuple[Finding, ...] = ()
        records: deque[Record] = deque(maxlen=_SUMMARY_FRAMES)
        done, scored, first_s = 0, False, 0.0
        with (
            _drift_watch(watch, pipeline, origin, opened) as look,
            stop_on_signals() as stopped,
            _patch_output(out, opened, chosen) as save,
            CliProgress(quiet=json_lines or out is None) as progress,
        ):
            for frame in live_frames(opened, total, stopped):
                patch = pipeline.process(frame)
                number = patch.sequence if opened.length is None else done  # as the window counts
                first_s = first_s if done else frame.proximity_time_s
                scores = _scores(patch, frame.truth, opened.rig) if truth else {}
                scored |= scores.get("touched") is not None
                look(frame)
                save(number, patch, frame)
                if json_lines:
                    if done % EXAMINED_EVERY == 0:
                        found = examiner.findings(frame, patch, chosen, pipeline.untouched)
                    record = {"frame": number, **_patch_record(patch, frame), **scores}
                    record |= {} if tilt is None else {"tilt": tilt(patch).record()}
                    record["findings"] = [finding.sentence for finding in found]
                    typer.echo(json.dumps(record, allow_nan=False))
                else:
                    if out is None:
                        say(_line(number, patch, frame.proximity_time_s - first_s, scores))
                    records.append({"area_mm2": patch.area_mm2, "stage_ms": patch.stage_ms, **scores})
                done += 1
                progress.frames(done, total)
        if truth and done and not scored:
            warn(f"{opened.name} has no ground truth; iou, precision, recall and rmse_mm are empty")
        if records:
            say("\n".join(_summary(done, records, opened.name, chosen.name)))
            if out is not None:
                say(f"wrote {out}")
            if frames is not None and done < frames and not stopped.is_set():
                say(f"{opened.name} ended after {done} of the {frames} frames asked for")
        if stopped.is_set():
            tell_of_stop(opened, done, frames)


@contextmanager
def _patch_output(out: Path | None, source: FrameSource, preset: Preset) -> Iterator[SavePatch]:
    """Yield the function that saves a patch: into one bag, into one file each, or nowhere."""
    if out is None:
        yield lambda number, patch, frame: None
    elif out.suffix == MCAP_SUFFIX:
        from ...core.output.writer import PatchWriter

        with PatchWriter(out, source.rig, preset, source.frame_rate_hz) as writer:
            yield lambda number, patch, frame: writer.write(patch, frame.proximity_time_s)
    else:
        from ...core.model.frames import note_number
        from ...core.output.cloud_files import patch_columns, write_cloud

        seen: set[int] = set()

        def save(number: int, patch: ContactPatch, frame: SensorFrame) -> None:
            note_number(seen, number)
            write_cloud(out / f"patch_{number:06d}.npz", patch_columns(patch, frame, source.rig))

        yield save


def make_tilt(estimate: Estimate | None, preset: Preset, rig: Rig) -> Estimator | None:
    """Return the function that estimates the tilt of each patch, in the order of the frames; None without one."""
    if estimate is None:
        return None
    from ...core.estimation.tilt import TiltEstimator

    return TiltEstimator(preset, rig).estimate


def _patch_record(patch: ContactPatch, frame: SensorFrame) -> Record:
    """Return the numbers of a patch, ready for JSON (an empty patch has the centroid None)."""
    return {
        "sequence": int(patch.sequence),
        "points": len(patch.points),
        "area_mm2": finite_or_none(patch.area_mm2),
        "centroid_m": patch.centroid_m,
        **patch.doubt.record(),
        **({} if patch.pressure is None else patch.pressure.record()),
        "contacts": [
            {"area_mm2": contact.area_mm2, "centroid_m": contact.centroid_m, **contact.doubt.record()}
            for contact in patch.contacts
        ],
        "averaged_frames": patch.averaged_frames,
        "stage_ms": {stage: round(ms, 4) for stage, ms in patch.stage_ms.items()},
        "time_s": finite_or_none(frame.proximity_time_s),
    }


def _line(number: int, patch: ContactPatch, time_s: float, scores: Record) -> str:
    """Return a frame for people: number, time since the first one, area and centroid, doubt, force, processing time."""
    parts = ["no contact"]
    if patch.centroid_m is not None:
        x, y, z = (1000 * coordinate for coordinate in patch.centroid_m)
        # rounded down, so that no doubt is rounded away
        parts = [
            f"{patch.area_mm2:7,.0f} mm2 at ({x:.1f}, {y:.1f}, {z:.1f}) mm",
            f"touches {math.floor(100 * patch.doubt.touch_probability)} %",
        ]
        if patch.pressure is not None and (force := patch.pressure.words()):
            parts.append(f"force {force}".replace("²", "2"))
        if math.isfinite(patch.doubt.boundary_error_mm):
            parts.append(f"boundary within {patch.doubt.boundary_error_mm:.1f} mm")
    parts += [f"{key} {value:.3f}{TRUTH_KEYS[key]}" for key, value in scores.items() if type(value) is float]
    parts.append(f"{sum(patch.stage_ms.values()):.1f} ms")
    time = f"{time_s:.3f} s" if math.isfinite(time_s) else "-"
    return "; ".join([f"{number:6d}  {time}  {', '.join(parts)}", *patch.doubt.reasons])


def _scores(patch: ContactPatch, truth: GroundTruth | None, rig: Rig) -> Record:
    """Return the scores against the truth; all are None if the source has no truth."""
    if truth is None:
        return dict.fromkeys(("touched", *TRUTH_KEYS))
    from ...core.model.metrics import compare_with_truth

    scores = compare_with_truth(patch, truth, rig)
    return {"touched": bool(truth.contact.any())} | {key: finite_or_none(scores[key]) for key in TRUTH_KEYS}


def _summary(done: int, records: deque[Record], source: str, preset: str) -> list[str]:
    """Return a few lines about all frames, or the newest of very many."""
    areas = [record["area_mm2"] for record in records if record["area_mm2"]]
    contact = "no contact in any of them"
    if areas:
        least, most, middle = min(areas), max(areas), median(areas)
        contact = f"contact in {len(areas)} of them, patch {least:,.0f} to {most:,.0f} mm2, median {middle:,.0f} mm2"
    # Medians, because the first frame also loads the compiled code and makes the tables.
    stages = {stage: median(record["stage_ms"][stage] for record in records) for stage in records[0]["stage_ms"]}
    details = ", ".join(f"{stage} {ms:.1f}" for stage, ms in stages.items())
    newest = f"; the lines below tell of the last {len(records):,}" if done > len(records) else ""
    lines = [
        f"{counted(done, 'frame')} of {source} with preset {preset!r}{newest}",
        contact,
        f"{sum(stages.values()):.1f} ms per frame ({details})",
    ]
    with_touch = [record for record in records if record.get("touched")]
    for key, unit in TRUTH_KEYS.items():
        if known := [record[key] for record in with_touch if record[key] is not None]:
            lines.append(
                f"{key}: median {median(known):.3f}{unit} over {counted(len(known), 'frame')} with true contact"
            )
    return lines


@contextmanager
def _drift_watch(watching: bool, pipeline: ContactPipeline, origin: str, source: FrameSource) -> Iterator[Look]:
    """Yield a function that looks once in ten seconds of the source's time whether something has moved, and warns.

    A look takes longer than a frame. A live source does not wait for it; a recording does, so its result is the same
    each time.
    """
    if not watching:
        yield lambda frame: None
        return
    from ...core.rig.drift import Watch
    from ...core.rig.untouched import find_untouched

    watch = Watch(pipeline.preset, source.rig, usable(find_untouched(pipeline.preset, origin, source)))
    remedy = f" Check with: tactune check --preset {quote(origin)} --source {quote(source.name)}"
    running: Future[WatchReport | None] | None = None

    def look(frame: SensorFrame) -> None:
        nonlocal running
        time_s = frame.proximity_time_s
        if running is None and watch.due(time_s):
            running = thread.submit(watch.look, frame, time_s)
        if running is None or (source.length is None and not running.done()):
            return
        report, running = running.result(), None
        pipeline.cameras_moved = watch.told == "camera"
        if report is not None:
            warn(f"{report.time_s:.1f} s: {report.sentence}{remedy if report.state == 'told' else ''}")

    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="drift") as thread:
        yield look
