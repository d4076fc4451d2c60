"""Live cameras of any maker, captured in a separate process.

`camera` is the interface that a maker's driver implements, `realsense` the driver of our own; `camera_thread` runs one
camera, `pairing` places the images of both on one clock and pairs them, `source` makes frames of the pairs.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from ...errors import SourceError
from ..base import FrameSource, Progress, SourceKind

if TYPE_CHECKING:
    from ...preset import CamerasSection


def open_in_process(
    rest: str, progress: Progress | None, cameras: CamerasSection | None, *, driver: str = ""
) -> FrameSource:
    """Open two cameras by the text after the scheme: ``PROXIMITY,TACTILE``, their serial numbers, or nothing.

    Without serial numbers, those of the preset are used; without these, the cameras are chosen by model. ``driver`` is
    the name of the driver to use; if empty, all drivers are used.
    """
    from ...preset import CamerasSection
    from ..capture import ProcessSource
    from .source import open_cameras

    chosen = cameras or CamerasSection()
    if rest:
        scheme = driver or "cameras"
        serials = [serial.strip() for serial in rest.split(",")]
        if len(serials) != 2 or not all(serials):
            raise SourceError(
                f"{scheme}:{rest}: give both serial numbers, as in {scheme}:f0090001,130322270002, or none"
            )
        for role, serial in zip(("proximity", "tactile"), serials, strict=True):
            chosen = chosen.model_copy(update={role: getattr(chosen, role).model_copy(update={"serial": serial})})
    return ProcessSource(partial(open_cameras, driver, chosen), progress)


KIND = SourceKind(
    scheme="cameras",
    title="Cameras",
    form="cameras:[PROXIMITY,TACTILE]",
    description="Two live cameras of any installed drivers; serial numbers select the devices.",
    examples=("cameras:",),
    open=open_in_process,
)
REALSENSE = SourceKind(
    scheme="realsense",
    title="RealSense cameras",
    form="realsense:[PROXIMITY,TACTILE]",
    description="A live L515 and a D405, captured in a separate process; serial numbers select the devices.",
    open=partial(open_in_process, driver="realsense"),
)
