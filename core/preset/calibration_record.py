"""What a preset keeps of the calibration that made its alignment: clicks, snapshots and quality."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

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
    """A calibration: when, of which cameras, from which clicks, how good."""

    date: datetime
    model: Literal["homography", "rigid"]
    proximity_serial: str = ""
    tactile_serial: str = ""
    verdict: _Text = ""
    points: tuple[ClickedPair, ...] = ()
    snapshots: tuple[SnapshotRecord, ...] = ()
    quality: ModelSummary
