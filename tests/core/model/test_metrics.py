"""Metrics by hand and against brute force; the connected parts of a patch."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigs import one_place_rig
from tactune.core.model.clouds import truth_points
from tactune.core.model.frames import DepthCamera, GroundTruth, Rig
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.model.metrics import TruthTree, compare_with_truth, symmetric_rmse_m
from tactune.core.model.patch import AlignedDepth, ContactPatch, Lazy, Provenance

LENS = Intrinsics(width=6, height=4, fx=5.0, fy=6.0, cx=2.5, cy=1.5)
CAMERA = DepthCamera(intrinsics=LENS, depth_unit_m=0.001)
RIG = Rig(proximity=CAMERA, tactile=CAMERA)


def two_clouds(seed, first, second):
    random = np.random.default_rng(seed)
    return random.normal(0.0, 0.05, (first, 3)), random.normal(0.01, 0.03, (second, 3))


def directed(points, others):
    """Every distance to every other point, the least of each."""
    return np.array([min(math.dist(p, q) for q in others) for p in points])


@given(st.integers(0, 10_000), st.integers(1, 40), st.integers(1, 40))
def test_distances_against_a_brute_force_oracle(seed, first, second):
    patch, truth = two_clouds(seed, first, second)
    there, back = directed(patch, truth), directed(truth, patch)
    expected = (math.sqrt(sum(d * d for d in there) / first) + math.sqrt(sum(d * d for d in back) / second)) / 2
    assert symmetric_rmse_m(patch, truth) == pytest.approx(expected)


def test_a_sample_of_the_truth_tells_nearly_the_same():
    patch, truth = two_clouds(0, 300, 5000)
    assert TruthTree(truth, samples=1000).symmetric_rmse_m(patch) == pytest.approx(symmetric_rmse_m(patch, truth), 0.02)


def make_patch(mask, points):
    provenance = np.where(mask, Provenance.CONTACT, Provenance.OUTSIDE_TOLERANCE).astype(np.uint8)
    nothing = np.full(mask.shape, np.nan, np.float32)
    return ContactPatch(0, points, provenance, AlignedDepth(nothing, nothing), RIG, {})


def test_truth_without_depth_has_no_cloud():
    truth = GroundTruth(np.ones((4, 6), bool))
    assert truth_points(truth, RIG).shape == (0, 3)
    scores = compare_with_truth(make_patch(truth.contact, np.ones((24, 3), np.float32)), truth, RIG)
    assert scores["iou"] == 1.0
    assert math.isnan(scores["rmse_mm"])


def test_a_patch_is_scored_in_pixels_and_millimetres():
    contact = np.zeros((4, 6), bool)
    contact[1, 2:5] = contact[3, 0] = True
    depth_m = np.linspace(0.2, 0.3, 24, dtype=np.float32).reshape(4, 6)
    depth_m[1, 3] = np.nan
    truth = GroundTruth(contact, depth_m)
    cloud = truth_points(truth, RIG)
    mask = truth.contact.copy()
    mask[3, 0] = False
    mask[0, 0:2] = True
    far = cloud + np.float32([0.0, 0.0, 0.004])
    scores = compare_with_truth(make_patch(mask, far), truth, RIG)
    assert scores == {
        "iou": 3 / 6,
        "precision": 3 / 5,
        "recall": 3 / 4,
        "rmse_mm": pytest.approx(1e3 * symmetric_rmse_m(far, cloud)),
    }
    assert scores["rmse_mm"] == pytest.approx(4.0, rel=1e-4)


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
