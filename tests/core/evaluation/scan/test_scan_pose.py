"""The pose of a scan: from point pairs, by ICP, and as a file."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tactune.core.errors import CalibrationError, SourceError
from tactune.core.evaluation.scan.pose import (
    load_transform,
    pair_errors_m,
    pose_from_pairs,
    read_pairs,
    refine_pose,
    save_transform,
    transformed,
)

HEADER = "scan_x,scan_y,scan_z,patch_x_m,patch_y_m,patch_z_m\n"


def random_pose(random, angle=np.pi, shift=0.5):
    pose = np.eye(4)
    axis = random.normal(size=3)
    pose[:3, :3] = Rotation.from_rotvec(axis / np.linalg.norm(axis) * random.uniform(0, angle)).as_matrix()
    pose[:3, 3] = random.uniform(-shift, shift, 3)
    return pose


def saddle(random, count):
    """A patch with an outline and curvature that leave no turn open."""
    x, y = random.uniform(-0.03, 0.03, count), random.uniform(-0.018, 0.018, count)
    x, y = x[inside := (y < 0.01) | (x < 0)], y[inside]
    return np.column_stack([x, y, 6 * x**2 - 9 * y**2 + 60 * x**3])


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(3, 12))
@settings(max_examples=60, deadline=None)
def test_exact_pairs_give_the_exact_pose(seed, count):
    random = np.random.default_rng(seed)
    true, scan = random_pose(random), random.uniform(-0.1, 0.1, (count, 3))
    patch = transformed(true, scan)
    spread = np.linalg.svd(scan - scan.mean(axis=0), compute_uv=False)
    if spread[1] < 0.05 * spread[0]:
        return
    found = pose_from_pairs(scan, patch)
    np.testing.assert_allclose(found, true, atol=1e-9)
    np.testing.assert_allclose(pair_errors_m(found, scan, patch), 0, atol=1e-9)
    order = random.permutation(count)
    np.testing.assert_allclose(pose_from_pairs(scan[order], patch[order]), found, atol=1e-12)
    other = random_pose(random)
    np.testing.assert_allclose(
        pose_from_pairs(transformed(other, scan), patch), found @ np.linalg.inv(other), atol=1e-9
    )


def test_mirrored_points_still_give_a_rotation():
    scan = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    found = np.array(pose_from_pairs(scan, scan * [1, 1, -1]))
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1)


def test_noisy_pairs_are_fitted_by_least_squares():
    random = np.random.default_rng(8)
    scan = random.uniform(-0.05, 0.05, (6, 3))
    patch = transformed(random_pose(random), scan) + random.normal(0, 0.002, (6, 3))
    found = pose_from_pairs(scan, patch)
    least = np.sum(pair_errors_m(found, scan, patch) ** 2)
    for _ in range(200):
        near = np.array(found) @ random_pose(random, 0.02, 0.001)
        assert np.sum(pair_errors_m(near, scan, patch) ** 2) > least


@pytest.mark.parametrize(
    "scan, words",
    [
        ([[0, 0, 0], [0.1, 0, 0]], "at least 3 pairs"),
        ([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]], "on one line"),
        ([[0, 0, 0], [0.1, 0.1, 0.1], [0.2, 0.2, 0.2], [0.05, 0.05, 0.0501]], "on one line"),
        ([[0.1, 0, 0]] * 3, "at one place"),
        ([[0, 0, 0], [0.1, 0, 0], [np.nan, 0.1, 0]], "nan"),
        ([[0, 0], [0.1, 0], [0, 0.1]], "no pairs"),
    ],
)
def test_points_that_fix_no_pose_are_refused(scan, words):
    with pytest.raises(CalibrationError, match=words):
        pose_from_pairs(scan, scan)


def test_another_unit_and_unequal_numbers_are_refused():
    corner = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
    with pytest.raises(CalibrationError, match="unit"):
        pose_from_pairs(1000 * corner, corner)
    with pytest.raises(CalibrationError, match="no pairs"):
        pose_from_pairs(corner, corner[:2])


def corner(random, count):
    """Points on the three faces of a corner, 30 mm long."""
    points = random.uniform(0, 0.03, (count, 3))
    points[np.arange(count), np.arange(count) % 3] = 0
    return points


@pytest.mark.parametrize("seed", range(3))
def test_icp_comes_near_the_pose_where_clouds_overlap_in_part(seed):
    random = np.random.default_rng(seed)
    true, scan, patch = random_pose(random), corner(random, 3000), corner(random, 3000)
    scan, patch = scan[scan[:, 0] < 0.025], patch[patch[:, 1] < 0.026]
    false_contact = random.uniform(0, 0.03, (150, 3)) + np.array([0, 0, 0.004])
    patch = transformed(true, np.concatenate([patch, false_contact]))
    start = true @ random_pose(random, 0.05, 0.003)

    def worst(pose):
        return np.linalg.norm(transformed(pose, scan) - transformed(true, scan), axis=1).max()

    assert worst(start) > 2e-3
    assert worst(refine_pose(scan, patch, start).T_proximity_scan) < 2e-3


def test_pairs_of_both_ways_centre_contact_in_a_larger_patch():
    """One way, every contact point has a patch point beside it wherever it lies on a plane."""
    random = np.random.default_rng(4)
    flat = np.column_stack([random.uniform(-0.02, 0.02, (4000, 2)), np.zeros(4000)])
    inside = np.abs(flat[:, :2]).max(axis=1) < 0.017
    start = np.eye(4)
    start[:3, 3] = 0.002, -0.001, 0.001
    shifts = [
        np.array(refine_pose(flat[inside], flat[::2], start, both_ways=both).T_proximity_scan)[:3, 3]
        for both in (True, False)
    ]
    assert np.linalg.norm(shifts[0]) < 3e-4
    assert np.linalg.norm(shifts[1]) > 1e-3


@pytest.mark.parametrize("farthest_m", [0.004, 0.02])
def test_icp_agrees_with_open3d(farthest_m):
    open3d = pytest.importorskip("open3d")
    random = np.random.default_rng(5)
    true, scan = random_pose(random), saddle(random, 3000)
    patch = transformed(true, saddle(random, 2500))
    start = np.array(true) @ random_pose(random, 0.05, 0.002)
    found = refine_pose(scan, patch, start, both_ways=False, farthest_m=farthest_m, most_iterations=1000)
    clouds = [open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points)) for points in (scan, patch)]
    theirs = open3d.pipelines.registration.registration_icp(
        *clouds, farthest_m, start, open3d.pipelines.registration.TransformationEstimationPointToPoint(),
        open3d.pipelines.registration.ICPConvergenceCriteria(1e-14, 1e-14, 1000),
    )  # fmt: skip
    assert found.converged
    np.testing.assert_allclose(found.T_proximity_scan, theirs.transformation, atol=1e-6)
    assert found.rmse_m == pytest.approx(theirs.inlier_rmse, rel=1e-5)
    assert found.pairs / len(scan) == pytest.approx(theirs.fitness)


def test_icp_can_be_watched_and_stopped():
    random = np.random.default_rng(1)
    scan, start, told = saddle(random, 2000), random_pose(random, 0.05, 0.002), []

    def go_on(rounds, rmse_m):
        told.append((rounds, rmse_m))
        return rounds < 3

    found = refine_pose(scan, scan, start, go_on=go_on)
    assert [rounds for rounds, _ in told] == [0, 1, 2, 3]
    assert told[-1][1] < told[0][1]
    assert (found.iterations, found.converged) == (3, False) and found.rmse_m == told[-1][1]
    assert not np.allclose(found.T_proximity_scan, start)


def test_icp_refuses_what_it_cannot_do():
    points = saddle(np.random.default_rng(0), 500)
    for clouds, words in (
        ((points[:0], points), "scan's contact has 0 points"),
        ((points, points[:2]), "the patch has 2 points"),
        ((points, points + np.array([0, 0, 0.5])), "nowhere within 10 mm"),
        ((points * np.nan, points), "nan"),
    ):
        with pytest.raises(CalibrationError, match=words):
            refine_pose(*clouds, np.eye(4))
    for wrong in ({"farthest_m": -1.0}, {"most_iterations": 0}):
        with pytest.raises(CalibrationError, match="ICP needs"):
            refine_pose(points, points, np.eye(4), **wrong)


def test_a_transform_survives_its_file_bit_for_bit(tmp_path):
    scan = np.random.default_rng(2).uniform(-0.1, 0.1, (5, 3))
    pose = pose_from_pairs(scan, scan[:, [1, 2, 0]] + 0.3)
    save_transform(tmp_path / "scan.json", pose)
    assert load_transform(tmp_path / "scan.json") == pose
    assert json.loads((tmp_path / "scan.json").read_text()) == {"T_proximity_scan": [list(row) for row in pose]}
    (tmp_path / "scan.txt").write_text("\n".join(" ".join(map(repr, row)) for row in pose))
    assert load_transform(tmp_path / "scan.txt") == pose


@pytest.mark.parametrize(
    "text",
    ["", "{}", "[]", '{"T_proximity_scan": 3}', '{"T_proximity_scan": null}', "1 0 0 0\n0 1 0 0\n0 0 1 0", "a b c d",
     "2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1", "1 0 0 300\n0 1 0 0\n0 0 1 0\n0 0 0 1",
     "1 0 0 nan\n0 1 0 0\n0 0 1 0\n0 0 0 1",
     '{"T_proximity_scan": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "more": 1}', "{" * 5000, "\xff" * 9,
     '{"T_proximity_scan": [[1, 2], [3]]}']
)  # fmt: skip
def test_a_file_that_holds_no_pose_is_refused(tmp_path, text):
    path = tmp_path / "scan.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(SourceError, match="holds no pose") as caught:
        load_transform(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("-1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1", "mirrors, which no rotation does"),
        ("1 0 0 0\n\n0 1 0 x\n0 0 1 0\n0 0 0 1", "line 3 is '0 1 0 x', not four numbers"),
        ('{"T_proximity_scan":\n [[1, 0', r"not valid JSON \(line 2"),
    ],
)
def test_what_is_wrong_with_a_pose_is_said(tmp_path, text, words):
    (tmp_path / "scan.json").write_text(text)
    with pytest.raises(SourceError, match=words):
        load_transform(tmp_path / "scan.json")


def test_pairs_of_a_file(tmp_path):
    path = tmp_path / "pairs.csv"
    path.write_text(HEADER + "1,2,3,0.1,0.2,0.3\n\n4,5,6,0.4,0.5,0.6\n")
    scan, patch = read_pairs(path, 0.001)
    np.testing.assert_allclose(scan, [[0.001, 0.002, 0.003], [0.004, 0.005, 0.006]])
    np.testing.assert_allclose(patch, [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "header"),
        ("a,b\n", "header"),
        (HEADER + "1,2,3\n", "line 2"),
        (HEADER + "1,2,3,4,5,6\n\n1,2,3,4,5,nan\n", "line 4"),
    ],
)
def test_a_file_that_holds_no_pairs_is_refused(tmp_path, text, words):
    (tmp_path / "pairs.csv").write_text(text)
    with pytest.raises(SourceError, match=words):
        read_pairs(tmp_path / "pairs.csv")
    with pytest.raises(SourceError, match="check the path"):
        read_pairs(tmp_path / "none.csv")
