"""Presets: all calibrated and tuned values as strict, frozen sections, and their files."""

from ..contact import CONTACT_TESTS
from ..contact.contact_test import ContactTest
from ..contact.membrane.section import MembraneSection
from ..contact.tolerance import OutlierSection, ToleranceSection
from ..model.alignment import AlignmentSection, HomographyAlignment, RigidAlignment
from ..model.rig_noise import CameraNoise, RigNoise
from ..model.sections import CameraSection, CamerasSection, MaskSection, RangeSection, RegionSection, UntouchedRecord
from .preset import Preset, now

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
