"""The commands ``tactune devices``, ``doctor`` and ``warmup``: the cameras, and whether this computer is ready."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import typer

from ...core.errors import as_sentence, counted
from ..doctor.checks import State
from ..sources.list_devices import ask_driver
from .common import CliProgress, warn

#: Exit status of ``devices`` if no camera is connected.
NONE_STATUS = 1
#: Exit status of ``doctor`` if a check fails.
FAILED_STATUS = 1


def devices() -> None:
    """List the connected cameras: model, serial number, firmware and USB version.

    Exit status 0 if a camera is connected, 1 if none is, 2 if the camera driver is missing or fails.
    """
    answer = ask_driver()
    found: list[dict[str, Any]] = answer["devices"]
    notes = [*_notes(found), *map(as_sentence, answer.get("problems", []))]
    typer.echo("\n".join([*(line for device in found for line in _words(device)), *notes]))
    if not found:
        raise typer.Exit(NONE_STATUS)


def _notes(found: Sequence[dict[str, Any]]) -> list[str]:
    """Return sentences on missing cameras and their causes."""
    from ...core.sources.cameras.realsense import driver_version, no_l515_sentence
    from ..doctor.computer import usb_cameras

    notes = []
    plugged = usb_cameras()
    if len(plugged) > len(found):
        names = ", ".join(camera.product for camera in plugged)
        notes.append(f"On USB there are {names}; the driver does not list all of them: run tactune doctor.")
    if not found and not plugged:
        notes.append(
            "No RealSense camera is connected: plug both into USB 3 ports with the cables that came with them; "
            "tactune doctor finds other causes."
        )
    no_l515 = no_l515_sentence(driver_version())
    if no_l515 and not any(device["model"].startswith("L5") for device in found):
        notes.append(as_sentence(no_l515))
    return notes


def _words(device: dict[str, Any]) -> list[str]:
    """Describe one camera."""
    usb = f"USB {device['usb']}" if device.get("usb") else "USB version unknown"
    firmware = f"firmware {device['firmware']}" if device.get("firmware") else "firmware unknown"
    lines = [f"{device['model']}, serial {device['serial'] or 'unknown'}", f"  {firmware}, {usb}"]
    if device.get("problem"):
        lines.append(f"  {as_sentence(device['problem'])}")
    return lines


def doctor() -> None:
    """Check Python, packages, camera driver, USB, permissions, Qt and display, and name a remedy for each problem.

    Exit status 0 if no check fails (warnings concern only some uses), 1 if one does.
    """
    from ..doctor.computer import check_computer, report

    lines = check_computer()
    typer.echo(report(lines))
    if any(line.state is State.FAIL for line in lines):
        raise typer.Exit(FAILED_STATUS)


def warmup() -> None:
    """Compile the pipeline for this computer, so that a robot's first frame need not wait."""
    from ...core.warmup import warm_up

    with CliProgress() as progress:
        result = warm_up(progress.preparing)
    typer.echo(f"compiled {counted(result.compiled, 'kernel')}, loaded {result.loaded}")
    if not result.folders:
        warn("no cache folder is writable, so every start compiles again; set NUMBA_CACHE_DIR to a writable folder")
