"""The command ``tactune track``: the pose of a known object in every frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...core.errors import ExportError, counted
from ...core.model.files import MeshUnit, check_writable
from .common import (
    SOURCE,
    CliProgress,
    FrameCount,
    PresetOption,
    SourceOption,
    TruthOption,
    chosen_preset,
    live_frames,
    number_of_frames,
    open_pipeline,
    say,
    stop_on_signals,
    tell_of_stop,
    warn,
)
from .run import MCAP_SUFFIX

if TYPE_CHECKING:
    from ...core.contact.pipeline import ContactPatch
    from ...core.estimation.object_mesh import ObjectMesh
    from ...core.estimation.pose import PoseError, PoseEstimate
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
        typer.Option("--out", "-o", metavar="FILE", help="A .csv, or a .mcap for patches and poses together."),
    ] = None,
    preset: PresetOption = None,
    frames: FrameCount = None,
    truth: TruthOption = False,
) -> None:
    """Track the pose of a known object by its contact patches.

    The object is searched for in the first patch that is large enough.
    """
    from ...core.estimation.pose import PoseTracker, pose_error, pose_record

    if out is None and not truth:
        raise typer.BadParameter("--out FILE is missing, for the poses, or --truth for a comparison")
    if out is not None and out.suffix.lower() not in SUFFIXES:
        raise ExportError(f"{out} has the suffix {out.suffix!r}; choose one of {', '.join(SUFFIXES)}")
    check_writable(out)
    chosen, origin = chosen_preset(preset, source)
    errors: list[PoseError] = []
    done = known = 0
    with open_pipeline(source, chosen, origin) as (opened, pipeline):
        shape = _mesh(mesh, unit, opened)
        tracker, total = PoseTracker(shape, chosen, opened.rig), number_of_frames(opened, frames)
        with stop_on_signals() as stopped, _output(out, opened, chosen) as save, CliProgress() as progress:

            def searching(share: float) -> None:
                progress.preparing(share, f"Searching for {shape.name}")
                if stopped.is_set():
                    raise CancelledError

            for frame in live_frames(opened, total, stopped):
                patch = pipeline.process(frame)
                if tracker.is_enough(patch) and not tracker.started:
                    with suppress(CancelledError):
                        tracker.find(patch, searching)  # refuses a wrong mesh
                    if stopped.is_set():
                        break
                pose = tracker.track(patch, frame.proximity_time_s)
                true = frame.truth.T_proximity_object if truth and frame.truth is not None else None
                error = None if true is None or pose.lost else pose_error(pose, true, shape)
                save(patch, pose, pose_record(pose, error))
                if error is not None:
                    errors.append(error)
                done, known = done + 1, known + (not pose.lost)
                progress.frames(done, total)
        if truth and not errors:
            warn(f"{opened.name} knows no true pose, or the object was lost in every frame; the errors are empty")
        if done:
            say(f"{counted(done, 'frame')} of {opened.name}, object {shape.name}: pose known in {known}")
            if errors:
                rms_mm = 1e3 * math.sqrt(fmean(error.position_m**2 for error in errors))
                rms_deg = math.degrees(math.sqrt(fmean(error.angle_rad**2 for error in errors)))
                say(f"error in determined directions: {rms_mm:.2f} mm and {rms_deg:.2f} degrees RMS")
            if out is not None:
                say(f"wrote {out}")
        if stopped.is_set():
            tell_of_stop(opened, done, frames)


def _mesh(path: Path | None, unit: str | None, source: FrameSource) -> ObjectMesh:
    from ...core.estimation.object_mesh import simulated_mesh
    from ...core.sources.simulator.simulator_source import SimulatorSource

    if path is not None:
        return read_mesh(path, unit)
    if not isinstance(source, SimulatorSource):
        raise typer.BadParameter("give --mesh FILE; only the simulator knows its own object")
    return simulated_mesh(source.scene, source.name)


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
        from ...core.output.writer import PatchWriter

        with PatchWriter(out, source.rig, preset, source.frame_rate_hz, poses=True) as writer:

            def write(patch: ContactPatch, pose: PoseEstimate, _: Record) -> None:
                known = None if pose.lost else (pose.T_proximity_object, pose.covariance)
                writer.write(patch, pose.time_s, known)

            yield write
    else:
        from ...core.estimation.pose import open_poses

        with open_poses(out) as write_row:
            yield lambda patch, pose, record: write_row(record)
