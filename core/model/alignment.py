"""The preset's alignment section: the model that maps tactile measurements to proximity pixels."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from .frames import Matrix4, camera_pose
from .sections import Section, described

Row3 = tuple[float, float, float]
Matrix3 = tuple[Row3, Row3, Row3]


_Text = Annotated[str, Field(max_length=10_000)]
_NonNegative = Annotated[float, Field(ge=0.0)]


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class ClickedPair(_Record):
    """One pair of clicks; see `tactune.core.calibration.Correspondence`."""

    id: Annotated[str, Field(min_length=1, max_length=200)]
    proximity_u: float
    proximity_v: float
    tactile_u: float
    tactile_v: float
    tactile_depth_m: float | None = None
    enabled: bool = True
    proximity_image: Literal["depth", "color"] = "depth"
    snapshot: Annotated[int, Field(ge=0)] | None = None
    proximity_depth_m: float | None = None


class SnapshotRecord(_Record):
    """The images that were clicked on, by the hash of their content."""

    name: _Text = ""
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    frames: Annotated[int, Field(ge=1)] = 1


class ModelSummary(_Record):
    """The quality of the fit at the time; pixels are proximity pixels."""

    rms_px: _NonNegative | None = None
    cross_validated_px: _NonNegative | None = None
    alignment_px: _NonNegative
    alignment_bound_95_px: _NonNegative
    boundary_error_mm: _NonNegative
    supported_tolerance: _NonNegative
    excluded: tuple[str, ...] = ()


class CalibrationRecord(_Record):
    """A calibration: its date, cameras, clicks and quality."""

    date: datetime
    model: Literal["homography", "rigid"]
    proximity_serial: str = ""
    tactile_serial: str = ""
    verdict: _Text = ""
    points: tuple[ClickedPair, ...] = ()
    snapshots: tuple[SnapshotRecord, ...] = ()
    quality: ModelSummary


class RigidAlignment(Section):
    """The tactile camera's pose in the proximity depth frame; null means the rig's own pose."""

    T_proximity_tactile: Annotated[
        Matrix4 | None,
        described(
            "Pose",
            "Pose of the tactile camera in the proximity depth frame (4 x 4, metres). "
            "Empty: the factory or nominal pose that the rig states.",
            unit="m",
            advanced=True,
        ),
    ] = None

    @field_validator("T_proximity_tactile", mode="before")
    @classmethod
    def _is_rigid(cls, value: Any) -> Matrix4 | None:
        return None if value is None else camera_pose(value)


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
        ),
        Field(ge=0.05, le=2.0),
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
            "Depth scale", "Factor on the tactile depth that makes both sensors agree.", step=0.001, advanced=True
        ),
        Field(ge=0.8, le=1.25),
    ] = 1.0
    depth_offset_m: Annotated[
        float,
        described(
            "Depth offset",
            "Added to the scaled tactile depth so that both sensors agree on the same surface.",
            unit="m",
            step=0.0005,
        ),
        Field(ge=-0.1, le=0.1),
    ] = 0.0
    calibration: Annotated[
        CalibrationRecord | None,
        described(
            "Calibration",
            "The clicks, snapshots and quality of the calibration that made this alignment. Empty: set by hand.",
            hidden=True,
        ),
    ] = None

    @property
    def geometry(self) -> tuple[str, RigidAlignment, HomographyAlignment, float, float]:
        """The fields that affect results: all but the calibration record."""
        return self.model, self.rigid, self.homography, self.depth_scale, self.depth_offset_m
