"""Fits of both models: right, as good as theory allows, robust against wrong pairs, and refused where nothing fits."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulated_clicks import ClickNoise, alignment_covariance, cramer_rao, expected_length, judged_places, make_clicks
from tactune.core.calibration.geometry import mapped
from tactune.core.calibration.robust_fit import fit_homography, fit_rigid
from tactune.core.errors import CalibrationError
from tactune.core.model.frames import ColorCamera
from tactune.core.model.intrinsics import Distortion

CLEAN = ClickNoise(0.0, 0.0, 0.0)


# Homography


@pytest.mark.parametrize("count", [4, 5, 12, 300])
def test_clean_points_give_the_homography(plane, rig, count):
    for H in (plane.mild, plane.strong):
        fit = fit_homography(plane.clicks(count, count, H, sigma=0.0), rig)
        assert plane.error(fit, H).max() < 1e-6


def line(count, scatter):
    along = np.linspace(0, 500, count)
    return np.column_stack([along, 0.4 * along + scatter * np.random.default_rng(0).standard_normal(count)])


@pytest.mark.parametrize(
    ("tactile", "words"),
    [
        (line(8, 1e-3), "on one line"),
        (np.vstack([line(3, 0.0), [[300.0, 20.0]]]), "line"),
        (np.vstack([line(9, 1e-4), [[300.0, 20.0]]]), "line|agree"),
        (np.repeat([[0.0, 0], [100, 0], [0, 100]], 3, axis=0), "line|agree"),
        (line(3, 1.0), "at least 4"),
    ],
)
def test_points_that_determine_nothing_are_refused(plane, rig, tactile, words):
    with pytest.raises(CalibrationError, match=words):
        fit_homography(plane.points(tactile, mapped(plane.mild, tactile)), rig)


def test_a_mirrored_image_is_refused(plane, rig):
    points = plane.clicks(0, 8)
    points.proximity[:, 0] = 640 - points.proximity[:, 0]
    with pytest.raises(CalibrationError, match="mirrored"):
        fit_homography(points, rig)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(4, 40))
def test_the_answer_is_right_or_refused(plane, rig, seed, count):
    rng = np.random.default_rng(seed)
    H = np.eye(3) + rng.uniform(-1, 1, (3, 3)) * [[0.3, 0.3, 100], [0.3, 0.3, 100], [3e-4, 3e-4, 0]]
    tactile = rng.uniform((0, 0), (640, 480), (count, 2))
    proximity = mapped(H, tactile)
    try:
        fit = fit_homography(plane.points(tactile, proximity), rig)
    except CalibrationError:
        return
    assert np.abs(mapped(fit.alignment.homography, tactile) - proximity)[fit.inliers].max() < 1e-4


# Rigid


def distorted(rig, model):
    bent = {"distortion": model, "coefficients": (0.12, -0.05, 0.002, -0.001, 0.01)}
    color = rig.proximity_color
    return rig.model_copy(
        update={
            "tactile": rig.tactile.model_copy(update={"intrinsics": rig.tactile.intrinsics.model_copy(update=bent)}),
            "proximity_color": ColorCamera(
                intrinsics=color.intrinsics.model_copy(update=bent), T_color_depth=color.T_color_depth
            ),
        }
    )


@pytest.mark.parametrize("model", [Distortion.NONE, Distortion.BROWN_CONRADY, Distortion.MODIFIED_BROWN_CONRADY])
@pytest.mark.parametrize("color_share", [0.0, 0.5, 1.0])
def test_clean_clicks_give_the_pose(rig, model, color_share):
    bent = distorted(rig, model)
    fit = fit_rigid(make_clicks(bent, 8, 0, CLEAN, color_share).noisy, bent)
    assert np.abs(fit.alignment.pose - np.array(rig.T_proximity_tactile)).max() < 1e-6
    assert np.abs(fit.residuals_px).max() < 1e-3


def test_twelve_clicks_reach_the_cramer_rao_bound(rig):
    noise, (places, true) = ClickNoise(), judged_places(rig)
    errors, bounds = [], []
    for seed in range(24):
        clicks = make_clicks(rig, 12, seed, noise, color_share=0.3)
        errors.append(np.hypot(*(fit_rigid(clicks.noisy, rig).predict(places) - true).T).mean())
        if seed % 4 == 0:
            covariance = alignment_covariance(cramer_rao(clicks.true, rig, noise), places, rig)
            bounds.append(expected_length(covariance))
    assert np.mean(errors) < 1.10 * np.mean(bounds)


@pytest.fixture(params=["plane", "rigid"])
def wrong_clicks(request, plane, rig):
    """Return a function that gives clicks, which of them noise alone could have moved, and their fit."""

    def of_plane(seed, count, wrong):
        points = plane.clicks(seed, count, wrong=wrong)
        return plane.right(points), lambda: fit_homography(points, rig)

    def of_space(seed, count, wrong):
        clicks = make_clicks(rig, count, seed, wrong=wrong, color_share=0.5)
        away = np.hypot(*(clicks.noisy.proximity - clicks.true.proximity).T)
        return away < 8.0, lambda: fit_rigid(clicks.noisy, rig)

    return of_plane if request.param == "plane" else of_space


@pytest.mark.parametrize("count", [10, 30])
def test_30_percent_wrong_pairs_are_found(wrong_clicks, count):
    for seed in range(4):
        right, fitted = wrong_clicks(seed, count, 0.3)
        fit = fitted()
        assert not (fit.inliers & ~right).any()
        assert fit.inliers.sum() >= 0.65 * count


@pytest.mark.parametrize("wrong", [0.6, 1.0])
@pytest.mark.parametrize("count", [8, 25])
def test_mostly_wrong_pairs_are_never_silently_used(wrong_clicks, count, wrong):
    right, fitted = wrong_clicks(0, count, wrong)
    try:
        used = fitted().inliers
    except CalibrationError:
        return
    assert not (used & ~right).any()


@settings(max_examples=12, deadline=None)
@given(offset_m=st.floats(-0.01, 0.01), seed=st.integers(0, 50))
def test_an_offset_of_the_depth_is_recovered(rig, offset_m, seed):
    points = make_clicks(rig, 40, seed, CLEAN, color_share=0.5).noisy
    points = replace(points, tactile_depth_m=points.tactile_depth_m - offset_m)
    assert fit_rigid(points, rig, offset=True).alignment.offset_m == pytest.approx(offset_m, abs=1e-3)


def test_points_on_a_line_in_space_and_too_few_are_refused(rig):
    points = make_clicks(rig, 8, 0, CLEAN).noisy
    tactile = np.array([100.0, 100.0]) + np.linspace(0, 1, 8)[:, None] * [300.0, 200.0]
    with pytest.raises(CalibrationError, match="line"):
        fit_rigid(replace(points, tactile=tactile, tactile_depth_m=np.full(8, 0.3)), rig)
    with pytest.raises(CalibrationError, match="at least 4"):
        fit_rigid(points.keep(np.arange(8) < 3), rig)
