"""The preset's alignment section: the model that maps tactile measurements to proximity pixels."""

from __future__ import annotations

from datetime import datetime
from math import isnan
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from .frames import CameraPose
from .intrinsics import Frozen
from .sections import Section, described, stored

Row3 = tuple[float, float, float]
Matrix3 = tuple[Row3, Row3, Row3]


_Text = Annotated[str, Field(max_length=10_000)]
_NonNegative = Annotated[float, Field(ge=0.0)]
_Pixel = Annotated[float, Field(ge=-1e7, le=1e7)]
_Depth = Annotated[
    Annotated[float, Field(ge=0.001, le=10.0)] | None,
    BeforeValidator(lambda value: None if isinstance(value, float) and isnan(value) else value),
]
Side = Literal["proximity", "tactile"]
Place = tuple[float, float]


class PointPair(Frozen):
    """One place on the membrane or on a pressed object, clicked in both cameras' images.

    ``proximity_image`` names the image whose pixels the proximity side is given in; points in colour lie on the
    membrane, which the proximity depth does not see. ``tactile_depth_m`` is the raw tactile depth, None where there is
    none. ``snapshot`` counts the snapshots of a calibration from 0. A pair is pending while one side is None.
    """

    id: Annotated[str, Field(min_length=1, max_length=200)]
    enabled: bool = True
    proximity_u: _Pixel | None = None
    proximity_v: _Pixel | None = None
    tactile_u: _Pixel | None = None
    tactile_v: _Pixel | None = None
    tactile_depth_m: _Depth = None
    proximity_image: Literal["depth", "color"] = "depth"
    snapshot: Annotated[int, Field(ge=0)] | None = None
    origin: Annotated[str, Field(max_length=200)] = ""

    @model_validator(mode="before")
    @classmethod
    def _without_contact(cls, values: Any) -> Any:
        # older files hold the proximity depth at contact, which improved no fit by more than 5 %
        if isinstance(values, dict):
            return {name: value for name, value in values.items() if name != "proximity_depth_m"}
        return values

    @property
    def proximity(self) -> Place | None:
        """The proximity pixel; None while it is missing."""
        return None if self.proximity_u is None or self.proximity_v is None else (self.proximity_u, self.proximity_v)

    @property
    def tactile(self) -> Place | None:
        """The tactile pixel; None while it is missing."""
        return None if self.tactile_u is None or self.tactile_v is None else (self.tactile_u, self.tactile_v)

    @property
    def complete(self) -> bool:
        """Whether both sides are clicked."""
        return self.proximity is not None and self.tactile is not None

    def place(self, side: Side) -> Place | None:
        return self.proximity if side == "proximity" else self.tactile


class SnapshotRecord(Frozen):
    """The images that were clicked on, by the hash of their content."""

    name: _Text = ""
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    frames: Annotated[int, Field(ge=1)] = 1


class ModelSummary(Frozen):
    """The quality of the fit at the time; pixels are proximity pixels."""

    rms_px: _NonNegative | None = None
    cross_validated_px: _NonNegative | None = None
    alignment_px: _NonNegative
    alignment_bound_95_px: _NonNegative
    boundary_error_mm: _NonNegative
    supported_tolerance: _NonNegative
    excluded: tuple[str, ...] = ()


class CalibrationRecord(Frozen):
    """A calibration: its date, cameras, clicks and quality."""

    date: datetime
    model: Literal["homography", "rigid"]
    proximity_serial: str = ""
    tactile_serial: str = ""
    verdict: _Text = ""
    points: tuple[PointPair, ...] = ()
    snapshots: tuple[SnapshotRecord, ...] = ()
    quality: ModelSummary


class RigidAlignment(Section):
    """The tactile camera's pose in the proximity depth frame; null means the rig's own pose."""

    T_proximity_tactile: Annotated[
        CameraPose | None,
        described(
            "Pose",
            "Pose of the tactile camera in the proximity depth frame (4 x 4, metres). "
            "Empty: the factory or nominal pose that the rig states.",
            unit="m",
            advanced=True,
        ),
    ] = None


class HomographyAlignment(Section):
    """A plane homography; null means the one that the rig's pose induces on a frontal plane."""

    H_p_t: Annotated[
        Matrix3 | None,
        described(
            "Homography",
            "3 x 3 matrix that takes tactile pixels to proximity pixels. "
            "Empty: the homography that the rig's pose induces on the plane below.",
            unit="px",
            advanced=True,
        ),
    ] = None
    plane_distance_m: Annotated[
        float,
        described(
            "Plane distance",
            "Distance of the frontal plane that the homography is exact for, used while no matrix is set.",
            unit="m",
            step=0.001,
            advanced=True,
            limits=(0.05, 2.0),
        ),
    ] = 0.30

    @field_validator("H_p_t")
    @classmethod
    def _is_regular(cls, value: Matrix3 | None) -> Matrix3 | None:
        if value is None:
            return None
        singular_values = np.linalg.svd(np.asarray(value), compute_uv=False)
        if not singular_values[-1] > 1e-15 * singular_values[0]:
            raise ValueError("the homography is singular: it maps the image onto a line or a point; fit it again")
        return value


class AlignmentSection(Section):
    """How tactile measurements are brought to proximity pixels."""

    model: Annotated[
        Literal["rigid", "homography"],
        described(
            "Model",
            "rigid: each proximity point is projected into the tactile image and its expected depth compared; "
            "exact at every depth. homography: the images are aligned by the homography of one plane.",
        ),
    ] = "rigid"
    rigid: RigidAlignment = RigidAlignment()
    homography: HomographyAlignment = HomographyAlignment()
    depth_scale: Annotated[
        float,
        described(
            "Depth scale",
            "Factor on the tactile depth that makes both sensors agree.",
            step=0.001,
            advanced=True,
            limits=(0.8, 1.25),
        ),
    ] = 1.0
    depth_offset_m: Annotated[
        float,
        described(
            "Depth offset",
            "Added to the scaled tactile depth so that both sensors agree on the same surface.",
            unit="m",
            step=0.0005,
            limits=(-0.1, 0.1),
        ),
    ] = 0.0
    calibration: Annotated[
        CalibrationRecord | None,
        stored(
            "Calibration",
            "The clicks, snapshots and quality of the calibration that made this alignment. Empty: set by hand.",
        ),
    ] = None

    @property
    def geometry(self) -> tuple[str, RigidAlignment, HomographyAlignment, float, float]:
        """The fields that affect results: all but the calibration record."""
        return self.model, self.rigid, self.homography, self.depth_scale, self.depth_offset_m
