"""The command ``tactune track``: the pose of a known object in every frame."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...core.errors import ExportError, SourceError, TactuneError
from ...core.model.files import check_writable
from .common import (
    SOURCE,
    WAIT_S,
    CliProgress,
    FrameCount,
    PresetOption,
    SourceOption,
    counted,
    default_preset,
    number_of_frames,
    open_with_progress,
    stop_on_signals,
    warn,
    warn_of_lost_frames,
    warn_of_wrong_unit,
)
from .run import MCAP_SUFFIX, tell_of_stop

if TYPE_CHECKING:
    from threading import Event

    from ...core.contact.pipeline import ContactPatch
    from ...core.estimation.object_mesh import ObjectMesh
    from ...core.estimation.pose import PoseEstimate, PoseTracker
    from ...core.preset import Preset
    from ...core.sources import FrameSource

SUFFIXES = (".csv", ".tum", MCAP_SUFFIX)

Record = dict[str, Any]


class MeshUnit(StrEnum):
    """Units of a mesh file."""

    M = "m"
    CM = "cm"
    MM = "mm"
    IN = "in"


UnitOption = Annotated[MeshUnit | None, typer.Option(help="Unit of the mesh; default: m or mm, told by its size.")]


def track(
    *,
    source: SourceOption = SOURCE,
    mesh: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The object: .obj, .ply or .stl; default for sim: its own object."),
    ] = None,
    unit: UnitOption = None,
    start: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Pose in the first frame: four lines of four numbers, or JSON as of export-scan."
        ),
    ] = None,
    pairs: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Or three and more point pairs: scan_x,scan_y,scan_z (the mesh's unit),patch_x_m,patch_y_m,patch_z_m.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help=".csv; .tum (time, position, quaternion, as evo reads it); .mcap for patches and poses together.",
        ),
    ] = None,
    preset: PresetOption = None,
    frames: FrameCount = None,
    truth: Annotated[
        bool, typer.Option("--truth", help="Compare with the true pose, which the simulator knows.")
    ] = False,
) -> None:
    """Track the pose of a known object by its contact patches.

    Without --start or --pairs the object is searched for in the first patch.
    """
    from ...core.contact.pipeline import ContactPipeline
    from ...core.contact.warmup import warm_up_if_needed
    from ...core.estimation.pose import PoseTracker
    from ...core.sources.presets import load_preset

    if out is None and not truth:
        raise typer.BadParameter("give --out FILE for the poses, or --truth for a comparison")
    if out is not None and out.suffix.lower() not in SUFFIXES:
        raise ExportError(f"{out} has the suffix {out.suffix!r}; choose one of {', '.join(SUFFIXES)}")
    if start is not None and pairs is not None:
        raise typer.BadParameter("give --start or --pairs, not both")
    chosen = load_preset(preset or default_preset(source))
    with open_with_progress(source, chosen.cameras) as opened:
        found = _mesh(mesh, unit, opened)
        tracker = PoseTracker(found, chosen, opened.rig)
        _start(tracker, start, pairs, found)
        with CliProgress() as progress:
            warm_up_if_needed(progress.preparing, chosen)
        pipeline, lost_before = ContactPipeline(chosen, opened.rig), opened.health().dropped
        with stop_on_signals() as stopped, _output(out, opened, chosen) as save:
            records = _tracked(opened, pipeline, tracker, frames, save, stopped, truth=truth)
        if not records and not stopped.is_set():
            raise SourceError(f"{opened.name} gave no frames; check the source")
        warn_of_lost_frames(opened, lost_before)
        if records:
            typer.echo(_summary(records, opened.name, found, truth=truth))
            if out is not None:
                typer.echo(f"wrote {out}")
        if stopped.is_set():
            tell_of_stop(opened, len(records), frames)


def _mesh(path: Path | None, unit: str | None, source: FrameSource) -> ObjectMesh:
    from ...core.estimation.object_mesh import simulated_mesh
    from ...core.sources.simulator.source import SimulatorSource

    if path is None:
        if not isinstance(source, SimulatorSource):
            raise typer.BadParameter("give --mesh FILE; only the simulator knows its own object")
        return simulated_mesh(source)
    return read_mesh(path, unit)


def read_mesh(path: Path, unit: str | None) -> ObjectMesh:
    """Read the mesh of an object, and say which unit was assumed where none is given."""
    from ...core.estimation.object_mesh import load_mesh

    mesh = load_mesh(path, unit)
    if unit is None:
        warn(f"{mesh.assumed}; say --unit if that is wrong")
    return mesh


def _start(tracker: PoseTracker, start: Path | None, pairs: Path | None, mesh: ObjectMesh) -> None:
    from ...core.evaluation.scan.pose import load_transform, pose_from_pairs, read_pairs
    from ...core.evaluation.scan.scan import UNITS_M

    if start is not None:
        tracker.start(load_transform(start))
    if pairs is not None:
        tracker.start(pose_from_pairs(*read_pairs(pairs, UNITS_M[mesh.unit])))


@contextmanager
def _output(out: Path | None, source: FrameSource, preset: Preset) -> Iterator[Any]:
    """Yield a function that takes each patch, pose and record; the file is whole when this ends, also by an error."""
    from ...core.estimation.pose_files import save_poses

    if out is not None and out.suffix.lower() == MCAP_SUFFIX:
        from ...core.output.bag import PatchWriter

        with PatchWriter(out, source.rig, preset, source.frame_rate_hz, poses=True) as writer:

            def write(patch: ContactPatch, pose: PoseEstimate, record: Record) -> None:
                known = None if pose.lost else (pose.T_proximity_object, pose.covariance)
                writer.write(patch.points, pose.sequence, pose.time_s, known)

            yield write
        return
    records: list[Record] = []
    if out is not None:
        check_writable(out)
    try:
        yield lambda patch, pose, record: records.append(record)
    except TactuneError:  # such as an unplugged camera: the poses until then are kept
        if out is not None and not all(record["lost"] for record in records):
            save_poses(out, records)
        raise
    if out is not None and records:
        save_poses(out, records)


def _tracked(
    source: FrameSource,
    pipeline: Any,
    tracker: PoseTracker,
    frames: int | None,
    save: Any,
    stopped: Event,
    *,
    truth: bool,
) -> list[Record]:
    from ...core.estimation.pose import pose_error
    from ...core.estimation.pose_files import error_record, pose_record

    records: list[Record] = []
    enough = lost = 0
    total = number_of_frames(source, frames)
    with CliProgress() as progress:
        while len(records) != total and not stopped.is_set():
            if not source.wait(WAIT_S):
                continue
            frame = source.next_frame()
            if frame is None:
                break
            if not records:
                warn_of_wrong_unit(frame, source.rig)
            patch = pipeline.process(frame)
            begun = time.perf_counter()
            touches = tracker.is_enough(patch)
            if touches and not tracker.started:
                tracker.find(patch)  # refuses a wrong mesh
            pose = tracker.track(patch, frame.proximity_time_s)
            enough, lost = enough + touches, lost + (touches and pose.lost)
            record = pose_record(pose) | {"ms": round(1e3 * (time.perf_counter() - begun), 2)}
            if truth:
                true = frame.truth.T_proximity_object if frame.truth else None
                record |= error_record(None if true is None or pose.lost else pose_error(pose, true, tracker.mesh))
            save(patch, pose, record)
            records.append(record)
            progress.frames(len(records), total)
    if lost > enough / 2:
        warn(
            f"{tracker.mesh.name} fits the contact in {enough - lost} of {counted(enough, 'frame')} only; check that "
            "it is the mesh of this object, its unit and the pose it starts from"
        )
    if truth and records and all(record["position_error_mm"] == "" for record in records):
        warn(f"{source.name} knows no true pose, or the object was lost in every frame; the errors are empty")
    return records


def _summary(records: list[Record], source: str, mesh: ObjectMesh, *, truth: bool) -> str:
    from statistics import median

    tracked = [record for record in records if not record["lost"]]
    lines = [f"{counted(len(records), 'frame')} of {source}, object {mesh.name}: pose known in {len(tracked)}"]
    if tracked:
        free: dict[str, int] = {}
        for name in (name for record in tracked for name in record["free"].split("; ") if name):
            free[name] = free.get(name, 0) + 1
        lines += [f"not determined: {name}, in {counted(count, 'frame')}" for name, count in sorted(free.items())]
        lines.append(f"{median(record['ms'] for record in tracked):.1f} ms per frame, patch not included")
    known = [record for record in tracked if truth and record["position_error_mm"] != ""]
    if known:
        rms = {
            key: math.sqrt(sum(record[key] ** 2 for record in known) / len(known))
            for key in ("position_error_mm", "angle_error_deg")
        }
        lines.append(
            f"error in determined directions: {rms['position_error_mm']:.2f} mm and {rms['angle_error_deg']:.2f} "
            f"degrees RMS over {counted(len(known), 'frame')}"
        )
    return "\n".join(lines)
