"""The commands ``tactune run`` and ``tactune export-folder``: frames in, patches or images out."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from statistics import median
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...core.errors import ExportError, SourceError, counted
from ...core.model.files import finite_or_none
from .common import (
    FUSION,
    SOURCE,
    WAIT_S,
    CliProgress,
    FrameCount,
    LineOutput,
    PresetOption,
    SourceOption,
    default_preset,
    number_of_frames,
    open_with_progress,
    parse_settings,
    stop_on_signals,
    warn,
    warn_of_lost_frames,
    warn_of_wrong_unit,
)

if TYPE_CHECKING:
    from ...core.contact.pipeline import ContactPatch
    from ...core.estimation.tilt import Tilt
    from ...core.methods.method import MethodPatch
    from ...core.model.clouds import PointCloud
    from ...core.model.frames import GroundTruth, Rig, SensorFrame
    from ...core.preset import Preset
    from ...core.sources import FrameSource
    from .methods import Step
    from .watching import Watching

    SavePatch = Callable[[ContactPatch | MethodPatch, SensorFrame], None]
    Estimator = Callable[[ContactPatch | MethodPatch, SensorFrame], Tilt]

Record = dict[str, Any]

#: Exit status after Ctrl+C or SIGTERM, as shells use it.
INTERRUPTED_STATUS = 130
#: Exit status after the reader of standard output has gone: that of a program that SIGPIPE ends.
READER_GONE_STATUS = 141

#: Suffix of recordings and of bags of patches.
MCAP_SUFFIX = ".mcap"

#: Keys that ``--truth`` adds to a record beside ``touched``, with their units.
TRUTH_KEYS = {"iou": "", "precision": "", "recall": "", "rmse_mm": " mm"}
#: Keys of the membrane's largest in-plane strain, from the simulator's solver.
STRAIN_KEYS = {
    "true_strain_length_percent": "along the length",
    "true_strain_width_percent": "along the width",
    "true_max_strain_percent": "in any direction",
}


class Format(StrEnum):
    """File formats of a patch."""

    NPZ = "npz"
    PLY = "ply"
    PCD = "pcd"
    CSV = "csv"


class Estimate(StrEnum):
    """What ``--estimate`` reads from each patch."""

    TILT = "tilt"
    TILT_FILTERED = "tilt-filtered"
    TILT_PCA = "tilt-pca"


EstimateOption = Annotated[
    Estimate | None,
    typer.Option(
        "--estimate",
        help="Add roll, pitch and long axis of each patch with their standard deviations: from each frame by the "
        "measured noise, filtered over time, or by principal components.",
    ),
]


@dataclass(frozen=True)
class RunOptions:
    """Options of ``tactune run``; see its help."""

    source: str
    preset: str
    frames: int | None
    out: Path | None
    file_format: str
    json_lines: bool
    truth: bool
    method: str = FUSION
    untouched: str | None = None
    settings: tuple[str, ...] = ()
    watch: bool = False
    estimate: Estimate | None = None


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
    file_format: Annotated[Format, typer.Option("--format", help="Format of the files.")] = Format.NPZ,
    json_lines: Annotated[
        bool, typer.Option("--json", help="Print a JSON line for each frame at once; no summary.")
    ] = False,
    truth: Annotated[
        bool, typer.Option("--truth", help="Compare with the ground truth of the source (simulator, labels).")
    ] = False,
    method: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="fusion (the preset's own pipeline) or another method; a wrong name lists all."
        ),
    ] = "fusion",
    untouched: Annotated[
        str | None,
        typer.Option(
            metavar="SOURCE", help="A source or path whose first frame shows the untouched membrane; for other methods."
        ),
    ] = None,
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
            help="Look once in ten seconds whether a camera moved, the pressure changed or a lens is dirty, and warn.",
        ),
    ] = False,
    estimate: EstimateOption = None,
) -> None:
    """Compute contact patches without a window."""
    if out is None and not json_lines and not truth and not watch and estimate is None:
        raise typer.BadParameter(
            "give --out DIR or FILE.mcap for the patches, --json for one line per frame, --truth for a comparison, "
            "--watch for the drift watchdog, or --estimate tilt"
        )
    preset = preset or default_preset(source)
    changed = tuple(settings or ())
    run_frames(
        RunOptions(
            source,
            preset,
            frames,
            out,
            file_format.value,
            json_lines,
            truth,
            method,
            untouched,
            changed,
            watch,
            estimate,
        )
    )


def export_folder(
    *,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="A new or empty folder.")],
    source: SourceOption = SOURCE,
    frames: FrameCount = None,
) -> None:
    """Write frames as a folder of PNG images with rig.json."""
    from ...core.sources.folder import export_folder as write_folder

    with open_with_progress(source) as opened, CliProgress() as progress:
        count = write_folder(opened, out, frames, lambda share, _: progress.frames(round(share * 100), 100))
    typer.echo(f"wrote {counted(count, 'frame')} of {opened.name} to {out}")


def run_frames(options: RunOptions) -> None:
    """Compute the patch of each frame; write files, JSON lines or a summary."""
    from ...core.contact.warmup import warm_up_if_needed
    from ...core.preset.checks import check_rig
    from ...core.sources.presets import load_preset
    from .methods import make_step, read_untouched

    preset = load_preset(options.preset).with_values(parse_settings(options.settings))
    untouched = read_untouched(options.method, options.untouched)
    if options.out is not None and options.out.suffix != MCAP_SUFFIX:
        make_folder(options.out)
    with open_with_progress(options.source, preset.cameras) as source:
        if options.method == FUSION:
            with CliProgress() as progress:
                warm_up_if_needed(progress.preparing, preset)
        step = make_step(options.method, preset, options.preset, source, untouched)
        warn(*check_rig(preset, source.rig))
        lost_before = source.health().dropped
        with (
            _watching(options, preset, source) as look,
            stop_on_signals() as stopped,
            patch_output(options, source, preset) as save,
        ):
            lines = LineOutput(stopped) if options.json_lines else None
            tilt = make_tilt(options.estimate, preset, source.rig)
            done, records = process_frames(source, step, options, save, stopped, look, lines, tilt)
        if lines is not None and lines.reader_gone:
            raise typer.Exit(READER_GONE_STATUS)
        if not done and not stopped.is_set():
            raise SourceError(f"{source.name} gave no frames; check the source")
        if source.health().message:
            warn(source.health().message)
        warn_of_lost_frames(source, lost_before)
        if records:
            typer.echo(summary(records, source.name, preset.name, options, stopped=stopped.is_set()))
        if stopped.is_set():
            tell_of_stop(source, done, options.frames)


@contextmanager
def _watching(options: RunOptions, preset: Preset, source: FrameSource) -> Iterator[Watching | None]:
    if not options.watch:
        yield None
        return
    from .watching import Watching

    with closing(Watching(preset, options.preset, source)) as watching:
        yield watching


@contextmanager
def patch_output(options: RunOptions, source: FrameSource, preset: Preset) -> Iterator[SavePatch]:
    """Yield the function that saves a patch: into one bag, into one file each, or nowhere."""
    out = options.out
    if out is None:
        yield lambda patch, frame: None
    elif out.suffix == MCAP_SUFFIX:
        from ...core.output.bag import PatchWriter

        with PatchWriter(out, source.rig, preset, source.frame_rate_hz) as writer:
            yield lambda patch, frame: writer.write(patch.points, frame.sequence, frame.proximity_time_s)
    else:
        from ...core.model.frames import note_number
        from ...core.output.cloud_files import write_cloud

        seen: set[int] = set()

        def save(patch: ContactPatch | MethodPatch, frame: SensorFrame) -> None:
            note_number(seen, frame)
            write_cloud(patch_path(out, frame.sequence, options.file_format), _cloud(patch, frame, source.rig))

        yield save


def _cloud(patch: ContactPatch | MethodPatch, frame: SensorFrame, rig: Rig) -> PointCloud:
    """Return a patch's cloud; methods other than fusion have points only, without pixels."""
    from ...core.contact.pipeline import ContactPatch
    from ...core.model.clouds import PointCloud
    from ...core.output.cloud_files import patch_cloud

    return patch_cloud(patch, frame, rig) if isinstance(patch, ContactPatch) else PointCloud(patch.points)


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
    step: Step,
    options: RunOptions,
    save: SavePatch,
    stopped: Event,
    look: Watching | None = None,
    lines: LineOutput | None = None,
    tilt: Estimator | None = None,
) -> tuple[int, list[Record]]:
    """Process and save each frame until ``stopped`` is set.

    Returns
    -------
    done : int
        Number of frames.
    records : list of dict
        What the summary needs of each; none with ``lines``, which may go on for days.
    """
    records: list[Record] = []
    done, scored = 0, False
    total = number_of_frames(source, options.frames)
    with CliProgress(quiet=options.json_lines and sys.stdout.isatty()) as progress:
        while done != total and not stopped.is_set():
            if not source.wait(WAIT_S):
                if lines is not None:
                    lines.look()
                continue
            frame = source.next_frame()
            if frame is None:
                break
            if not done:
                warn_of_wrong_unit(frame, source.rig)
            record, patch = step(frame)
            record["time_s"] = finite_or_none(frame.proximity_time_s)
            if options.truth:
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
    if options.truth and done and not scored:
        warn(f"{source.name} has no ground truth; iou, precision, recall and rmse_mm are empty")
    return done, records


def make_tilt(estimate: Estimate | None, preset: Preset, rig: Rig) -> Estimator | None:
    """Return the function that estimates the tilt of each patch, in the order of the frames; None without one."""
    if estimate is None:
        return None
    from ...core.estimation.tilt import TiltEstimator
    from ...core.estimation.tilt_filter import TiltFilter

    estimator = TiltEstimator(preset, rig, "pca" if estimate is Estimate.TILT_PCA else "noise")
    filtered = TiltFilter() if estimate is Estimate.TILT_FILTERED else None

    def tilt(patch: ContactPatch | MethodPatch, frame: SensorFrame) -> Tilt:
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


def truth_record(patch: ContactPatch | MethodPatch, truth: GroundTruth | None, rig: Rig) -> Record:
    """Return the scores against the truth; all are None if the source has no truth."""
    if truth is None:
        return dict.fromkeys(("touched", *TRUTH_KEYS, *STRAIN_KEYS))
    from ...core.evaluation.metrics import compare_with_truth

    scores = compare_with_truth(patch, truth, rig)
    known = truth.strain
    strains = (known.length, known.width, known.largest) if known is not None else (None, None, None)
    percent = [None if strain is None else round(100 * strain, 2) for strain in strains]
    return (
        {"touched": bool(truth.contact.any())}
        | {key: finite_or_none(scores[key]) for key in TRUTH_KEYS}
        | dict(zip(STRAIN_KEYS, percent, strict=True))
    )


def summary(records: list[Record], source: str, preset: str, options: RunOptions, *, stopped: bool) -> str:
    """Return the summary in a few lines."""
    touched = [record["area_mm2"] for record in records if record["points"]]
    # Medians, because the first frame also loads the compiled code and makes the tables.
    stages = {stage: median(record["stage_ms"][stage] for record in records) for stage in records[0]["stage_ms"]}
    lines = [f"{counted(len(records), 'frame')} of {source} with preset {preset!r}" + _by(options.method)]
    if touched:
        lines.append(
            f"contact in {len(touched)} of them, patch {min(touched) / 100:.1f} to {max(touched) / 100:.1f} cm2, "
            f"median {median(touched) / 100:.1f} cm2"
        )
    else:
        lines.append("no contact in any of them")
    if failures := [record["failure"] for record in records if record["failure"]]:
        lines.append(f"{options.method} failed in {len(failures)} of them, such as: {failures[0]}")
    details = ", ".join(f"{stage} {ms:.1f}" for stage, ms in stages.items())
    lines.append(f"{sum(stages.values()):.1f} ms per frame ({details})")
    if options.estimate is not None:
        lines += tilt_lines([record["tilt"] for record in records])
    lines += truth_lines(records)
    if options.out is not None and options.out.suffix == MCAP_SUFFIX:
        lines.append(f"wrote {options.out}")
    elif options.out is not None:
        first, last = (patch_path(options.out, records[i]["sequence"], options.file_format) for i in (0, -1))
        lines.append(f"wrote {first}" + (f" to {last.name}" if last != first else ""))
    if options.frames is not None and len(records) < options.frames and not stopped:
        lines.append(f"{source} ended after {len(records)} of the {options.frames} frames asked for")
    return "\n".join(lines)


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
    strains = {
        words: max((record[key] for record in records if record.get(key) is not None), default=None)
        for key, words in STRAIN_KEYS.items()
    }
    if None not in strains.values():
        lines.append("true strain up to " + ", ".join(f"{strain:.1f} % {words}" for words, strain in strains.items()))
    if without:
        false = sum(bool(record["points"]) for record in without)
        lines.append(f"{counted(len(without), 'frame')} without true contact, {false} of them with false points")
    return lines


def _by(method: str) -> str:
    return "" if method == FUSION else f", method {method}"
