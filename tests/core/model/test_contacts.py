"""The connected parts of a patch."""

import numpy as np
import pytest

from rigs import one_place_rig
from tactune.core.model.patch import AlignedDepth, ContactPatch, Lazy, Provenance


def patch_of(mask):
    """Return a patch of these pixels at 0.2 m, farther in the right half."""
    rig = one_place_rig(mask.shape[1], mask.shape[0], 50.0)
    camera, (v, u) = rig.proximity.intrinsics, np.nonzero(mask)
    z = np.where(u < mask.shape[1] / 2, 0.2, 0.3)
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1).astype(np.float32)
    verdicts = np.where(mask, Provenance.CONTACT, Provenance.OUTSIDE_TOLERANCE).astype(np.uint8)
    return ContactPatch(0, points, verdicts, AlignedDepth.empty(mask.shape), rig, {}, made_mask=Lazy(lambda: mask))


def test_contacts_are_the_connected_parts_the_largest_first():
    mask = np.zeros((40, 60), bool)
    mask[5:10, 5:15] = True  # 50 pixels at 0.2 m
    mask[10, 15] = True  # touches at a corner
    mask[20:29, 40:49] = True  # a ring of 72 pixels at 0.3 m
    mask[23:26, 43:46] = False
    patch = patch_of(mask)
    ring, block = patch.contacts
    assert ring.area_mm2 + block.area_mm2 == pytest.approx(patch.area_mm2)
    assert ring.area_mm2 == pytest.approx(72 * (0.3 / 50 * 1e3) ** 2)
    assert block.area_mm2 == pytest.approx(51 * (0.2 / 50 * 1e3) ** 2)
    camera = patch.rig.proximity.intrinsics
    expected = (44 - camera.cx) / 50 * 0.3, (24 - camera.cy) / 50 * 0.3, 0.3
    assert ring.centroid_m == pytest.approx(expected, abs=1e-6)
