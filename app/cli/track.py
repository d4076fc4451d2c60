"""The command ``tactune track``: the pose of a known object in every frame."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...core.errors import ExportError, SourceError, counted
from ...core.model.units import UNITS_M, MeshUnit
from .common import (
    SOURCE,
    CliProgress,
    FrameCount,
    PresetOption,
    SourceOption,
    default_preset,
    live_frames,
    number_of_frames,
    open_with_progress,
    stop_on_signals,
    warn,
    warn_of_lost_frames,
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
            metavar="FILE",
            help="Pose in the first frame: four lines of four numbers, or JSON as `evaluate recording` has it.",
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
    from ...core.estimation.pose import PoseTracker
    from ...core.sources.presets import load_preset
    from ...core.warmup import warm_up_if_needed

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
            summary = _track(opened, pipeline, tracker, frames, save, stopped, truth=truth)
            if not summary.frames and stopped.is_set():
                tell_of_stop(opened, 0, frames)
            if not summary.frames:
                raise SourceError(f"{opened.name} gave no frames; check the source")
        warn_of_lost_frames(opened, lost_before)
        typer.echo(summary.text(opened.name, found))
        if out is not None:
            typer.echo(f"wrote {out}")
        if stopped.is_set():
            tell_of_stop(opened, summary.frames, frames)


def _mesh(path: Path | None, unit: str | None, source: FrameSource) -> ObjectMesh:
    from ...core.estimation.object_mesh import simulated_mesh
    from ...core.sources.simulator.source import SimulatorSource

    if path is None:
        if not isinstance(source, SimulatorSource):
            raise typer.BadParameter("give --mesh FILE; only the simulator knows its own object")
        return simulated_mesh(source.scene, source.name)
    return read_mesh(path, unit)


def read_mesh(path: Path, unit: str | None) -> ObjectMesh:
    """Read the mesh of an object, and say which unit was assumed where none is given."""
    from ...core.estimation.object_mesh import load_mesh

    mesh = load_mesh(path, unit)
    if unit is None:
        warn(f"{mesh.assumed}; say --unit if that is wrong")
    return mesh


def _start(tracker: PoseTracker, start: Path | None, pairs: Path | None, mesh: ObjectMesh) -> None:
    from ...core.estimation.start_pose import load_transform, pose_from_pairs, read_pairs

    if start is not None:
        tracker.start(load_transform(start))
    if pairs is not None:
        tracker.start(pose_from_pairs(*read_pairs(pairs, UNITS_M[mesh.unit])))


@contextmanager
def _output(out: Path | None, source: FrameSource, preset: Preset) -> Iterator[Any]:
    """Yield a function that takes each patch, pose and record; the file is whole when this ends, also by an error."""
    if out is None:
        yield lambda patch, pose, record: None
    elif out.suffix.lower() == MCAP_SUFFIX:
        from ...core.output.bag import PatchWriter

        with PatchWriter(out, source.rig, preset, source.frame_rate_hz, poses=True) as writer:

            def write(patch: ContactPatch, pose: PoseEstimate, record: Record) -> None:
                known = None if pose.lost else (pose.T_proximity_object, pose.covariance)
                writer.write(patch.points, pose.sequence, pose.time_s, known)

            yield write
    else:
        from ...core.estimation.pose_files import open_poses

        with open_poses(out) as write_row:
            yield lambda patch, pose, record: write_row(record)


def _track(
    source: FrameSource,
    pipeline: Any,
    tracker: PoseTracker,
    frames: int | None,
    save: Any,
    stopped: Event,
    *,
    truth: bool,
) -> _Summary:
    from ...core.estimation.pose import pose_error
    from ...core.estimation.pose_files import error_record, pose_record

    summary = _Summary()
    enough = lost = 0
    total = number_of_frames(source, frames)
    with CliProgress() as progress:

        def searching(share: float) -> None:
            progress.preparing(share, f"Searching for {tracker.mesh.name}")
            if stopped.is_set():
                raise _StoppedError

        for frame in live_frames(source, total, stopped):
            patch = pipeline.process(frame)
            begun = time.perf_counter()
            touches = tracker.is_enough(patch)
            if touches and not tracker.started:
                with suppress(_StoppedError):
                    tracker.find(patch, searching)  # refuses a wrong mesh
                if stopped.is_set():
                    break
            pose = tracker.track(patch, frame.proximity_time_s)
            enough, lost = enough + touches, lost + (touches and pose.lost)
            record = pose_record(pose) | {"ms": round(1e3 * (time.perf_counter() - begun), 2)}
            if truth:
                true = frame.truth.T_proximity_object if frame.truth else None
                record |= error_record(None if true is None or pose.lost else pose_error(pose, true, tracker.mesh))
            save(patch, pose, record)
            summary.add(record)
            progress.frames(summary.frames, total)
    if lost > enough / 2:
        warn(
            f"{tracker.mesh.name} fits the contact in {enough - lost} of {counted(enough, 'frame')} only; check that "
            "it is the mesh of this object, its unit and the pose it starts from"
        )
    if truth and summary.frames and not summary.compared:
        warn(f"{source.name} knows no true pose, or the object was lost in every frame; the errors are empty")
    return summary


class _StoppedError(Exception):
    """Ends a search after Ctrl+C."""


@dataclass
class _Summary:
    """Counts and sums over all frames, and the times of the newest tracked frames."""

    frames: int = 0
    tracked: int = 0
    compared: int = 0
    squared_mm: float = 0.0
    squared_deg: float = 0.0
    free: Counter[str] = field(default_factory=Counter)
    times_ms: deque[float] = field(default_factory=lambda: deque(maxlen=10_000))

    def add(self, record: Record) -> None:
        self.frames += 1
        if record["lost"]:
            return
        self.tracked += 1
        self.free.update(name for name in record["free"].split("; ") if name)
        self.times_ms.append(record["ms"])
        if record.get("position_error_mm", "") != "":
            self.compared += 1
            self.squared_mm += record["position_error_mm"] ** 2
            self.squared_deg += record["angle_error_deg"] ** 2

    def text(self, source: str, mesh: ObjectMesh) -> str:
        from statistics import median

        lines = [f"{counted(self.frames, 'frame')} of {source}, object {mesh.name}: pose known in {self.tracked}"]
        if self.tracked:
            free = sorted(self.free.items())
            lines += [f"not determined: {name}, in {counted(count, 'frame')}" for name, count in free]
            lines.append(f"{median(self.times_ms):.1f} ms per frame, patch not included")
        if self.compared:
            rms_mm, rms_deg = (math.sqrt(sum_ / self.compared) for sum_ in (self.squared_mm, self.squared_deg))
            lines.append(
                f"error in determined directions: {rms_mm:.2f} mm and {rms_deg:.2f} degrees RMS over "
                f"{counted(self.compared, 'frame')}"
            )
        return "\n".join(lines)
