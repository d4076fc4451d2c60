"""The sections that every preset has: cameras, mask, range, region and the untouched frame.

A section is a frozen, strict model. Each field carries its bounds, unit, title and tooltip; the parameter panel, the
JSON Schema and the messages about bad values are made from them.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from .intrinsics import Frozen

_Hue = Annotated[int, Field(ge=0, le=179)]
_Byte = Annotated[int, Field(ge=0, le=255)]
_Pixel = Annotated[int, Field(ge=0, le=16384)]


def described(
    title: str, description: str, *, unit: str = "", limits: tuple[float, float] | None = None, **extra: Any
) -> Any:
    """Return a field with title, tooltip, unit and slider's scale; ``advanced`` ones are behind the panel's fold."""
    bounds: dict[str, Any] = {} if limits is None else {"ge": limits[0], "le": limits[1]}
    return Field(title=title, description=description, json_schema_extra={"unit": unit, **extra}, **bounds)


def stored(title: str, description: str, **options: Any) -> Any:
    """Return a field that the panel does not show: what was measured or chosen elsewhere."""
    return described(title, description, hidden=True, **options)


#: The smallest contact that a test keeps.
SmallestContact = Annotated[
    float,
    described(
        "Smallest contact",
        "Connected groups of contact pixels with a smaller area are dropped. 0 keeps all.",
        unit="mm2",
        slider=(0.0, 500.0),
        step=5.0,
        limits=(0.0, 1e6),
    ),
]


class Section(Frozen):
    """A part of a preset."""


class MaskSection(Section):
    """The colour of the parts of the membrane that reflect infrared, such as prints: they would pass as contact."""

    enabled: Annotated[
        bool, described("Use the mask", "Drop pixels with the colour of the membrane's prints, which reflect infrared.")
    ] = True
    hue: Annotated[
        tuple[_Hue, _Hue],
        described(
            "Hue",
            "Hue range of the prints, OpenCV convention 0-179. A low end above the high end wraps around through red.",
            unit="deg/2",
            wraps=True,
        ),
    ] = (0, 179)
    saturation: Annotated[
        tuple[_Byte, _Byte], described("Saturation", "Saturation range of the prints, 0 grey to 255 pure.")
    ] = (0, 255)
    value: Annotated[
        tuple[_Byte, _Byte], described("Value", "Brightness range of the prints, 0 black to 255 brightest.")
    ] = (0, 255)

    @model_validator(mode="after")
    def _ordered(self) -> MaskSection:
        for name in ("saturation", "value"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} has its low end {low} above its high end {high}, as only hue may; swap them")
        return self


class RangeSection(Section):
    """The working range: proximity depths outside it are never contact."""

    enabled: Annotated[bool, described("Limit the range", "Ignore points nearer or farther than the range.")] = False
    limits_m: Annotated[
        tuple[Annotated[float, Field(ge=0.0, le=10.0)], Annotated[float, Field(ge=0.0, le=10.0)]],
        described("Range", "Nearest and farthest proximity depth considered.", unit="m", slider=(0.0, 1.0), step=0.001),
    ] = (0.1, 0.5)

    @field_validator("limits_m")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            raise ValueError(f"the near limit {value[0]} m is not below the far limit {value[1]} m; swap them")
        return value


class RegionSection(Section):
    """A rectangle of proximity pixels; nothing outside it is computed."""

    enabled: Annotated[bool, described("Limit the region", "Ignore pixels outside the rectangle.")] = False
    rectangle: Annotated[
        tuple[_Pixel, _Pixel, _Pixel, _Pixel],
        described("Rectangle", "Left, top, width and height in proximity pixels.", unit="px"),
    ] = (0, 0, 640, 480)

    @field_validator("rectangle")
    @classmethod
    def _not_empty(cls, value: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
        if value[2] == 0 or value[3] == 0:
            raise ValueError(f"the region is {value[2]} x {value[3]} pixels and so empty; give it a size")
        return value


class CameraSection(Section):
    """Which of the connected devices is one of the two cameras, and how it is set up."""

    serial: Annotated[
        str,
        stored("Serial number", "Serial number of the camera. Empty: the only connected one of a fitting model."),
        Field(max_length=64, pattern=r"^[0-9A-Za-z_.-]*$"),
    ] = ""
    options: Annotated[
        dict[Annotated[str, Field(min_length=1, max_length=80)], float],
        stored(
            "Options",
            "Camera settings by the driver's names, such as laser_power. Settings that are not listed are unchanged.",
        ),
    ] = Field(default_factory=dict)


class CamerasSection(Section):
    """The two cameras of a live source. Recordings ignore it."""

    proximity: CameraSection = CameraSection()
    tactile: CameraSection = CameraSection()
    tactile_delay_s: Annotated[
        float,
        stored(
            "Tactile delay",
            "Delay of the tactile camera's images relative to the proximity camera's with equal time stamps. "
            "It is subtracted from the tactile time stamps before images are paired.",
            unit="s",
            step=0.001,
            limits=(-2.0, 2.0),
        ),
    ] = 0.0


class UntouchedRecord(Section):
    """The untouched membrane: averaged frames in a file beside the preset."""

    file: Annotated[
        str,
        stored("File", "Name of the file in the preset's own folder."),
        Field(pattern=r"^untouched-[0-9a-f]{12}\.npz$"),
    ]
    sha256: Annotated[
        str,
        stored("Hash", "SHA-256 of the images in it, so that another file is not mistaken for it."),
        Field(pattern=r"^[0-9a-f]{64}$"),
    ]
    frames: Annotated[int, stored("Frames", "Number of frames that were averaged.", unit="frames", limits=(1, 100_000))]
