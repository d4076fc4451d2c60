"""Metrics against brute force, Open3D, and what must hold whatever the clouds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from scipy.spatial.transform import Rotation

from tactune.core.contact.pipeline import ContactPatch
from tactune.core.evaluation.metrics import PixelScores, compare_with_truth, pixel_scores, symmetric_rmse_m, truth_cloud
from tactune.core.model.frames import DepthCamera, GroundTruth, Rig
from tactune.core.model.intrinsics import Distortion, Intrinsics
from tactune.core.model.patch import AlignedDepth
from tactune.core.model.provenance import Provenance

LENS = Intrinsics(
    width=6,
    height=4,
    fx=5.0,
    fy=6.0,
    cx=2.5,
    cy=1.5,
    distortion=Distortion.INVERSE_BROWN_CONRADY,
    coefficients=(0.1, -0.05, 0.01, 0.02, 0.03),
)
RIG = Rig(
    proximity=DepthCamera(intrinsics=LENS, depth_unit_m=0.001),
    tactile=DepthCamera(intrinsics=LENS, depth_unit_m=0.001),
)

masks = npst.arrays(bool, (3, 4))
clouds = npst.arrays(
    np.float64, st.tuples(st.integers(1, 12), st.just(3)), elements=st.floats(-1.0, 1.0, allow_subnormal=False)
)


def brute_force_rmse(a: np.ndarray, b: np.ndarray) -> float:
    distances = np.linalg.norm(a[:, None] - b[None, :], axis=2)
    forth = math.sqrt(np.mean(distances.min(axis=1) ** 2))
    back = math.sqrt(np.mean(distances.min(axis=0) ** 2))
    return 0.5 * (forth + back)


# --- masks -----------------------------------------------------------------------------------------


def test_pixel_scores_by_hand() -> None:
    mask = np.array([[1, 1, 1, 0, 0, 0]], bool)
    truth = np.array([[0, 1, 1, 1, 1, 1]], bool)
    assert pixel_scores(mask, truth) == PixelScores(iou=2 / 6, precision=2 / 3, recall=2 / 5)


def test_pixel_scores_of_empty_masks() -> None:
    none, some = np.zeros((2, 2), bool), np.array([[1, 0], [0, 0]], bool)
    assert pixel_scores(none, none) == PixelScores(1.0, 1.0, 1.0)
    assert pixel_scores(none, some) == PixelScores(iou=0.0, precision=1.0, recall=0.0)
    assert pixel_scores(some, none) == PixelScores(iou=0.0, precision=0.0, recall=1.0)


def test_pixel_scores_refuse_masks_of_two_cameras() -> None:
    with pytest.raises(ValueError, match=r"\(2, 2\) and \(2, 3\)"):
        pixel_scores(np.zeros((2, 2), bool), np.zeros((2, 3), bool))


@given(masks, masks)
def test_pixel_scores_are_shares_and_swap(mask: np.ndarray, truth: np.ndarray) -> None:
    scores, swapped = pixel_scores(mask, truth), pixel_scores(truth, mask)
    assert 0.0 <= scores.iou <= min(scores.precision, scores.recall) <= 1.0
    assert (scores.iou, scores.precision, scores.recall) == (swapped.iou, swapped.recall, swapped.precision)
    assert (scores.iou == 1.0) == np.array_equal(mask, truth)
    assert pixel_scores(mask.T, truth.T) == scores


# --- clouds ----------------------------------------------------------------------------------------


def test_rmse_by_hand() -> None:
    first = np.zeros((1, 3))
    second = np.array([[3.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    assert symmetric_rmse_m(first, second) == pytest.approx((3.0 + math.sqrt((9 + 16) / 2)) / 2)


@pytest.mark.parametrize("sizes", [(0, 3), (3, 0), (0, 0)])
def test_rmse_of_an_empty_cloud_is_nan(sizes: tuple[int, int]) -> None:
    assert math.isnan(symmetric_rmse_m(np.ones((sizes[0], 3)), np.ones((sizes[1], 3))))


@given(clouds, clouds)
def test_rmse_is_that_of_brute_force(a: np.ndarray, b: np.ndarray) -> None:
    assert symmetric_rmse_m(a, b) == pytest.approx(brute_force_rmse(a, b), abs=1e-12)


@given(clouds, clouds)
def test_rmse_is_symmetric(a: np.ndarray, b: np.ndarray) -> None:
    assert symmetric_rmse_m(a, b) == symmetric_rmse_m(b, a)


@given(clouds, st.randoms(use_true_random=False))
def test_rmse_of_a_cloud_with_itself_is_zero(cloud: np.ndarray, random: object) -> None:
    order = list(range(len(cloud)))
    random.shuffle(order)  # type: ignore[attr-defined]
    assert symmetric_rmse_m(cloud, cloud[order]) == 0.0
    assert symmetric_rmse_m(cloud, np.concatenate([cloud, cloud])) == 0.0


@settings(max_examples=50)
@given(clouds, clouds, npst.arrays(np.float64, 6, elements=st.floats(-3.0, 3.0)))
def test_rmse_does_not_change_with_the_frame(a: np.ndarray, b: np.ndarray, motion: np.ndarray) -> None:
    rotation, shift = Rotation.from_rotvec(motion[:3]), motion[3:]
    moved = symmetric_rmse_m(rotation.apply(a) + shift, rotation.apply(b) + shift)
    assert moved == pytest.approx(symmetric_rmse_m(a, b), abs=1e-9)


@given(clouds, st.floats(0.0, 0.4))
def test_rmse_of_a_far_shift_is_bounded_by_it(cloud: np.ndarray, shift: float) -> None:
    assert symmetric_rmse_m(cloud, cloud + np.array([0.0, 0.0, shift])) <= shift * (1 + 1e-12) + 1e-15


def test_rmse_is_that_of_open3d() -> None:
    o3d = pytest.importorskip("open3d", reason="open3d is not installed", exc_type=ImportError)
    rng = np.random.default_rng(3)
    first, second = rng.normal(size=(300, 3)), rng.normal(size=(200, 3))
    a, b = (o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (first, second))
    forth = np.asarray(a.compute_point_cloud_distance(b))
    back = np.asarray(b.compute_point_cloud_distance(a))
    expected = (np.sqrt(np.mean(forth**2)) + np.sqrt(np.mean(back**2))) / 2
    assert symmetric_rmse_m(first, second) == pytest.approx(expected, rel=1e-12)


# --- patch against truth ---------------------------------------------------------------------------


def make_truth() -> GroundTruth:
    contact = np.zeros((4, 6), bool)
    contact[1, 2:5] = contact[3, 0] = True
    depth_m = np.linspace(0.2, 0.3, 24, dtype=np.float32).reshape(4, 6)
    depth_m[1, 3] = np.nan
    return GroundTruth(contact, depth_m)


def make_patch(mask: np.ndarray, points: np.ndarray) -> ContactPatch:
    provenance = np.where(mask, Provenance.CONTACT, Provenance.OUTSIDE_TOLERANCE).astype(np.uint8)
    nothing = np.full(mask.shape, np.nan, np.float32)
    return ContactPatch(0, points, provenance, AlignedDepth(nothing, nothing), RIG, {})


def test_the_true_cloud_is_the_true_depth_on_contact_pixels() -> None:
    truth = make_truth()
    assert truth.depth_m is not None
    pixels = [(2, 1), (4, 1), (0, 3)]
    depths = np.array([truth.depth_m[v, u] for u, v in pixels])
    expected = np.column_stack([LENS.normalise(pixels), np.ones(3)]) * depths[:, None]
    cloud = truth_cloud(truth, RIG)
    assert cloud.points.dtype == np.float32
    np.testing.assert_allclose(cloud.points, expected, rtol=1e-6)


def test_truth_without_depth_has_no_cloud() -> None:
    truth = GroundTruth(np.ones((4, 6), bool))
    assert truth_cloud(truth, RIG).points.shape == (0, 3)
    scores = compare_with_truth(make_patch(truth.contact, np.ones((24, 3), np.float32)), truth, RIG)
    assert scores["iou"] == 1.0
    assert math.isnan(scores["rmse_mm"])


def test_a_patch_is_scored_in_pixels_and_millimetres() -> None:
    truth = make_truth()
    cloud = truth_cloud(truth, RIG).points
    mask = truth.contact.copy()
    mask[3, 0] = False
    mask[0, 0:2] = True
    far = cloud + np.float32([0.0, 0.0, 0.004])
    scores = compare_with_truth(make_patch(mask, far), truth, RIG)
    assert scores == {
        "iou": 3 / 6,
        "precision": 3 / 5,
        "recall": 3 / 4,
        "rmse_mm": pytest.approx(1e3 * brute_force_rmse(far.astype(float), cloud.astype(float))),
    }
    assert scores["rmse_mm"] == pytest.approx(4.0, rel=1e-4)
