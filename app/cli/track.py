"""The command ``tactune track``: the pose of a known object in every frame."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from pathlib import Path
from statistics import fmean, median
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...core.errors import ExportError, SourceError, counted
from ...core.model.units import MeshUnit
from .common import (
    SOURCE,
    CliProgress,
    FrameCount,
    PresetOption,
    SourceOption,
    default_preset,
    live_frames,
    number_of_frames,
    open_pipeline,
    stop_on_signals,
    tell_of_stop,
    warn,
)
from .run import MCAP_SUFFIX

if TYPE_CHECKING:
    from threading import Event

    from ...core.contact.pipeline import ContactPatch, ContactPipeline
    from ...core.estimation.object_mesh import ObjectMesh
    from ...core.estimation.pose import PoseEstimate, PoseTracker
    from ...core.preset import Preset
    from ...core.sources import FrameSource

SUFFIXES = (".csv", MCAP_SUFFIX)

Record = dict[str, Any]
Save = Callable[["ContactPatch", "PoseEstimate", Record], object]

UnitOption = Annotated[MeshUnit | None, typer.Option(help="Unit of the mesh; default: m or mm, told by its size.")]


def track(
    *,
    source: SourceOption = SOURCE,
    mesh: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The object: .obj, .ply or .stl; default for sim: its own object."),
    ] = None,
    unit: UnitOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="A .csv, or a .mcap for patches and poses together.",
        ),
    ] = None,
    preset: PresetOption = None,
    frames: FrameCount = None,
    truth: Annotated[
        bool, typer.Option("--truth", help="Compare with the true pose, which the simulator knows.")
    ] = False,
) -> None:
    """Track the pose of a known object by its contact patches.

    The object is searched for in the first patch that is large enough.
    """
    from ...core.estimation.pose import PoseTracker
    from ...core.sources.presets import load_preset

    if out is None and not truth:
        raise typer.BadParameter("give --out FILE for the poses, or --truth for a comparison")
    if out is not None and out.suffix.lower() not in SUFFIXES:
        raise ExportError(f"{out} has the suffix {out.suffix!r}; choose one of {', '.join(SUFFIXES)}")
    chosen = load_preset(preset or default_preset(source))
    with open_pipeline(source, chosen) as (opened, pipeline):
        tracker = PoseTracker(_mesh(mesh, unit, opened), chosen, opened.rig)
        with stop_on_signals() as stopped, _output(out, opened, chosen) as save:
            done, text = _track(opened, pipeline, tracker, frames, save, stopped, truth)
        if done:
            typer.echo(text)
            if out is not None:
                typer.echo(f"wrote {out}")
        if stopped.is_set():
            tell_of_stop(opened, done, frames)


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


@contextmanager
def _output(out: Path | None, source: FrameSource, preset: Preset) -> Iterator[Save]:
    """Yield a function that takes each patch, pose and record; the file is whole when this ends, also by an error."""
    if out is None:
        yield lambda patch, pose, record: None
    elif out.suffix.lower() == MCAP_SUFFIX:
        from ...core.output.bag import PatchWriter

        with PatchWriter(out, source.rig, preset, source.frame_rate_hz, poses=True) as writer:

            def write(patch: ContactPatch, pose: PoseEstimate, _: Record) -> None:
                known = None if pose.lost else (pose.T_proximity_object, pose.covariance)
                writer.write(patch.points, pose.sequence, pose.time_s, known)

            yield write
    else:
        from ...core.estimation.pose_files import open_poses

        with open_poses(out) as write_row:
            yield lambda patch, pose, record: write_row(record)


def _track(
    source: FrameSource,
    pipeline: ContactPipeline,
    tracker: PoseTracker,
    frames: int | None,
    save: Save,
    stopped: Event,
    truth: bool,
) -> tuple[int, str]:
    """Track the object in all frames, and return their number and what was found as text."""
    from ...core.estimation.pose import pose_error
    from ...core.estimation.pose_files import pose_record

    name, total = tracker.mesh.name, number_of_frames(source, frames)
    count: Counter[str] = Counter()
    times_ms, position_mm, angle_deg = [], [], []
    with CliProgress() as progress:

        def searching(share: float) -> None:
            progress.preparing(share, f"Searching for {name}")
            if stopped.is_set():
                raise CancelledError

        for frame in live_frames(source, total, stopped):
            patch = pipeline.process(frame)
            begun = time.perf_counter()
            if tracker.is_enough(patch) and not tracker.started:
                with suppress(CancelledError):
                    tracker.find(patch, searching)  # refuses a wrong mesh
                if stopped.is_set():
                    break
            pose = tracker.track(patch, frame.proximity_time_s)
            ms = 1e3 * (time.perf_counter() - begun)
            true = frame.truth.T_proximity_object if truth and frame.truth is not None else None
            error = None if true is None or pose.lost else pose_error(pose, true, tracker.mesh)
            save(patch, pose, pose_record(pose, error) | {"ms": round(ms, 2)})
            count.update(frames=1, known=not pose.lost)
            if not pose.lost:
                times_ms.append(ms)
            if error is not None:
                position_mm.append(1e3 * error.position_m)
                angle_deg.append(math.degrees(error.angle_rad))
            progress.frames(count["frames"], total)
    if not count["frames"] and not stopped.is_set():
        raise SourceError(f"{source.name} gave no frames; check the source")
    if truth and not position_mm:
        warn(f"{source.name} knows no true pose, or the object was lost in every frame; the errors are empty")
    lines = [f"{counted(count['frames'], 'frame')} of {source.name}, object {name}: pose known in {count['known']}"]
    if times_ms:
        lines.append(f"{median(times_ms):.1f} ms per frame, patch not included")
    if position_mm:
        rms_mm, rms_deg = (math.sqrt(fmean(each**2 for each in errors)) for errors in (position_mm, angle_deg))
        over = counted(len(position_mm), "frame")
        lines.append(f"error in determined directions: {rms_mm:.2f} mm and {rms_deg:.2f} degrees RMS over {over}")
    return count["frames"], "\n".join(lines)
