"""Presets: all calibrated and tuned values as strict, frozen sections, and their files."""

from .alignment import AlignmentSection, HomographyAlignment, RigidAlignment
from .contact_test import ContactTest
from .membrane import MembraneSection
from .preset import CONTACT_TESTS, Preset, now
from .rig_noise import CameraNoise, RigNoise
from .sections import CameraSection, CamerasSection, MaskSection, RangeSection, RegionSection, UntouchedRecord
from .tolerance import OutlierSection, ToleranceSection

__all__ = [
    "CONTACT_TESTS",
    "AlignmentSection",
    "CameraNoise",
    "CameraSection",
    "CamerasSection",
    "ContactTest",
    "HomographyAlignment",
    "MaskSection",
    "MembraneSection",
    "OutlierSection",
    "Preset",
    "RangeSection",
    "RegionSection",
    "RigNoise",
    "RigidAlignment",
    "ToleranceSection",
    "UntouchedRecord",
    "now",
]
