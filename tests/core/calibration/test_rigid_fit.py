from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulated_clicks import (
    ClickNoise,
    alignment_covariance,
    cramer_rao,
    expected_length,
    judged_places,
    make_clicks,
)
from tactune.core.calibration.agreement import judge_agreement
from tactune.core.calibration.depth_advice import advise_depth_fit
from tactune.core.calibration.quality import bound
from tactune.core.calibration.rigid import RigidPoints, fit_rigid
from tactune.core.errors import CalibrationError
from tactune.core.model.frames import ColorCamera
from tactune.core.model.intrinsics import Distortion

CLEAN = ClickNoise(0.0, 0.0, 0.0)


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
    assert np.abs(fit.T_proximity_tactile - np.array(rig.T_proximity_tactile)).max() < 1e-8
    assert np.abs(fit.residuals_px).max() < 1e-4


def test_twelve_clicks_reach_the_cramer_rao_bound(rig):
    noise, (places, true) = ClickNoise(), judged_places(rig)
    errors, bounds = [], []
    for seed in range(80):
        clicks = make_clicks(rig, 12, seed, noise, color_share=0.3)
        errors.append(np.hypot(*(fit_rigid(clicks.noisy, rig).predict(places) - true).T).mean())
        if seed % 4 == 0:
            covariance = alignment_covariance(cramer_rao(clicks.true, rig, noise), places, rig)
            bounds.append(expected_length(covariance))
    assert np.mean(errors) < 1.10 * np.mean(bounds)


def test_doubtful_pairs_stay_so_where_the_depth_is_corrected(rig):
    clicks = make_clicks(rig, 6, 1).noisy
    clicks.proximity[2] += (8.0, -6.0)
    fit = fit_rigid(clicks, rig, depth_fit="offset")
    assert fit.doubtful or not fit.used.all()
    assert fit.rivals_px(clicks.places).shape[2] > 0


@pytest.mark.long
def test_the_95_percent_bound_holds_in_95_percent_of_trials(rig):
    places, true = (side[::17] for side in judged_places(rig))
    whole = []
    for seed in range(600):
        fit = fit_rigid(make_clicks(rig, 10, seed, color_share=0.5).noisy, rig)
        derivative, error = fit.sensitivity(places), np.hypot(*(fit.predict(places) - true).T)
        whole.append(np.sqrt(np.mean(error**2)) <= bound(derivative, fit.degrees))
    assert 0.93 <= np.mean(whole) <= 0.97


@pytest.mark.parametrize("count", [10, 30])
def test_30_percent_wrong_pairs_are_found(rig, count):
    for seed in range(4):
        clicks = make_clicks(rig, count, seed, wrong=0.3, color_share=0.5)
        fit = fit_rigid(clicks.noisy, rig)
        assert not (fit.used & ~right(clicks)).any()
        assert fit.used.sum() >= 0.65 * count


@pytest.mark.parametrize("wrong", [0.6, 1.0])
@pytest.mark.parametrize("count", [8, 20, 50])
def test_mostly_wrong_pairs_are_never_silently_used(rig, count, wrong):
    for seed in range(3):
        clicks = make_clicks(rig, count, seed, wrong=wrong)
        try:
            fit = fit_rigid(clicks.noisy, rig)
        except CalibrationError as error:
            assert "agree" in str(error)
        else:
            assert not (fit.used & ~right(clicks)).any()


def right(clicks):
    """Pairs that noise alone could have moved."""
    return np.hypot(*(clicks.noisy.proximity - clicks.true.proximity).T) < 8.0


def biased(points, scale, offset_m):
    return replace(points, tactile_depth_m=(points.tactile_depth_m - offset_m) / scale)


def test_a_depth_bias_is_recovered_from_the_stated_baseline(rig):
    clicks = make_clicks(rig, 14, 3, CLEAN, color_share=0.5)
    fit = fit_rigid(biased(clicks.noisy, 1.02, 0.003), rig, depth_fit="both")
    assert fit.pose.scale == pytest.approx(1.02, abs=1e-3)
    assert fit.pose.offset_m == pytest.approx(0.003, abs=5e-4)
    assert np.abs(fit.T_proximity_tactile - np.array(rig.T_proximity_tactile)).max() < 1e-4


def test_proximity_depth_at_contact_measures_the_scale_without_a_stated_pose(rig):
    unknown = rig.model_copy(update={"T_proximity_tactile": None})
    clicks = make_clicks(rig, 20, 4)
    depth = np.linalg.inv(np.array(rig.T_proximity_tactile))
    rays = np.column_stack([rig.tactile.intrinsics.normalise(clicks.true.tactile), np.ones(20)])
    points = (rays * clicks.true.tactile_depth_m[:, None] - depth[:3, 3]) @ depth[:3, :3]
    noise = 0.001 * np.random.default_rng(0).standard_normal(20)
    measured = biased(replace(clicks.noisy, proximity_depth_m=points[:, 2] + noise), 1.03, 0.002)
    fit = fit_rigid(measured, unknown, depth_fit="both")
    sigma = np.sqrt(np.diag(fit.covariance))
    assert abs(fit.pose.scale - 1.03) < 4 * sigma[6]
    corrected = fit.pose.scale * measured.tactile_depth_m + fit.pose.offset_m
    assert np.abs(corrected - clicks.true.tactile_depth_m).max() < 0.003


def test_the_noise_expected_of_clicks_does_not_depend_on_a_fitted_depth(rig):
    points = make_clicks(rig, 30, 5, ClickNoise(0.1, 0.1, 0.0001)).noisy
    expected = []
    for depth_fit in ("none", "offset", "both"):
        fit = fit_rigid(points, rig, depth_fit=depth_fit)
        assert 0.1 < fit.noise_factor < 0.3
        expected.append(judge_agreement(fit, points.places, points.places, rig).expected_px)
    assert expected[1:] == pytest.approx([expected[0]] * 2, rel=0.2)


@settings(max_examples=12, deadline=None)
@given(amount=st.floats(-1.0, 1.0), only=st.sampled_from(["offset", "scale"]), seed=st.integers(0, 50))
def test_an_offset_or_a_scale_alone_is_recovered(rig, amount, only, seed):
    scale, offset_m = (1.0, 0.01 * amount) if only == "offset" else (1.0 + 0.04 * amount, 0.0)
    points = biased(make_clicks(rig, 40, seed, CLEAN, color_share=0.5).noisy, scale, offset_m)
    pose = fit_rigid(points, rig, depth_fit=only).pose
    assert pose.scale == pytest.approx(scale, abs=1e-3)
    assert pose.offset_m == pytest.approx(offset_m, abs=1e-3)
    assert (pose.scale == 1.0) if only == "offset" else (pose.offset_m == 0.0)


@pytest.mark.parametrize(("offset_m", "advised"), [(0.0, "none"), (0.015, "offset")])
def test_an_offset_is_recommended_only_if_it_is_certain(rig, offset_m, advised):
    noise = ClickNoise(0.07, 0.07, 0.0003)
    for seed in range(4):
        points = biased(make_clicks(rig, 150, seed, noise, color_share=0.5).noisy, 1.0, offset_m)
        u, v = points.tactile.T
        shared = 0.0005 * np.sin(u / 60 + seed) * np.sin(v / 60 + seed)  # neighbours share errors of the depth
        points = replace(points, tactile_depth_m=points.tactile_depth_m + shared)
        advice = advise_depth_fit(points, rig)
        assert advice.depth_fit == advised, advice.reason
        assert "mm" in advice.reason and "times its standard error" in advice.reason


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p.keep_first(3), "at least 4"),
        (lambda p: replace(p, tactile_depth_m=-p.tactile_depth_m), "above 0"),
        (lambda p: replace(p, tactile_depth_m=p.tactile_depth_m * np.nan), "finite"),
    ],
)
def test_unusable_points_are_refused(rig, change, words):
    points = make_clicks(rig, 8, 0).noisy
    with pytest.raises(CalibrationError, match=words):
        fit_rigid(change(Cut(**vars(points))), rig)


class Cut(RigidPoints):
    def keep_first(self, count):
        return RigidPoints(**{name: values[:count] for name, values in vars(self).items()})


def test_points_on_a_line_in_space_are_refused(rig):
    points = make_clicks(rig, 8, 0, CLEAN).noisy
    along = np.linspace(0, 1, 8)[:, None]
    tactile = np.array([100.0, 100.0]) + along * [300.0, 200.0]
    with pytest.raises(CalibrationError, match="line"):
        fit_rigid(replace(points, tactile=tactile, tactile_depth_m=np.full(8, 0.3)), rig)
