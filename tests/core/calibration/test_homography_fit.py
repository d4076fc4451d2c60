from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulated_clicks import normalised_transform
from tactune.core.calibration.homography import direct_linear_transform, fit_homography
from tactune.core.calibration.quality import bound
from tactune.core.errors import CalibrationError


@pytest.mark.parametrize("count", [4, 5, 12, 300])
def test_clean_points_give_the_homography_to_1e_9(plane, count):
    for H in (plane.mild, plane.strong):
        fit = fit_homography(*plane.clicks(count, count, H, sigma=0.0))
        assert np.abs(fit.H_p_t - H).max() < 1e-9
        assert plane.error(fit, H).max() < 1e-9


@pytest.mark.parametrize(("count", "seeds"), [(20, 60), pytest.param(8, 250, marks=pytest.mark.long)])
def test_noise_costs_no_more_than_with_opencvs_refinement(plane, count, seeds):
    ours, theirs = {}, {}
    for name, H in (("mild", plane.mild), ("strong", plane.strong)):
        errors = np.empty((seeds, 2))
        for seed in range(seeds):
            tactile, proximity = plane.clicks(seed, count, H)
            errors[seed, 0] = plane.error(fit_homography(tactile, proximity), H).mean()
            refined, _ = cv2.findHomography(tactile, proximity, 0)
            errors[seed, 1] = np.hypot(*(plane.transfer(refined, plane.grid) - plane.transfer(H, plane.grid)).T).mean()
        ours[name], theirs[name] = errors.mean(axis=0)
    assert ours["mild"] < 1.005 * theirs["mild"]
    assert ours["strong"] < 1.005 * theirs["strong"]


@pytest.mark.long
def test_the_95_percent_bound_holds_in_95_percent_of_trials(plane):
    whole = []
    places = plane.grid[::5]
    for seed in range(600):
        fit = fit_homography(*plane.clicks(seed, 10))
        derivative, error = fit.sensitivity(places), plane.error(fit, places=places)
        whole.append(np.sqrt(np.mean(error**2)) <= bound(derivative, fit.degrees))
    assert 0.93 <= np.mean(whole) <= 0.97


@pytest.mark.parametrize("count", [10, 14, 30])
def test_30_percent_wrong_pairs_are_found(plane, count):
    for seed in range(5):
        tactile, proximity = plane.clicks(seed, count, wrong=0.3)
        right = plane.right(tactile, proximity)
        fit = fit_homography(tactile, proximity)
        assert not (fit.used & ~right).any()
        assert fit.used.sum() >= 0.65 * count


@pytest.mark.parametrize("wrong", [0.6, 1.0])
@pytest.mark.parametrize("count", [6, 10, 25, 60])
def test_mostly_wrong_pairs_are_never_silently_used(plane, count, wrong):
    for seed in range(4):
        tactile, proximity = plane.clicks(seed, count, wrong=wrong)
        try:
            fit = fit_homography(tactile, proximity)
        except CalibrationError as error:
            assert "agree" in str(error) or "mirrored" in str(error)
        else:
            assert not (fit.used & ~plane.right(tactile, proximity)).any()


def test_one_wrong_pair_of_many_is_named(plane):
    tactile, proximity = plane.clicks(0, 20)
    proximity[7] += 25.0
    assert np.flatnonzero(~fit_homography(tactile, proximity).used).tolist() == [7]


@pytest.mark.parametrize(("count", "least"), [(6, 12), (8, 18)])
def test_few_pairs_with_a_click_15_px_off_are_named_and_never_falsely_certain(plane, count, least):
    named = 0
    for seed in range(20):
        tactile, proximity = plane.clicks(seed, count)
        proximity[2] += (12.0, -9.0)
        fit = fit_homography(tactile, proximity)
        named += 2 in {*np.flatnonzero(~fit.used), *fit.doubtful}
        spread = np.concatenate([fit.sensitivity(plane.grid), fit.rivals_px(plane.grid)], axis=2)
        stated = np.sqrt((spread**2).sum(axis=(1, 2)).mean())
        assert stated > 1.5 or np.sqrt(np.mean(plane.error(fit) ** 2)) < 5.0
    assert named >= least


@pytest.mark.parametrize("offset", [0.0, 1e6])
@pytest.mark.parametrize("count", [4, 9, 10_000])
def test_offsets_and_counts_do_not_matter(plane, count, offset):
    tactile, proximity = plane.clicks(1, count, sigma=0.0)
    fit = fit_homography(tactile + offset, proximity + offset)
    error = np.abs(fit.predict(tactile + offset) - (proximity + offset)).max()
    assert error < 1e-9 * max(offset, 640)
    assert fit.condition < 100


def test_float32_input_is_fitted_in_float64(plane):
    tactile, proximity = plane.clicks(2, 12, sigma=0.0)
    fit = fit_homography(tactile.astype(np.float32), proximity.astype(np.float32))
    assert plane.error(fit).max() < 1e-3


def test_normalisation_saves_what_plain_dlt_loses(plane):
    tactile, proximity = plane.clicks(3, 6, sigma=0.0)
    tactile, proximity = tactile + 1e6, proximity + 1e6
    plain = np.abs(plane.transfer(direct_linear_transform(tactile, proximity), tactile) - proximity).max()
    normalised = np.abs(plane.transfer(normalised_transform(tactile, proximity), tactile) - proximity).max()
    assert normalised < 1e-6
    assert plain > 1e-3


def line(count, scatter):
    along = np.linspace(0, 500, count)
    return np.column_stack([along, 0.4 * along + scatter * np.random.default_rng(0).standard_normal(count)])


@pytest.mark.parametrize(
    ("tactile", "words"),
    [
        (line(8, 0.0), "on one line"),
        (line(8, 1e-3), "on one line"),
        (np.vstack([line(3, 0.0), [[300.0, 20.0]]]), "lie"),
        (np.vstack([line(3, 1e-3), [[300.0, 20.0]]]), "lie"),
        (np.vstack([line(9, 1e-4), [[300.0, 20.0]]]), "lie"),
        (np.repeat([[0.0, 0], [100, 0], [0, 100], [100, 100]], [3, 3, 3, 0], axis=0), "differ"),
        (np.zeros((5, 2)), "differ"),
        (line(3, 1.0), "at least 4"),
        (np.array([[0.0, 0], [100, 0], [0, 100], [np.nan, 100]]), "finite"),
    ],
)
def test_points_that_determine_nothing_are_refused(plane, tactile, words):
    with pytest.raises(CalibrationError, match=words):
        fit_homography(tactile, plane.transfer(plane.mild, tactile))


def test_a_mirrored_image_is_refused_as_such(plane):
    tactile, proximity = plane.clicks(0, 8)
    proximity[:, 0] = 640 - proximity[:, 0]
    with pytest.raises(CalibrationError, match="mirrored"):
        fit_homography(tactile, proximity)


def test_two_swapped_partners_of_four_are_refused(plane):
    corners = np.array([[50.0, 50], [550, 60], [560, 400], [40, 420]])
    proximity = plane.transfer(plane.mild, corners)
    with pytest.raises(CalibrationError, match="swapped"):
        fit_homography(corners, proximity[[1, 0, 2, 3]])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(4, 40), st.floats(0, 1))
def test_the_answer_is_right_or_refused(seed, count, squeeze):
    rng = np.random.default_rng(seed)
    H = np.eye(3) + rng.uniform(-1, 1, (3, 3)) * [[0.3, 0.3, 100], [0.3, 0.3, 100], [3e-4, 3e-4, 0]]
    tactile = rng.uniform((0, 0), (640, 480), (count, 2)) * [1.0, 10 ** (-6 * squeeze)]
    mapped = np.column_stack([tactile, np.ones(count)]) @ H.T
    proximity = mapped[:, :2] / mapped[:, 2:]
    try:
        fit = fit_homography(tactile, proximity)
    except CalibrationError:
        return
    assert np.abs(fit.predict(tactile) - proximity)[fit.used].max() < 1e-6
