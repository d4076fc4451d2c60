"""Presets: everything a person calibrates and tunes, as strict, frozen sections, and their files."""

from .preset import (
    AlignmentSection,
    CalibratedSection,
    CameraSection,
    CamerasSection,
    HomographyAlignment,
    MaskSection,
    OutlierSection,
    Preset,
    RangeSection,
    ReferenceRecord,
    RegionSection,
    RigidAlignment,
    ToleranceSection,
    now,
)

__all__ = [
    "AlignmentSection",
    "CalibratedSection",
    "CameraSection",
    "CamerasSection",
    "HomographyAlignment",
    "MaskSection",
    "OutlierSection",
    "Preset",
    "RangeSection",
    "ReferenceRecord",
    "RegionSection",
    "RigidAlignment",
    "ToleranceSection",
    "now",
]
