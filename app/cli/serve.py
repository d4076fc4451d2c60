"""The command ``tactune serve``: contact patches live, for Foxglove and ROS 2."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import typer

from ...core.errors import PresetError
from .common import (
    SOURCE,
    WAIT_S,
    CliProgress,
    FrameCount,
    PresetOption,
    SourceOption,
    counted,
    default_preset,
    open_with_progress,
    stop_on_signals,
    warn,
    warn_of_lost_frames,
    warn_of_wrong_unit,
)
from .run import EstimateOption, make_tilt
from .track import UnitOption, read_mesh

if TYPE_CHECKING:
    from collections.abc import Callable

    from ...core.contact.pipeline import ContactPatch
    from ...core.estimation.pose import PoseEstimate, PoseTracker
    from ...core.model.frames import Rig, SensorFrame
    from ...core.output.connections import Connections
    from ...core.output.parameters import PresetParameters
    from ...core.output.publisher import Estimates, Publisher
    from ...core.preset import Preset
    from ...core.sources import FrameSource
    from .run import Estimate

_LAYOUT_HELP = "Write the layout for the Foxglove app (Import from file) and end, unless --foxglove or --ros2 is given."
#: Longest that a frame waits for its pose, seconds; tracking takes a few hundredths.
_POSE_S = 0.1
_SETTABLE_HELP = "Let clients of --foxglove set preset parameters; any program or web page on this computer then can."
_RCLPY_HELP = "Publish by the ROS 2 that is sourced in this shell, whose middleware and settings choose the network."


@dataclass(frozen=True)
class ServeOptions:
    """Options of ``tactune serve``; see its help."""

    source: str
    preset: str
    frames: int | None
    connections: Connections
    estimate: Estimate | None = None
    mesh: Path | None = None
    unit: str | None = None


def serve(
    *,
    source: SourceOption = SOURCE,
    preset: PresetOption = None,
    frames: FrameCount = None,
    foxglove: Annotated[bool, typer.Option("--foxglove", help="Listen for the Foxglove app and its clients.")] = False,
    ros2: Annotated[bool, typer.Option("--ros2", help="Publish ROS 2 topics by DDS; needs no ROS.")] = False,
    rclpy: Annotated[bool, typer.Option("--rclpy", help=_RCLPY_HELP)] = False,
    host: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="The address to listen on; 0.0.0.0 lets other computers in, without a password."
        ),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, metavar="PORT", help="Port of --foxglove; 0: any.")] = 8765,
    domain: Annotated[
        int, typer.Option(min=0, max=232, metavar="N", envvar="ROS_DOMAIN_ID", help="ROS 2 domain id.")
    ] = 0,
    namespace: Annotated[str, typer.Option(metavar="NAME", help="ROS 2 namespace of the topics.")] = "tactune",
    settable: Annotated[bool, typer.Option("--settable", help=_SETTABLE_HELP)] = False,
    estimate: EstimateOption = None,
    mesh: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Track this object (.obj, .ply, .stl) and publish its pose.")
    ] = None,
    unit: UnitOption = None,
    layout: Annotated[Path | None, typer.Option("--layout", metavar="FILE", help=_LAYOUT_HELP)] = None,
) -> None:
    """Publish contact patches live for Foxglove and ROS 2; a recording is repeated at its own rate."""
    if layout is not None:
        _write_layout(layout)
        if not (foxglove or ros2 or rclpy):
            return
    from ...core.output.connections import Connections

    if not (foxglove or ros2 or rclpy):
        raise typer.BadParameter("give --foxglove or --ros2; nothing is published unless it is asked for")
    preset = preset or default_preset(source)
    connections = Connections(foxglove, ros2, host, port, domain, namespace, rclpy, settable)
    serve_frames(ServeOptions(source, preset, frames, connections, estimate, mesh, unit))


def serve_frames(options: ServeOptions) -> None:
    """Publish frames until Ctrl+C or SIGTERM, or until the number of frames is reached."""
    from ...core.contact.pipeline import ContactPipeline
    from ...core.contact.warmup import warm_up_if_needed
    from ...core.output.parameters import PresetParameters
    from ...core.output.publisher import Publisher
    from ...core.preset.checks import check_rig
    from ...core.sources.capture.live import LiveLoop
    from ...core.sources.presets import load_preset

    preset, connections = load_preset(options.preset), options.connections
    parameters = PresetParameters(preset, check=_refuse_while_opening, settable=connections.settable)
    with (
        Publisher(connections.make_sinks(parameters)) as publisher,  # a taken port is told before cameras start
        open_with_progress(options.source, preset.cameras) as opened,
    ):
        source = opened if opened.length is None else LiveLoop(opened)
        estimated = _estimator(options, preset, source.rig)
        with CliProgress() as progress:
            warm_up_if_needed(progress.preparing, preset)
        for sentence in check_rig(preset, source.rig):
            warn(sentence)
        parameters.check = lambda changed: ContactPipeline(changed, source.rig)
        with stop_on_signals() as stopped:
            for output in publisher.status():
                typer.echo(f"{output.sink.name}: {output.sink.place}")
            if connections.warning:
                warn(connections.warning)
            count = _publish(source, parameters, publisher, estimated, options.frames, stopped)
        typer.echo(f"published {counted(count, 'frame')} of {source.name}")
        warn_of_lost_frames(source, 0)


def _refuse_while_opening(_: Preset) -> None:
    raise PresetError("the source is still being opened; set the value again once frames come")


def _publish(
    source: FrameSource,
    parameters: PresetParameters,
    publisher: Publisher,
    estimated: Callable[[ContactPatch, SensorFrame], Estimates],
    frames: int | None,
    stopped: Event,
) -> int:
    """Process and publish frames; return their number."""
    from ...core.contact.pipeline import ContactPipeline

    pipeline = ContactPipeline(parameters.preset, source.rig)
    count = 0
    while count != frames and not stopped.is_set():
        if not source.wait(WAIT_S):
            continue
        frame = source.next_frame()
        if frame is None:
            break
        if not count:
            warn_of_wrong_unit(frame, source.rig)
        preset = parameters.preset
        if preset is not pipeline.preset:
            pipeline.update(preset)
        patch = pipeline.process(frame)
        publisher.put(frame, patch, preset, estimated(patch, frame))
        count += 1
    return count


def _estimator(options: ServeOptions, preset: Preset, rig: Rig) -> Callable[[ContactPatch, SensorFrame], Estimates]:
    """Return the function that makes the estimates asked for from each patch, in the order of the frames."""
    from ...core.model.patch import Lazy
    from ...core.output.publisher import Estimates

    tilt, poses = make_tilt(options.estimate, preset, rig), None
    if options.mesh is not None:
        from ...core.estimation.pose import PoseTracker

        poses = _Poses(PoseTracker(read_mesh(options.mesh, options.unit), preset, rig))

    def estimated(patch: ContactPatch, frame: SensorFrame) -> Estimates:
        record = None if tilt is None else Lazy(tilt(patch, frame).record)
        pose = None if poses is None else poses.of(patch, frame.proximity_time_s)
        if pose is None or pose.lost:
            return Estimates(record)
        return Estimates(record, pose.T_proximity_object, pose.covariance)

    return estimated


class _Poses:
    """Tracks an object on a thread of its own: while a search takes seconds, frames go on without a pose."""

    def __init__(self, tracker: PoseTracker) -> None:
        self._tracker = tracker
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="track")
        self._running: Future[PoseEstimate] | None = None

    def of(self, patch: ContactPatch, time_s: float) -> PoseEstimate | None:
        """Return the pose in a frame; None if the tracker is busy, or takes longer than `_POSE_S`."""
        if self._running is not None and not self._running.done():
            return None
        if self._running is not None:
            self._running.result()  # raises what a search has raised meanwhile
        self._running = self._thread.submit(self._tracker.track, patch, time_s)
        try:
            return self._running.result(_POSE_S)
        except TimeoutError:
            return None


def _write_layout(path: Path) -> None:
    from ...core.model.files import atomic_path
    from ...core.output.foxglove import layout_text

    with atomic_path(path) as temporary:
        temporary.write_text(layout_text(), encoding="utf-8")
    typer.echo(f"wrote {path}; in Foxglove: Layouts, Import from file")
