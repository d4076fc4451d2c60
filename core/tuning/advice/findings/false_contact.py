"""Contact on the untouched membrane."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from ....errors import counted
from ....model.arrays import Float64Array
from ....model.frames import Rig
from ....model.patch import ContactPatch
from ..proposal import Finding, Proposal
from .situation import Situation

#: False contact below this area is not reported, mm2.
_MIN_AREA_MM2: Final = 10.0
#: A smallest contact above this would drop what people press, mm2; the proposed one exceeds the largest false contact
#: by this factor.
_MAX_SMALLEST_MM2, _MARGIN = 100.0, 1.2
#: An object in contact dents the membrane. Curvature of a slightly bulged membrane, 1/m, and the smallest dent that
#: can be told from noise, metres.
_BULGE_PER_M, _MIN_DENT_M = 10.0, 0.001
_FIELDS: Final = {"membrane": "membrane.min_area_mm2", "tolerance": "outliers.min_cluster_area_mm2"}


def find(situation: Situation) -> Finding | None:
    """Return a finding if the preset finds contact where nothing touches."""
    patch, where = situation.untouched_patch, "The untouched frame has"
    if patch is None or patch.area_mm2 < _MIN_AREA_MM2:
        patch, where = situation.patch, "The membrane is where it was in the untouched frame, but there is"
        if patch.area_mm2 < _MIN_AREA_MM2 or not _at_rest(situation):
            return None
    areas = _areas_mm2(patch, situation.rig)
    places = counted(len(areas), "place")
    sentence = f"{where} {patch.area_mm2:.0f} mm² of contact in {places} with this preset."
    field = _FIELDS[situation.preset.contact_test]
    smallest_mm2 = float(math.ceil(_MARGIN * areas.max()))
    proposal = None
    if smallest_mm2 <= _MAX_SMALLEST_MM2:
        proposal = Proposal(
            section=field.partition(".")[0],
            changes={field: smallest_mm2},
            label=f"Smallest contact {smallest_mm2:g} mm²",
            evidence=f"The largest false contact has {areas.max():.0f} mm².",
            expected="The untouched membrane gives no contact. True contact below that area is dropped too.",
        )
    return Finding("false_contact", field, sentence, proposal, "" if proposal else "measure_noise")


def _areas_mm2(patch: ContactPatch, rig: Rig) -> Float64Array:
    """Return the area of each connected group."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(patch.mask.view(np.uint8))
    camera, depth_m = rig.proximity.intrinsics, float(np.median(patch.points[:, 2]))
    return np.asarray(1e6 * stats[1:, cv2.CC_STAT_AREA] * depth_m**2 / (camera.fx * camera.fy), np.float64)


def _at_rest(situation: Situation) -> bool:
    """Return whether the membrane is as far away as in the untouched frame, though contact as large must dent it.

    A flat object that touches a membrane of twice the mean curvature c over the area A dents it by at least
    A c / (4 pi), the height of a sphere's cap.
    """
    before = situation.untouched_patch
    dent_m = 1e-6 * situation.patch.area_mm2 * _BULGE_PER_M / (4 * math.pi)
    if before is None or dent_m < _MIN_DENT_M:
        return False
    change_m = (situation.patch.aligned.measured_m - before.aligned.measured_m)[situation.patch.mask]
    return abs(float(np.nanmedian(change_m))) < dent_m / 2
