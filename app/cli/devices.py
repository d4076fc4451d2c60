"""The command ``tactune devices``: which cameras are connected, and what they can do, in words."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from itertools import groupby
from typing import Annotated, Any

import typer

from ...core.errors import SourceError

#: Exit status where no camera is connected.
NONE_STATUS = 1
#: The driver is asked in a process of its own, since it may hang or crash.
_PROGRAM = ("-P", "-m", "tactune.app.cameras.list_devices")
_PATIENCE_S = 15.0
_NEEDED = (640, 480, 30)


def devices(
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON, every mode of a stream.")] = False,
) -> None:
    """List the connected cameras: model, serial, firmware, USB and what they can stream.

    Exit status 0 where a camera is connected, 1 where none is, 2 where the camera driver is missing or fails.
    """
    found = _ask_driver()
    notes = _notes(found)
    if as_json:
        typer.echo(json.dumps({"devices": found, "notes": notes}, indent=2))
    else:
        typer.echo("\n".join([*(line for device in found for line in _words(device)), *notes]))
    if not found:
        raise typer.Exit(NONE_STATUS)


def _ask_driver() -> list[dict[str, Any]]:
    from ..doctor.checks import run_child

    child = run_child([sys.executable, *_PROGRAM], _PATIENCE_S)
    answer = child.answer()
    if "problem" in answer:
        raise SourceError(str(answer["problem"]))
    if child.problem or "devices" not in answer:
        raise SourceError(
            f"the camera driver does not tell its cameras ({child.problem or 'no answer'}); unplug the cameras and "
            "plug them in again, or run tactune doctor, which says what else may be wrong"
        )
    listed: list[dict[str, Any]] = answer["devices"]
    return listed


def _notes(found: Sequence[dict[str, Any]]) -> list[str]:
    """Say what is missing and why."""
    from ...core.sources.realsense.driver import driver_version, no_l515_sentence
    from ..doctor.cameras import usb_cameras

    notes = []
    plugged = usb_cameras()
    if len(plugged) > len(found):
        names = ", ".join(camera.product for camera in plugged)
        notes.append(f"On USB there are {names}; the driver does not list all of them: run tactune doctor.")
    if not found and not plugged:
        notes.append(
            "No RealSense camera is connected: plug both into USB 3 ports with the cables that came with them; "
            "tactune doctor says what else may be wrong."
        )
    no_l515 = no_l515_sentence(driver_version())
    if no_l515 and not any(device["model"].startswith("L5") for device in found):
        notes.append(f"{no_l515[0].upper()}{no_l515[1:]}.")
    return notes


def _words(device: dict[str, Any]) -> list[str]:
    """Describe one camera."""
    usb = f"USB {device['usb']}" if device.get("usb") else "USB version unknown"
    firmware = f"firmware {device['firmware']}" if device.get("firmware") else "firmware unknown"
    lines = [f"{device['model']}, serial {device['serial'] or 'unknown'}", f"  {firmware}, {usb}"]
    if device.get("problem"):
        lines.append(f"  {device['problem'][0].upper()}{device['problem'][1:]}.")
    modes = sorted({(mode["stream"], mode["width"], mode["height"], mode["rate_hz"]) for mode in device["modes"]})
    for stream, of_stream in groupby(modes, key=lambda mode: mode[0]):
        sizes = [
            f"{width} x {height} at {', '.join(str(mode[3]) for mode in group)} Hz"
            for (width, height), group in groupby(of_stream, key=lambda mode: mode[1:3])
        ]
        lines.append(f"  {stream}: {'; '.join(sizes)}")
    if modes and not any((mode[0], *mode[1:]) == ("depth", *_NEEDED) for mode in modes):
        width, height, rate = _NEEDED
        lines.append(f"  It has no depth of {width} x {height} at {rate} Hz, which Tactune needs.")
    return lines
