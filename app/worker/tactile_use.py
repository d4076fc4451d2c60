"""What each tactile pixel was used for, as the colour of its point."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from ...core.contact.alignment import AlignmentModel, make_alignment
from ...core.contact.pipeline import ContactPatch
from ...core.errors import TactuneError
from ...core.model.arrays import Float32Array, Uint8Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from ...core.model.provenance import Provenance
from ...core.preset import AlignmentSection
from ...widgets.basics.colormaps import AGREED_ROW, TOUCHING_ROW, USED_ROW


def tactile_use(frame: SensorFrame, patch: ContactPatch, section: AlignmentSection, rig: Rig) -> Uint8Array:
    """Return what each tactile pixel was used for, as rows of `tactile_use_lut`: uint8 (H, W) of the tactile image.

    A tactile pixel is used by the proximity points that the alignment projects onto it; if several do, contact counts
    first. Pixels between neighbouring projected points take the use of their neighbours.
    """
    used = np.zeros(frame.tactile_depth.shape, np.uint8)
    try:
        model = alignment_model(section, rig)
    except TactuneError:
        return used
    verdicts = patch.provenance.reshape(-1)
    pixels = np.flatnonzero(valid_depth(frame.proximity_depth))
    depth_m: Float32Array = frame.proximity_depth.reshape(-1)[pixels] * np.float32(rig.proximity.depth_unit_m)
    u, v = model.tactile_pixels(pixels, depth_m, rig)
    height, width = frame.tactile_depth.shape
    inside = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    places = np.rint(v[inside]).astype(np.int64) * width + np.rint(u[inside]).astype(np.int64)
    uses = _USE_OF[verdicts[pixels[inside]]]
    for use in (USED_ROW, AGREED_ROW, TOUCHING_ROW):
        used.reshape(-1)[places[uses == use]] = use
    step = int(np.ceil(rig.tactile.intrinsics.fx / rig.proximity.intrinsics.fx))
    return np.where(used > 0, used, cv2.dilate(used, np.ones((2 * step + 1, 2 * step + 1), np.uint8)))


@lru_cache(maxsize=2)
def alignment_model(section: AlignmentSection, rig: Rig) -> AlignmentModel:
    return make_alignment(section, rig)


#: The use of a tactile pixel by a proximity pixel of each verdict; 0: it was not compared.
_USE_OF = np.zeros(len(Provenance), np.uint8)
_USE_OF[Provenance.OUTSIDE_TOLERANCE] = USED_ROW
_USE_OF[[Provenance.MASKED, Provenance.OUTLIER, Provenance.SMALL_CLUSTER, Provenance.RIM]] = AGREED_ROW
_USE_OF[Provenance.CONTACT] = TOUCHING_ROW
