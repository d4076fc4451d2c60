"""The part of a preset that chooses and sets up the cameras of a live source."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from .fields import Section, described


class CameraSection(Section):
    """Which of the connected devices is one of the two cameras, and how it is set up."""

    serial: Annotated[
        str,
        described(
            "Serial number",
            "Serial number of the camera. Empty: the only connected one of a fitting model.",
            hidden=True,
        ),
        Field(max_length=64, pattern=r"^[0-9A-Za-z_.-]*$"),
    ] = ""
    options: Annotated[
        dict[Annotated[str, Field(min_length=1, max_length=80)], float],
        described(
            "Options",
            "Settings of the camera by the driver's own names, such as laser_power; "
            "what is not named here stays as the camera has it.",
            hidden=True,
        ),
    ] = Field(default_factory=dict)


class CamerasSection(Section):
    """The two cameras of a live source. Recordings ignore it."""

    proximity: CameraSection = CameraSection()
    tactile: CameraSection = CameraSection()
    tactile_delay_s: Annotated[
        float,
        described(
            "Tactile delay",
            "How much later than the proximity camera's images with equal time stamps the tactile camera's show "
            "the same moment; it is taken off their time stamps before images are paired.",
            unit="s",
            step=0.001,
            hidden=True,
        ),
        Field(ge=-2.0, le=2.0),
    ] = 0.0
