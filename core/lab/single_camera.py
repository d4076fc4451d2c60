"""Rivals that use one camera: contact is what differs from the untouched membrane (the baselines of Yin et al.)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from ..model.arrays import BoolArray, Float32Array, Uint16Array
from ..model.clouds import deproject, valid_depth
from ..model.frames import Rig, SensorFrame
from ..model.patch import AlignedDepth, ContactPatch, Lazy
from ..model.provenance import Provenance
from ..preset import Preset
from .membrane_view import MembraneView

#: Finds the contact patch of a frame; raises a `TactuneError` that says why where it cannot.
Find = Callable[[SensorFrame], ContactPatch]

#: proximity-only: minimum distance of a contact point in front of the untouched membrane; it excludes noise at the rim.
_MARGIN_M: Final = 0.002
#: tactile-only: share of the deformed points that is contact, as in the paper; below this deformation none is.
_SHARE, _UNTOUCHED_M = 0.6, 0.0015
#: tactile-threshold: the deformation above which a point is contact.
_THRESHOLD_M: Final = 0.005


def proximity_only(preset: Preset, rig: Rig, untouched: SensorFrame) -> Find:
    """Proximity camera: points nearer than the untouched membrane.

    The proximity-only baseline of Yin et al.
    """
    untouched.check_against(rig)
    nearer_than_m = MembraneView(preset.alignment, rig).depth_m(untouched.tactile_depth) - _MARGIN_M

    def find(frame: SensorFrame) -> ContactPatch:
        frame.check_against(rig)
        counts = frame.proximity_depth
        with np.errstate(invalid="ignore"):
            mask = valid_depth(counts) & (counts * rig.proximity.depth_unit_m < nearer_than_m)
        return rival_patch(frame, rig, deproject(counts, rig.proximity, np.flatnonzero(mask)), lambda: mask)

    return find


def tactile_only(preset: Preset, rig: Rig, untouched: SensorFrame) -> Find:
    """Tactile camera: the 60 % of the deformed membrane that moved most.

    The tactile-only baseline of Yin et al.
    """

    def least_m(deformation_m: Float32Array) -> float:
        return float(np.quantile(deformation_m[deformation_m > _UNTOUCHED_M], 1.0 - _SHARE))

    return _most_deformed(preset, rig, untouched, least_m)


def tactile_threshold(preset: Preset, rig: Rig, untouched: SensorFrame) -> Find:
    """Tactile camera: parts that moved by more than 5 mm."""
    return _most_deformed(preset, rig, untouched, lambda deformation_m: _THRESHOLD_M)


def _most_deformed(preset: Preset, rig: Rig, untouched: SensorFrame, least_m: Callable[[Any], float]) -> Find:
    untouched.check_against(rig)
    factor = rig.tactile.depth_unit_m * preset.alignment.depth_scale
    view = MembraneView(preset.alignment, rig)
    untouched_m = np.where(valid_depth(untouched.tactile_depth), untouched.tactile_depth * factor, np.nan)

    def in_contact(counts: Uint16Array) -> BoolArray:
        with np.errstate(invalid="ignore"):
            deformation_m = np.where(valid_depth(counts), untouched_m - counts * factor, np.nan)
            deformed = deformation_m > _UNTOUCHED_M
            return deformed & (deformation_m >= least_m(deformation_m)) if deformed.any() else deformed

    def find(frame: SensorFrame) -> ContactPatch:
        frame.check_against(rig)
        counts = frame.tactile_depth
        contact = in_contact(counts)
        return rival_patch(frame, rig, view.points(contact, counts), lambda: view.pick(contact, counts))

    return find


def rival_patch(frame: SensorFrame, rig: Rig, points: Float32Array, mask: Callable[[], BoolArray]) -> ContactPatch:
    """Return a rival's patch; only its points, (N, 3), and mask, (H, W), are known.

    The points may come from the tactile camera's pixels, so there may be more or fewer than the mask has pixels.
    """
    known, shape = Lazy(mask), rig.proximity.intrinsics.shape
    verdicts = Lazy(lambda: np.where(known.get(), Provenance.CONTACT, Provenance.OUTSIDE_TOLERANCE).astype(np.uint8))
    nothing = np.full(shape, np.nan, np.float32)
    return ContactPatch(frame.sequence, points, verdicts, AlignedDepth(nothing, nothing), rig, {}, mask=known)
