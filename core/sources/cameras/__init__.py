"""Live cameras of any maker, captured in a separate process.

`camera` is the interface that a maker's driver implements, `realsense` the driver of our own; `pairing` pairs the
images of both cameras by time, `source` runs the cameras and makes frames of the pairs.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

from ...errors import SourceError
from ..base import CameraRole, FrameSource, Progress, SourceKind

if TYPE_CHECKING:
    from ...preset import CamerasSection


_ROLES: Final[tuple[CameraRole, ...]] = ("proximity", "tactile")


def open_in_process(rest: str, progress: Progress | None, cameras: CamerasSection | None) -> FrameSource:
    """Open ``PROXIMITY,TACTILE``, serial numbers, or ``,TACTILE`` alone; else those of the preset, or by model."""
    from ...preset import CamerasSection
    from ..capture.source import ProcessSource
    from .source import open_cameras

    chosen, roles = cameras or CamerasSection(), _ROLES
    if rest:
        serials = [serial.strip() for serial in rest.split(",")]
        if len(serials) != 2 or not serials[1]:
            raise SourceError(
                f"cameras:{rest}: give both serial numbers, as in cameras:f0090001,130322270002, or none, or "
                "cameras:,130322270002 for a tactile camera only"
            )
        roles = _ROLES if serials[0] else _ROLES[1:]
        for role, serial in zip(_ROLES, serials, strict=True):
            chosen = chosen.model_copy(update={role: getattr(chosen, role).model_copy(update={"serial": serial})})
    return ProcessSource(partial(open_cameras, chosen, roles=roles), progress)


KIND = SourceKind(
    scheme="cameras",
    title="Cameras",
    form="cameras:[PROXIMITY,TACTILE]",
    open=open_in_process,
)
#: Another name of it, which older files have.
REALSENSE = replace(KIND, scheme="realsense", form="realsense:[PROXIMITY,TACTILE]")
