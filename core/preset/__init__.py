"""Presets: everything a person calibrates and tunes, as strict, frozen sections, and their files."""

from .preset import (
    AlignmentSection,
    CameraSection,
    CamerasSection,
    HomographyAlignment,
    MaskSection,
    MembraneSection,
    OutlierSection,
    Preset,
    RangeSection,
    RegionSection,
    RigidAlignment,
    ToleranceSection,
    UntouchedRecord,
    now,
)

__all__ = [
    "AlignmentSection",
    "MembraneSection",
    "CameraSection",
    "CamerasSection",
    "HomographyAlignment",
    "MaskSection",
    "OutlierSection",
    "Preset",
    "RangeSection",
    "UntouchedRecord",
    "RegionSection",
    "RigidAlignment",
    "ToleranceSection",
    "now",
]
