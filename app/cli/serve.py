"""The command ``tactune serve``: contact patches live, for Foxglove and ROS 2."""

from __future__ import annotations

from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import typer

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
)

if TYPE_CHECKING:
    from ...core.output.connections import Connections
    from ...core.output.parameters import PresetParameters
    from ...core.output.publisher import Publisher
    from ...core.sources import FrameSource

_LAYOUT_HELP = "Write the layout for the Foxglove app (Import from file) and end, unless --foxglove or --ros2 is given."


def serve(
    *,
    source: SourceOption = SOURCE,
    preset: PresetOption = None,
    frames: FrameCount = None,
    foxglove: Annotated[bool, typer.Option("--foxglove", help="Listen for the Foxglove app and its clients.")] = False,
    ros2: Annotated[bool, typer.Option("--ros2", help="Publish ROS 2 topics by DDS; needs no ROS.")] = False,
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
    layout: Annotated[Path | None, typer.Option("--layout", metavar="FILE", help=_LAYOUT_HELP)] = None,
) -> None:
    """Publish contact patches live for Foxglove and ROS 2; a recording is repeated at its own rate."""
    if layout is not None:
        _write_layout(layout)
        if not foxglove and not ros2:
            return
    from ...core.output.connections import Connections

    if not foxglove and not ros2:
        raise typer.BadParameter("give --foxglove or --ros2; nothing is published unless it is asked for")
    preset = preset or default_preset(source)
    serve_frames(source, preset, frames, Connections(foxglove, ros2, host, port, domain, namespace))


def serve_frames(name: str, preset_name: str, frames: int | None, connections: Connections) -> None:
    """Publish frames until Ctrl+C or SIGTERM, or until the number of frames is reached."""
    from ...core.contact.pipeline import ContactPipeline
    from ...core.contact.warmup import warm_up_if_needed
    from ...core.output.parameters import PresetParameters
    from ...core.output.publisher import Publisher
    from ...core.preset.checks import check_rig
    from ...core.sources.capture.live import LiveLoop
    from ...core.sources.presets import load_preset

    preset = load_preset(preset_name)
    with open_with_progress(name, preset.cameras) as opened:
        source = opened if opened.length is None else LiveLoop(opened)
        with CliProgress() as progress:
            warm_up_if_needed(progress.preparing, preset)
        for sentence in check_rig(preset, source.rig):
            warn(sentence)
        parameters = PresetParameters(preset, check=lambda changed: ContactPipeline(changed, source.rig))
        with stop_on_signals() as stopped, Publisher(connections.make_sinks(parameters)) as publisher:
            for output in publisher.status():
                typer.echo(f"{output.sink.name}: {output.sink.place}")
            count = _publish(source, parameters, publisher, frames, stopped)
        typer.echo(f"published {counted(count, 'frame')} of {source.name}")
        warn_of_lost_frames(source, 0)


def _publish(
    source: FrameSource, parameters: PresetParameters, publisher: Publisher, frames: int | None, stopped: Event
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
        preset = parameters.preset
        if preset is not pipeline.preset:
            pipeline.update(preset)
        publisher.put(frame, pipeline.process(frame), preset)
        count += 1
    return count


def _write_layout(path: Path) -> None:
    from ...core.model.files import atomic_path
    from ...core.output.foxglove import layout_text

    with atomic_path(path) as temporary:
        temporary.write_text(layout_text(), encoding="utf-8")
    typer.echo(f"wrote {path}; in Foxglove: Layouts, Import from file")
