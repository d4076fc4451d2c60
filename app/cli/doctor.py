"""The commands ``tactune devices``, ``doctor`` and ``warmup``: the cameras, and whether this computer is ready."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from ...core.errors import TactuneError, as_sentence, counted
from ..sources.list_devices import ask_driver
from .common import CliProgress, say, warn

if TYPE_CHECKING:
    from ...core.sources.ros.topics import ImageTopic

#: Exit status of ``devices`` if no camera is connected.
NONE_STATUS = 1
#: Exit status of ``doctor`` if a check fails.
FAILED_STATUS = 1


def devices() -> None:
    """List the connected cameras: model, serial number, firmware and USB version; and live ROS 2 topics of depth.

    Exit status 0 if a camera is connected, 1 if none is, 2 if the camera driver is missing or fails.
    """
    topics = _ros2_topics()
    for topic in topics:
        typer.echo(f"{topic.name}, {topic.width} x {topic.height}, {topic.encoding}: a camera of ros2:")
    answer = ask_driver()
    for device in answer["devices"]:
        about = [("serial", "serial"), ("firmware", "firmware"), ("USB", "usb")]
        say(", ".join([device["model"], *(f"{word} {device.get(key) or 'unknown'}" for word, key in about)]))
        if device.get("problem"):
            say(f"  {as_sentence(device['problem'])}")
    for note in filter(None, [answer.get("hint"), *answer.get("problems", [])]):
        say(as_sentence(note))
    if not answer["devices"] and not topics:
        say("No camera is connected: plug both into USB 3 ports; tactune doctor finds other causes.")
        raise typer.Exit(NONE_STATUS)


def _ros2_topics() -> list[ImageTopic]:
    """Return the live depth topics; none without the extra ``live``."""
    try:
        from ...core.sources.ros.live import cameras_here

        return cameras_here()
    except TactuneError:
        return []


def doctor() -> None:
    """Check packages, memory, camera driver, USB, permissions and Qt, and name a remedy for each problem.

    Exit status 0 if no check fails (warnings concern only some uses), 1 if one does.
    """
    from .computer import State, check_computer, report

    lines = check_computer()
    say(report(lines))
    if any(line.state is State.FAIL for line in lines):
        raise typer.Exit(FAILED_STATUS)


def warmup() -> None:
    """Compile the pipeline for this computer, so that a robot's first frame need not wait."""
    from ...core.warmup import warm_up

    with CliProgress() as progress:
        result = warm_up(progress.preparing)
    say(f"compiled {counted(result.compiled, 'kernel')}, loaded {result.loaded}")
    if not result.folders:
        warn("no cache folder is writable, so every start compiles again; set NUMBA_CACHE_DIR to a writable folder")
