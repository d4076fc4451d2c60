"""The command ``tactune run``: frames in, patches out."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from statistics import median
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ...core.errors import ExportError, SourceError, counted
from ...core.model.files import finite_or_none
from .common import (
    SOURCE,
    CliProgress,
    FrameCount,
    LineOutput,
    PresetOption,
    SourceOption,
    default_preset,
    live_frames,
    number_of_frames,
    open_with_progress,
    parse_settings,
    stop_on_signals,
    warn,
    warn_of_lost_frames,
)

if TYPE_CHECKING:
    from ...core.contact.pipeline import ContactPatch, ContactPipeline
    from ...core.estimation.tilt import Tilt
    from ...core.model.frames import GroundTruth, Rig, SensorFrame
    from ...core.preset import Preset
    from ...core.sources import FrameSource
    from .watching import Watching

    SavePatch = Callable[[ContactPatch, SensorFrame], None]
    Estimator = Callable[[ContactPatch, SensorFrame], Tilt]

Record = dict[str, Any]

#: Exit status after Ctrl+C or SIGTERM, as shells use it.
INTERRUPTED_STATUS = 130
#: Exit status after the reader of standard output has gone: that of a program that SIGPIPE ends.
READER_GONE_STATUS = 141

#: Suffix of recordings and of bags of patches.
MCAP_SUFFIX = ".mcap"

#: Keys that ``--truth`` adds to a record beside ``touched``, with their units.
TRUTH_KEYS = {"iou": "", "precision": "", "recall": "", "rmse_mm": " mm"}
#: What ``--estimate`` reads from each patch.
Estimate = Literal["tilt", "tilt-filtered", "tilt-pca"]
EstimateOption = Annotated[
    Estimate | None,
    typer.Option(
        "--estimate",
        help="Add roll, pitch and long axis of each patch with their standard deviations: from each frame by the "
        "measured noise, filtered over time, or by principal components.",
    ),
]


def run(
    *,
    source: SourceOption = SOURCE,
    preset: PresetOption = None,
    frames: FrameCount = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR|FILE.mcap",
            help="A folder for one file per frame (patch_000012.npz), or a .mcap for all patches as PointCloud2.",
        ),
    ] = None,
    file_format: Annotated[Literal["npz", "ply", "csv"], typer.Option("--format", help="Format of the files.")] = "npz",
    json_lines: Annotated[
        bool, typer.Option("--json", help="Print a JSON line for each frame at once; no summary.")
    ] = False,
    truth: Annotated[
        bool, typer.Option("--truth", help="Compare with the ground truth of the source (simulator, labels).")
    ] = False,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="FIELD=VALUE",
            help="Change a preset field for this run, as in tactune preset new; may be repeated.",
        ),
    ] = None,
    watch: Annotated[
        bool,
        typer.Option(
            "--watch",
            help="Look once in ten seconds whether a camera moved or the pressure changed, and warn.",
        ),
    ] = False,
    estimate: EstimateOption = None,
) -> None:
    """Compute contact patches without a window."""
    if out is None and not json_lines and not truth and not watch and estimate is None:
        raise typer.BadParameter(
            "give --out DIR or FILE.mcap for the patches, --json for one line per frame, --truth for a comparison, "
            "--watch for the check for drift, or --estimate tilt"
        )
    from ...core.contact.checks import check_rig
    from ...core.contact.pipeline import ContactPipeline
    from ...core.sources.presets import load_preset
    from ...core.warmup import warm_up_if_needed
    from .watching import Watching

    origin = preset or default_preset(source)
    chosen = load_preset(origin).with_values(parse_settings(settings or []))
    if out is not None and out.suffix != MCAP_SUFFIX:
        make_folder(out)
    with open_with_progress(source, chosen.cameras) as opened:
        with CliProgress() as progress:
            warm_up_if_needed(progress.preparing, chosen)
        pipeline = ContactPipeline(chosen, opened.rig)
        warn(*check_rig(chosen, opened.rig))
        lost_before = opened.health().dropped
        with (
            closing(Watching(chosen, origin, opened)) if watch else nullcontext() as look,
            stop_on_signals() as stopped,
            patch_output(out, file_format, opened, chosen) as save,
        ):
            lines = LineOutput(stopped) if json_lines else None
            tilt = make_tilt(estimate, chosen, opened.rig)
            done, records = process_frames(
                opened, pipeline, frames, save, stopped, truth=truth, look=look, lines=lines, tilt=tilt
            )
        if lines is not None and lines.reader_gone:
            raise typer.Exit(READER_GONE_STATUS)
        if not done and not stopped.is_set():
            raise SourceError(f"{opened.name} gave no frames; check the source")
        if opened.health().message:
            warn(opened.health().message)
        warn_of_lost_frames(opened, lost_before)
        if records:
            typer.echo("\n".join(summary(records, opened.name, chosen.name)))
            if out is not None:
                typer.echo(_written(records, out, file_format))
            if frames is not None and done < frames and not stopped.is_set():
                typer.echo(f"{opened.name} ended after {done} of the {frames} frames asked for")
        if stopped.is_set():
            tell_of_stop(opened, done, frames)


@contextmanager
def patch_output(out: Path | None, file_format: str, source: FrameSource, preset: Preset) -> Iterator[SavePatch]:
    """Yield the function that saves a patch: into one bag, into one file each, or nowhere."""
    if out is None:
        yield lambda patch, frame: None
    elif out.suffix == MCAP_SUFFIX:
        from ...core.output.bag import PatchWriter

        with PatchWriter(out, source.rig, preset, source.frame_rate_hz) as writer:
            yield lambda patch, frame: writer.write(patch.points, frame.sequence, frame.proximity_time_s)
    else:
        from ...core.model.frames import note_number
        from ...core.output.cloud_files import patch_cloud, write_cloud

        seen: set[int] = set()

        def save(patch: ContactPatch, frame: SensorFrame) -> None:
            note_number(seen, frame)
            write_cloud(patch_path(out, frame.sequence, file_format), patch_cloud(patch, frame, source.rig))

        yield save


def tell_of_stop(source: FrameSource, done: int, asked: int | None) -> None:
    """After a signal, report the frames done and exit as interrupted, unless all are done or the source is live."""
    total = number_of_frames(source, asked)
    if done and total in (None, done):
        return
    warn(
        f"stopped after {counted(done, 'frame')}"
        if total is None
        else f"stopped after {done} of {counted(total, 'frame')}"
    )
    raise typer.Exit(INTERRUPTED_STATUS)


def process_frames(
    source: FrameSource,
    pipeline: ContactPipeline,
    frames: int | None,
    save: SavePatch,
    stopped: Event,
    *,
    truth: bool = False,
    look: Watching | None = None,
    lines: LineOutput | None = None,
    tilt: Estimator | None = None,
) -> tuple[int, list[Record]]:
    """Process and save up to ``frames`` frames, until ``stopped`` is set."""
    records: list[Record] = []
    done, scored = 0, False
    total = number_of_frames(source, frames)
    with CliProgress(quiet=lines is not None and sys.stdout.isatty()) as progress:
        for frame in live_frames(source, total, stopped, idle=(lambda: None) if lines is None else lines.look):
            patch = pipeline.process(frame)
            record = patch_record(patch)
            record["time_s"] = finite_or_none(frame.proximity_time_s)
            if truth:
                record |= truth_record(patch, frame.truth, source.rig)
                scored |= record["iou"] is not None
            if tilt is not None:
                record["tilt"] = tilt(patch, frame).record()
            if look is not None:
                record["watch"] = look(frame)
            save(patch, frame)
            if lines is not None:
                lines.write(json.dumps(record, allow_nan=False))
            else:
                records.append(record)
            done += 1
            progress.frames(done, total)
    if truth and done and not scored:
        warn(f"{source.name} has no ground truth; iou, precision, recall and rmse_mm are empty")
    return done, records


def make_tilt(estimate: Estimate | None, preset: Preset, rig: Rig) -> Estimator | None:
    """Return the function that estimates the tilt of each patch, in the order of the frames; None without one."""
    if estimate is None:
        return None
    from ...core.estimation.tilt import TiltEstimator
    from ...core.estimation.tilt_filter import TiltFilter

    estimator = TiltEstimator(preset, rig, "pca" if estimate == "tilt-pca" else "noise")
    filtered = TiltFilter() if estimate == "tilt-filtered" else None

    def tilt(patch: ContactPatch, frame: SensorFrame) -> Tilt:
        found = estimator.estimate(patch, frame.sequence, frame.proximity_time_s)
        return found if filtered is None else filtered.update(found)

    return tilt


def make_folder(folder: Path) -> None:
    """Create the folder for patches before anything is computed; warn of older patches in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        older = sum(1 for _ in folder.glob("patch_[0-9]*"))
    except OSError as error:
        raise ExportError(f"cannot write to {folder}: {error.strerror or error}; choose another place") from error
    if older:
        warn(f"{folder} already holds {counted(older, 'patch file')}; files with the same number will be replaced")


def patch_path(folder: Path, sequence: int, file_format: str) -> Path:
    """Return the file of a frame's patch."""
    return folder / f"patch_{sequence:06d}.{file_format}"


def patch_record(patch: ContactPatch) -> Record:
    """Return the numbers of a patch, ready for JSON (an empty patch has the centroid None)."""
    return {
        "sequence": int(patch.sequence),
        "points": len(patch.points),
        "area_mm2": finite_or_none(patch.area_mm2),
        "centroid_m": patch.centroid_m,
        "averaged_frames": patch.averaged_frames,
        "stage_ms": {stage: round(ms, 4) for stage, ms in patch.stage_ms.items()},
    }


def truth_record(patch: ContactPatch, truth: GroundTruth | None, rig: Rig) -> Record:
    """Return the scores against the truth; all are None if the source has no truth."""
    if truth is None:
        return dict.fromkeys(("touched", *TRUTH_KEYS))
    from ...core.model.metrics import compare_with_truth

    scores = compare_with_truth(patch, truth, rig)
    return {"touched": bool(truth.contact.any())} | {key: finite_or_none(scores[key]) for key in TRUTH_KEYS}


def summary(records: list[Record], source: str, preset: str) -> list[str]:
    """Return a few lines about all frames."""
    touched = [record["area_mm2"] for record in records if record["points"]]
    # Medians, because the first frame also loads the compiled code and makes the tables.
    stages = {stage: median(record["stage_ms"][stage] for record in records) for stage in records[0]["stage_ms"]}
    lines = [f"{counted(len(records), 'frame')} of {source} with preset {preset!r}"]
    if touched:
        lines.append(
            f"contact in {len(touched)} of them, patch {min(touched) / 100:.1f} to {max(touched) / 100:.1f} cm2, "
            f"median {median(touched) / 100:.1f} cm2"
        )
    else:
        lines.append("no contact in any of them")
    details = ", ".join(f"{stage} {ms:.1f}" for stage, ms in stages.items())
    lines.append(f"{sum(stages.values()):.1f} ms per frame ({details})")
    if "tilt" in records[0]:
        lines += tilt_lines([record["tilt"] for record in records])
    return lines + truth_lines(records)


def _written(records: list[Record], out: Path, file_format: str) -> str:
    if out.suffix == MCAP_SUFFIX:
        return f"wrote {out}"
    first, last = (patch_path(out, records[i]["sequence"], file_format) for i in (0, -1))
    return f"wrote {first}" + (f" to {last.name}" if last != first else "")


def tilt_lines(tilts: list[Record]) -> list[str]:
    """Return range and median standard deviation of roll and pitch, and in how many frames they are determined."""
    lines = []
    for name in ("roll", "pitch"):
        known = [math.degrees(tilt[f"{name}_rad"]) for tilt in tilts if tilt[f"{name}_rad"] is not None]
        sigmas = [math.degrees(tilt[f"{name}_sigma_rad"]) for tilt in tilts if tilt[f"{name}_rad"] is not None]
        line = f"{name}: determined in {len(known)} of {counted(len(tilts), 'frame')}"
        if known:
            line += f", {min(known):.2f} to {max(known):.2f} degrees"
            line += f", standard deviation {median(sigmas):.2f} degrees (median)"
        lines.append(line)
    return lines


def truth_lines(records: list[Record]) -> list[str]:
    """Return median scores of frames with true contact, and how many other frames have points; [] without truth."""
    with_touch = [record for record in records if record.get("touched")]
    without = [record for record in records if record.get("touched") is False]
    lines = []
    for key, unit in TRUTH_KEYS.items():
        known = [record[key] for record in with_touch if record[key] is not None]
        if known:
            lines.append(
                f"{key}: median {median(known):.3f}{unit} over {counted(len(known), 'frame')} with true contact"
            )
    if without:
        false = sum(bool(record["points"]) for record in without)
        lines.append(f"{counted(len(without), 'frame')} without true contact, {false} of them with false points")
    return lines
