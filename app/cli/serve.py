"""The command ``tactune serve``: contact patches live, for Foxglove and ROS 2."""

from __future__ import annotations

from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import typer

from ...core.errors import counted
from ...core.output.connections import MAX_CLIENTS
from .common import (
    SOURCE,
    FrameCount,
    PresetOption,
    SourceOption,
    TopicsOption,
    chosen_preset,
    live_frames,
    open_with_progress,
    say,
    stop_on_signals,
    untouched_for,
    warn,
    with_topics,
)
from .run import EstimateOption, make_tilt
from .track import UnitOption, read_mesh

if TYPE_CHECKING:
    from ...core.contact.pipeline import ContactPatch
    from ...core.estimation.pose import PoseTracker
    from ...core.output.publisher import Publisher

_LAYOUT_HELP = "Write the layout for the Foxglove app (Import from file) and end, unless --foxglove or --ros2 is given."


def serve(
    *,
    source: SourceOption = SOURCE,
    topics: TopicsOption = None,
    preset: PresetOption = None,
    frames: FrameCount = None,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Listen for the Foxglove app and its clients; default without --ros2.")
    ] = False,
    ros2: Annotated[bool, typer.Option("--ros2", help="Publish ROS 2 topics by DDS; needs no ROS.")] = False,
    host: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="The address to listen on; 0.0.0.0 lets other computers in, without a password."
        ),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, metavar="PORT", help="Port of --foxglove; 0: any.")] = 8765,
    clients: Annotated[
        int, typer.Option(min=1, metavar="N", help="Most clients of --foxglove at a time.")
    ] = MAX_CLIENTS,
    origins: Annotated[
        list[str] | None,
        typer.Option(
            "--origin",
            metavar="URL",
            help="A web page that --foxglove lets in, as https://app.foxglove.dev; others not.",
        ),
    ] = None,
    domain: Annotated[
        int, typer.Option(min=0, max=232, metavar="N", envvar="ROS_DOMAIN_ID", help="ROS 2 domain id.")
    ] = 0,
    namespace: Annotated[str, typer.Option(metavar="NAME", help="ROS 2 namespace of the topics.")] = "tactune",
    estimate: EstimateOption = None,
    mesh: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Track this object (.obj, .ply, .stl) and publish its pose.")
    ] = None,
    unit: UnitOption = None,
    layout: Annotated[Path | None, typer.Option(metavar="FILE", help=_LAYOUT_HELP)] = None,
) -> None:
    """Publish contact patches live for Foxglove and ROS 2.

    Ctrl+C ends it; a recording is repeated at its own rate.
    """
    from ...core.output.connections import Connections
    from ...core.output.publisher import Publisher

    if unit is not None and mesh is None:
        raise typer.BadParameter("--unit is the unit of --mesh; add it")
    if layout is not None:
        from ...core.output.foxglove import save_layout

        save_layout(layout)
        say(f"wrote {layout}; in Foxglove: Layouts, Import from file")
        if not (foxglove or ros2):
            return
    foxglove |= not ros2
    source = with_topics(source, topics)
    chosen, origin = chosen_preset(preset, source)
    shape = None if mesh is None else read_mesh(mesh, unit)
    connections = Connections(foxglove, ros2, host, port, domain, namespace, clients, tuple(origins or ()))
    with (
        Publisher(connections.make_sinks()) as publisher,  # a taken port is told before cameras start
        open_with_progress(source, chosen, compiles=True) as opened,
    ):
        from ...core.contact.pipeline import ContactPipeline  # after a wrong source was told
        from ...core.model.patch import Lazy
        from ...core.sources.play_as_live import PlayAsLive

        playing = opened if opened.length is None else PlayAsLive(opened)
        tilt, poses, count = make_tilt(estimate, chosen, playing.rig), None, 0
        if shape is not None:
            from ...core.estimation.pose import PoseTracker

            poses = _Poses(PoseTracker(shape, chosen, playing.rig), publisher)
        with stop_on_signals() as stopped:
            for output in publisher.status():
                say(f"{output.sink.name}: {output.sink.place}")
            if connections.warning:
                warn(connections.warning)
            pipeline = ContactPipeline(chosen, playing.rig, untouched_for(chosen, origin, opened))
            try:
                for frame in live_frames(playing, frames, stopped):
                    patch = pipeline.process(frame)
                    record = None if tilt is None else Lazy(tilt(patch).record)
                    publisher.put(frame, patch, chosen, record)
                    if poses is not None:
                        poses.put(patch, frame.proximity_time_s)
                    count += 1
            finally:
                if poses is not None:
                    poses.close()
        say(f"published {counted(count, 'frame')} of {playing.name}")


class _Poses:
    """Tracks an object and publishes its pose, on a thread of its own: no frame waits while a search takes seconds."""

    def __init__(self, tracker: PoseTracker, publisher: Publisher) -> None:
        self._tracker, self._publisher = tracker, publisher
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="track")
        self._newest: Future[None] | None = None
        self._closed = Event()

    def close(self) -> None:
        """End a search that runs, and the thread."""
        self._thread.shutdown(wait=False, cancel_futures=True)  # first: the waiting search must not begin
        self._closed.set()
        self._thread.shutdown()

    def _go_on(self, _: float) -> None:
        if self._closed.is_set():
            raise CancelledError

    def put(self, patch: ContactPatch, time_s: float) -> None:
        """Track in this patch, in place of one that still waits."""
        if self._newest is not None and not self._newest.cancel() and self._newest.done():
            self._newest.result()  # raises what tracking has raised meanwhile
        self._newest = self._thread.submit(self._track, patch, time_s)

    def _track(self, patch: ContactPatch, time_s: float) -> None:
        pose = self._tracker.track(patch, time_s, self._go_on)
        if not pose.lost:
            self._publisher.put_pose(pose.T_proximity_object, pose.covariance, time_s)
