"""Contact from the proximity camera alone: points nearer than the untouched membrane."""

from __future__ import annotations

import numpy as np

from ..model.clouds import deproject, valid_depth
from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from .membrane_view import MembraneView
from .method import ContactMethod, MethodKind, MethodPatch


class ProximityOnly(ContactMethod):
    """Points nearer to the camera than the inflated, untouched membrane.

    Parameters
    ----------
    preset : Preset
        Gives the alignment that maps the untouched frame to proximity pixels.
    rig : Rig
    untouched : SensorFrame
        The untouched membrane.
    margin_m : float
        Minimum distance of a contact point in front of the untouched membrane, metres. It excludes noise at the rim.

    References
    ----------
    Yin et al., "Proximity and Visuotactile Point Cloud Fusion for Contact Patches in Extreme
    Deformation", the proximity-only baseline.
    """

    name = "proximity-only"

    def __init__(self, preset: Preset, rig: Rig, untouched: SensorFrame, margin_m: float = 0.002) -> None:
        untouched.check_against(rig)
        self._rig = rig
        self._nearer_than_m = MembraneView(preset.alignment, rig).depth_m(untouched.tactile_depth) - margin_m

    def find(self, frame: SensorFrame) -> MethodPatch:
        """Return the points in front of the untouched frame."""
        frame.check_against(self._rig)
        counts = frame.proximity_depth
        with np.errstate(invalid="ignore"):
            mask = valid_depth(counts) & (counts * self._rig.proximity.depth_unit_m < self._nearer_than_m)
        return MethodPatch(deproject(counts, self._rig.proximity, np.flatnonzero(mask)), lambda: mask)


def _make(preset: Preset, rig: Rig, untouched: SensorFrame | None) -> ContactMethod:
    assert untouched is not None  # `make_method` has checked
    return ProximityOnly(preset, rig, untouched)


METHOD = MethodKind(
    "proximity-only",
    "Proximity camera: points nearer than the untouched membrane",
    (0, 114, 178),
    _make,
    needs_untouched=True,
    rank=10,
)
