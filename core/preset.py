"""The preset: everything a person calibrates and tunes, as one strict, frozen model.

Each field carries its bounds, its unit and a sentence on what it does; the sliders of the GUI, the
JSON Schema and the messages for bad values are all made from these.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from .calibration_record import CalibrationRecord
from .frames import Matrix4, Rig, rigid_transform

Row3 = tuple[float, float, float]
Matrix3 = tuple[Row3, Row3, Row3]


def _field(title: str, description: str, *, unit: str = "", **extra: Any) -> Any:
    """Bounds aside, what the GUI needs to know of a field: title, unit, tooltip and scale."""
    return Field(title=title, description=description, json_schema_extra={"unit": unit, **extra})


class Section(BaseModel):
    """A frozen, strict part of a preset."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RigidAlignment(Section):
    """The tactile camera's pose in the proximity depth frame; null takes the rig's own pose."""

    T_proximity_tactile: Annotated[
        Matrix4 | None,
        _field(
            "Pose",
            "Pose of the tactile camera in the proximity depth frame (4 x 4, metres). "
            "Empty: the factory or nominal pose that the rig states.",
            unit="m",
        ),
    ] = None

    @field_validator("T_proximity_tactile", mode="before")
    @classmethod
    def _is_rigid(cls, value: Any) -> Matrix4 | None:
        return None if value is None else rigid_transform(value)


class HomographyAlignment(Section):
    """A plane homography; null takes the one that the rig's pose induces on a frontal plane."""

    H_p_t: Annotated[
        Matrix3 | None,
        _field(
            "Homography",
            "3 x 3 matrix that takes tactile pixels to proximity pixels. "
            "Empty: the homography that the rig's pose induces on the plane below.",
            unit="px",
        ),
    ] = None
    plane_distance_m: Annotated[
        float,
        _field(
            "Plane distance",
            "Distance of the frontal plane that the homography is exact for, used while no matrix is set.",
            unit="m",
            step=0.001,
        ),
        Field(ge=0.05, le=2.0),
    ] = 0.30

    @field_validator("H_p_t")
    @classmethod
    def _is_regular(cls, value: Matrix3 | None) -> Matrix3 | None:
        if value is None:
            return None
        singular_values = np.linalg.svd(np.asarray(value), compute_uv=False)
        if singular_values[-1] <= max(1e-15 * singular_values[0], 1e-12):
            raise ValueError("the homography is singular: it maps the image onto a line or a point; fit it again")
        return value


class AlignmentSection(Section):
    """How tactile measurements are brought to proximity pixels."""

    model: Annotated[
        Literal["rigid", "homography"],
        _field(
            "Model",
            "rigid: each proximity point is projected into the tactile image and its expected depth compared; "
            "exact at every depth. homography: the images are laid over each other by one plane's homography.",
        ),
    ] = "rigid"
    rigid: RigidAlignment = RigidAlignment()
    homography: HomographyAlignment = HomographyAlignment()
    depth_scale: Annotated[
        float,
        _field("Depth scale", "Factor on the tactile depth that makes both sensors agree.", step=0.001),
        Field(ge=0.8, le=1.25),
    ] = 1.0
    depth_offset_m: Annotated[
        float,
        _field(
            "Depth offset",
            "Added to the scaled tactile depth so that both sensors agree on the same surface.",
            unit="m",
            step=0.0005,
        ),
        Field(ge=-0.1, le=0.1),
    ] = 0.0
    calibration: Annotated[
        CalibrationRecord | None,
        _field(
            "Calibration",
            "The clicks, snapshots and quality of the calibration that made this alignment. Empty: set by hand.",
            hidden=True,
        ),
    ] = None

    @property
    def geometry(self) -> tuple[str, RigidAlignment, HomographyAlignment, float, float]:
        """What the pipeline computes with: all but the record of how it came about."""
        return self.model, self.rigid, self.homography, self.depth_scale, self.depth_offset_m


_Hue = Annotated[int, Field(ge=0, le=179)]
_Byte = Annotated[int, Field(ge=0, le=255)]


class MaskSection(Section):
    """The colour of the bare membrane: such pixels reflect infrared and would pass as contact."""

    enabled: Annotated[
        bool, _field("Use the mask", "Drop pixels whose colour is the bare membrane's; they reflect infrared.")
    ] = True
    hue: Annotated[
        tuple[_Hue, _Hue],
        _field(
            "Hue",
            "Hue range of the bare membrane, OpenCV convention 0-179. A low end above the high end wraps "
            "around through red.",
            unit="deg/2",
            wraps=True,
        ),
    ] = (0, 179)
    saturation: Annotated[
        tuple[_Byte, _Byte], _field("Saturation", "Saturation range of the bare membrane, 0 grey to 255 pure.")
    ] = (0, 255)
    value: Annotated[
        tuple[_Byte, _Byte], _field("Value", "Brightness range of the bare membrane, 0 black to 255 brightest.")
    ] = (0, 255)

    @model_validator(mode="after")
    def _ordered(self) -> MaskSection:
        for name in ("saturation", "value"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(
                    f"{name} has its low end {low} above its high end {high}; only hue wraps around, swap them"
                )
        return self


class ToleranceSection(Section):
    """The contact test |dp - dt| <= t |dp|."""

    t: Annotated[
        float,
        _field(
            "Tolerance t",
            "A pixel is in contact where both distances agree within this share of the distance.",
            scale="log",
            slider=(0.001, 0.3),
            step=0.001,
        ),
        Field(ge=0.0, le=1.0),
    ] = 0.03


class OutlierSection(Section):
    """Statistical outlier removal (Open3D's definition) and the smallest cluster kept."""

    enabled: Annotated[bool, _field("Remove outliers", "Drop points that lie unusually far from their neighbours.")] = (
        True
    )
    k: Annotated[
        int,
        _field(
            "Neighbours k",
            "Number of nearest points averaged for each point. The point itself counts as one, as in Open3D; "
            "PCL counts one less.",
            unit="points",
            slider=(1, 100),
        ),
        Field(ge=1, le=1000),
    ] = 20
    ratio: Annotated[
        float,
        _field(
            "Ratio",
            "Points whose mean neighbour distance exceeds the mean by this many standard deviations are dropped.",
            unit="sigma",
            slider=(0.1, 5.0),
            step=0.1,
        ),
        Field(gt=0.0, le=100.0),
    ] = 2.0
    min_cluster_area_mm2: Annotated[
        float,
        _field(
            "Smallest cluster",
            "Connected groups of contact pixels with a smaller area are dropped. 0 keeps all.",
            unit="mm2",
            slider=(0.0, 500.0),
            step=5.0,
        ),
        Field(ge=0.0, le=1e6),
    ] = 0.0


class RangeSection(Section):
    """The working range: proximity depths outside it are never contact."""

    enabled: Annotated[bool, _field("Limit the range", "Ignore points nearer or farther than the range.")] = False
    limits_m: Annotated[
        tuple[Annotated[float, Field(ge=0.0, le=10.0)], Annotated[float, Field(ge=0.0, le=10.0)]],
        _field("Range", "Nearest and farthest proximity depth considered.", unit="m", slider=(0.0, 1.0), step=0.001),
    ] = (0.1, 0.5)

    @field_validator("limits_m")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            raise ValueError(f"the near limit {value[0]} m is not below the far limit {value[1]} m; swap them")
        return value


_Pixel = Annotated[int, Field(ge=0, le=16384)]


class RegionSection(Section):
    """A rectangle of proximity pixels; nothing outside it is computed."""

    enabled: Annotated[bool, _field("Limit the region", "Ignore pixels outside the rectangle.")] = False
    rectangle: Annotated[
        tuple[_Pixel, _Pixel, _Pixel, _Pixel],
        _field("Rectangle", "Left, top, width and height in proximity pixels.", unit="px"),
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
        _field(
            "Serial number",
            "Serial number of the camera. Empty: the only connected one of a fitting model.",
            hidden=True,
        ),
        Field(max_length=64, pattern=r"^[0-9A-Za-z_.-]*$"),
    ] = ""
    options: Annotated[
        dict[Annotated[str, Field(min_length=1, max_length=80)], float],
        _field(
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
        _field(
            "Tactile delay",
            "How much later than the proximity camera's images with equal time stamps the tactile camera's show "
            "the same moment; it is taken off their time stamps before images are paired.",
            unit="s",
            step=0.001,
            hidden=True,
        ),
        Field(ge=-2.0, le=2.0),
    ] = 0.0


class ReferenceRecord(Section):
    """The untouched membrane: averaged frames in a file beside the preset."""

    file: Annotated[
        str,
        _field("File", "Name of the file in the preset's own folder.", hidden=True),
        Field(min_length=1, max_length=255, pattern=r"^[^/\\]+$"),
    ]
    sha256: Annotated[
        str,
        _field("Hash", "SHA-256 of the images in it, so that no other file is taken for it.", hidden=True),
        Field(pattern=r"^[0-9a-f]{64}$"),
    ]
    frames: Annotated[
        int, _field("Frames", "How many frames were averaged.", unit="frames", hidden=True), Field(ge=1, le=100_000)
    ]


def now() -> datetime:
    """Return the present moment in UTC, to the second, as presets store it."""
    return datetime.now(UTC).replace(microsecond=0)


class Preset(Section):
    """All that a person calibrates and tunes, plus the rig that it was made for.

    ``rig`` is None for a preset that serves any rig. `tactune.core.preset_file` loads and saves it.
    """

    name: Annotated[str, Field(min_length=1, max_length=120)] = "untitled"
    notes: Annotated[str, Field(max_length=10_000)] = ""
    created: datetime = Field(default_factory=now)
    modified: datetime = Field(default_factory=now)
    rig: Rig | None = None
    alignment: AlignmentSection = AlignmentSection()
    contact_test: Annotated[
        Literal["tolerance", "calibrated"],
        _field(
            "Contact test",
            "tolerance: a pixel is in contact where both distances agree within t, as published. calibrated: local "
            "means of the difference tell much smaller gaps apart, and the rim that is only near is taken away.",
        ),
    ] = "tolerance"
    mask: MaskSection = MaskSection(enabled=False)
    tolerance: ToleranceSection = ToleranceSection()
    outliers: OutlierSection = OutlierSection()
    range: RangeSection = RangeSection()
    region: RegionSection = RegionSection()
    cameras: CamerasSection = CamerasSection()
    reference: Annotated[
        ReferenceRecord | None,
        _field(
            "Reference",
            "The untouched membrane, which some methods and the drift check compare with. Empty: not captured.",
            hidden=True,
        ),
    ] = None

    def with_value(self, path: str, value: Any) -> Preset:
        """Return a copy with one field changed, validated as a whole.

        Parameters
        ----------
        path : str
            Dotted path of the field, such as ``"mask.hue"``.
        value : object
            Anything that the field accepts.

        Raises
        ------
        PresetError
            No such field, or a value that it does not allow; the message names both.
        """
        return self.with_values({path: value})

    def with_values(self, values: dict[str, Any]) -> Preset:
        """Return a copy with several fields changed at once; see `with_value`."""
        from .preset_file import parse_preset, set_path

        data = self.model_dump(mode="python")
        for path, value in values.items():
            set_path(data, path, value)
        return parse_preset(data, origin="preset")

    def value(self, path: str) -> Any:
        """Return the field at a dotted path, such as ``"tolerance.t"``."""
        target: Any = self
        for part in path.split("."):
            target = getattr(target, part)
        return target
