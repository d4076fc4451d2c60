from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from simulated_clicks import ClickNoise, judged_places, make_clicks
from tactune.core.calibration import Correspondence, calibrate
from tactune.core.calibration.quality import PROXIMITY_NOISE_M, TACTILE_NOISE_M, patch_effect
from tactune.core.calibration.recheck import replacement
from tactune.core.calibration.report import place_name
from tactune.core.calibration.rigid import MIN_POINTS
from tactune.core.contact import pipeline as pipeline_module
from tactune.core.contact.alignment import make_alignment
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import CalibrationError
from tactune.core.preset import Preset
from tactune.core.preset.file import preset_from_text, preset_json

CLEAN = ClickNoise(0.0, 0.0, 0.0)


def clicked(rig, count=12, seed=0, **options):
    return make_clicks(rig, count, seed, **options).correspondences()


@pytest.fixture(scope="module")
def usual(rig):
    """The calibration from twelve usual clicks."""
    return calibrate(clicked(rig), rig)


def test_points_that_span_depth_make_it_recommend_rigid(rig):
    report = calibrate(clicked(rig, color_share=0.5), rig)
    assert (report.model, report.recommended) == ("rigid", "rigid")
    assert "mm of depth" in report.reason
    plane, rigid = report.quality["homography"], report.quality["rigid"]
    assert rigid.cross_validated_px < 0.6 * plane.cross_validated_px
    assert plane.excluded == rigid.excluded == ()
    assert plane.effect.supported_tolerance > 1.5 * rigid.effect.supported_tolerance


def test_wrong_depths_make_it_recommend_the_homography(rig, plane):
    tactile, proximity = plane.clicks(0, 12)
    points = [Correspondence(str(i), *proximity[i], *tactile[i], 0.2 + 0.01 * (i % 5)) for i in range(len(tactile))]
    report = calibrate(points, rig)
    assert report.model == "homography"
    assert plane.error(report.homography).mean() < 4.0


def test_a_homography_that_is_wrong_off_its_plane_is_not_good(rig):
    rng = np.random.default_rng(0)
    tactile = rng.uniform((60, 60), (540, 420), (20, 2))
    depth = rng.uniform(0.28, 0.32, 20)  # contradicts pixels that are all shifted alike
    pairs = [Correspondence(str(i), u + 40.0, v, u, v, depth[i]) for i, (u, v) in enumerate(tactile)]
    report = calibrate(pairs, rig, "homography")
    assert report.chosen.alignment_px < 0.1
    assert report.chosen.effect.boundary_mm > 5
    assert not report.verdict.startswith("Good") and "nothing more is needed" not in report.verdict


def test_distortion_left_in_the_clicks_is_named_and_contained_in_the_bound(rig):
    centre = np.array([320.0, 240.0])

    def distorted(pixels):
        from_centre = pixels - centre
        return pixels + from_centre * (from_centre**2).sum(axis=-1, keepdims=True) * 6.0 / 400**3

    places, true = judged_places(rig)
    for factor in (0, 1):
        pairs = clicked(rig, 120, 0)
        if factor:
            moved = [distorted(np.array(pair.proximity)) for pair in pairs]
            pairs = [
                replace(pair, proximity_u=float(u), proximity_v=float(v))
                for pair, (u, v) in zip(pairs, moved, strict=True)
            ]
        report = calibrate(pairs, rig, "rigid", membrane=places)
        seen = distorted(true) if factor else true
        error = np.sqrt(np.mean(np.sum((report.rigid.predict(places) - seen) ** 2, axis=1)))
        assert error < report.chosen.alignment_bound_95_px < 4 * error
        assert ("lens distortion" in report.verdict) == bool(factor)


def test_clicks_several_times_as_noisy_as_stated_are_never_good(rig):
    report = calibrate(clicked(rig, 300, 0, noise=ClickNoise(2.5, 2.5, 0.0005)), rig, "rigid")
    assert report.chosen.cross_validated_px > 4.0
    assert report.verdict.startswith("Usable")
    assert "Regions left out of the fit are off by" in report.verdict


def test_points_without_depth_give_a_homography_and_say_why(rig, plane):
    tactile, proximity = plane.clicks(0, 8)
    points = [Correspondence(str(i), *proximity[i], *tactile[i]) for i in range(8)]
    report = calibrate(points, rig)
    assert report.model == "homography"
    assert "only 0 of the 8 pairs have a tactile depth" in report.refused["rigid"]
    with pytest.raises(CalibrationError, match="tactile depth"):
        calibrate(points, rig, "rigid")


def test_clicks_in_colour_reach_the_homography_through_the_extrinsic(rig):
    in_depth = calibrate(clicked(rig, noise=CLEAN), rig, "homography")
    in_color = calibrate(clicked(rig, noise=CLEAN, color_share=1.0), rig, "homography")
    assert np.abs(in_depth.homography.residuals_px - in_color.homography.residuals_px).max() < 1e-6


def test_four_points_never_show_a_residual_of_zero_as_quality(rig):
    report = calibrate(clicked(rig, MIN_POINTS), rig, "homography")
    quality = report.quality["homography"]
    assert quality.rms_px is quality.worst_px is quality.cross_validated_px is quality.click_noise_px is None
    assert report.to_json()["rms_px"] is None
    assert "mean nothing" in report.verdict
    assert "a homography fits any 4 pairs" in report.verdict and "Click at least 2 more" in report.verdict
    assert " 0.00" not in report.words().split("Points per cell")[0]


def test_a_wrong_pair_is_left_out_of_both_models_and_named(rig):
    points = clicked(rig, 14)
    points[4] = replace(points[4], proximity_u=points[4].proximity_u - 60)
    report = calibrate(points, rig)
    assert report.quality["rigid"].excluded == ("5",)
    assert report.quality["homography"].excluded == ("5",)
    assert "pair 5" in report.verdict


def test_a_disabled_wrong_pair_does_no_harm_and_stays_in_the_record(rig):
    points = clicked(rig, 12)
    bad = replace(points[4], id="bad", proximity_u=5.0, enabled=False)
    report = calibrate([*points, bad], rig)
    assert report.chosen.excluded == ()
    assert [pair.id for pair in report.record().points][-1] == "bad"


def test_an_empty_corner_is_named_as_the_next_step(rig):
    points = [p for p in clicked(rig, 60, 3) if not (p.tactile_u < 330 and p.tactile_v < 260)][:14]
    report = calibrate(points, rig)
    assert "Add points at the upper left: none within" in report.verdict


def test_points_of_one_depth_are_asked_for_another_inflation_level(rig):
    points = [p for p in clicked(rig, 200, 1) if 0.262 < p.tactile_depth_m < 0.275][:24]
    report = calibrate(points, rig, "rigid")
    assert report.coverage.depth_span_mm < 14
    assert "another inflation level" in report.verdict or "none within" in report.verdict


@pytest.mark.parametrize(("noise", "word"), [(ClickNoise(0.1, 0.1, 1e-4), "Good"), (ClickNoise(3, 3, 2e-3), "Poor")])
def test_the_verdict_follows_the_noise(rig, noise, word):
    report = calibrate(clicked(rig, 20, 5, noise=noise), rig)
    assert report.verdict.startswith(word)
    assert report.quality["rigid"].click_noise_px == pytest.approx(noise.tactile_px, rel=0.5)


@pytest.mark.parametrize("seeds", [16, pytest.param(40, marks=pytest.mark.long)])
def test_the_expected_error_is_the_one_that_happens(rig, seeds):
    places, true = judged_places(rig)
    expected, happened = [], []
    for seed in range(seeds):
        report = calibrate(clicked(rig, 12, seed), rig, "rigid", membrane=places[::9])
        expected.append(report.chosen.alignment_px**2)
        happened.append(np.mean(np.sum((report.rigid.predict(places) - true) ** 2, axis=1)))
    # twelve pairs cannot exclude smooth errors, so some is added for them
    assert 0.8 * np.mean(happened) < np.mean(expected) < 2.0 * np.mean(happened)


def test_the_tolerance_follows_its_formula():
    sensors = 1e6 * (PROXIMITY_NOISE_M**2 + TACTILE_NOISE_M**2)
    effect = patch_effect([2.0], [1.0], [0.25])
    assert effect.supported_tolerance == pytest.approx(1.96 * np.sqrt(1 + 0.5 + sensors) / 250)
    assert effect.boundary_mm == pytest.approx(np.sqrt(5))
    assert patch_effect([0.0], [0.0], [0.3]).supported_tolerance == pytest.approx(1.96 * np.sqrt(sensors) / 300)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda points: [*points, replace(points[0], id="again", tactile_depth_m=0.2)],
            "1 and again are the same points",
        ),
        (lambda points: [*points, points[0]], "2 pairs have the id '1'"),
        (lambda points: points[:3], "at least 4"),
        (lambda points: [replace(p, enabled=False) for p in points], "there are 0"),
        (lambda points: [replace(p, proximity_u=u) for p, u in zip(points, RANDOM, strict=True)], "agree"),
    ],
)
def test_impossible_pairs_are_refused_with_the_reason(rig, change, words):
    with pytest.raises(CalibrationError, match=words):
        calibrate(change(clicked(rig)), rig)


def test_pairs_within_a_pixel_of_each_other_are_told(rig):
    points, jitter = clicked(rig), np.random.default_rng(0).normal(0, 0.1, (12, 4))
    near = [
        replace(p, proximity_u=300 + a, proximity_v=200 + b, tactile_u=300 + c, tactile_v=250 + d)
        for p, (a, b, c, d) in zip(points, jitter, strict=True)
    ]
    assert calibrate([*points[:2], *near[2:8]], rig).verdict.startswith("Poor")


def test_a_lens_that_folds_its_image_over_is_refused(rig):
    k1 = {"distortion": "brown_conrady", "coefficients": (-3, 0, 0, 0, 0)}
    lens = rig.tactile.intrinsics.model_copy(update=k1)
    folded = rig.model_copy(update={"tactile": rig.tactile.model_copy(update={"intrinsics": lens})})
    with pytest.raises(CalibrationError, match=r"pair.*: the tactile lens of the rig takes no ray to that pixel"):
        calibrate(clicked(rig), folded)


RANDOM = np.random.default_rng(0).uniform(0, 639, 12)


def test_pairs_that_agree_on_two_alignments_are_refused(rig):
    points = clicked(rig, 30)
    shifted = [replace(p, proximity_u=p.proximity_u + 40) if int(p.id) % 5 < 3 else p for p in points]
    with pytest.raises(CalibrationError, match=r"two different alignments: 18 pairs \(1, 2, .* 12 pairs \(3, 4, "):
        calibrate(shifted, rig, "rigid")


def test_a_depth_scale_without_proximity_depths_is_warned_about(rig):
    assert "do not determine the depth scale" in calibrate(clicked(rig), rig, depth_fit="both").warnings[0]


def test_a_depth_correction_is_fitted_as_recommended_or_asked_for(rig):
    report = calibrate(clicked(rig, 20), rig, depth_fit="auto")
    assert report.depth_fit == report.depth_advice.depth_fit == "none"
    assert report.rigid.pose.offset_m == 0.0
    report = calibrate(clicked(rig, 20), rig, depth_fit="offset")
    assert report.to_json()["depth_fit"] == "offset"
    assert not any("scale" in words for words in report.warnings)
    assert report.apply_to(Preset()).alignment.depth_offset_m == report.rigid.pose.offset_m != 0.0


def test_a_fit_that_no_preset_allows_is_refused(rig):
    report = calibrate(clicked(rig, 20), rig, depth_fit="both")
    solution = report.rigid.solution
    theta = np.append(solution.theta[:6], [1.4, 0.0])
    wild = replace(report, rigid=replace(report.rigid, solution=replace(solution, theta=theta)))
    with pytest.raises(CalibrationError, match=r"depth_scale is 1\.4"):
        wild.apply_to(Preset())


def test_pairs_from_another_rig_are_warned_about(rig, usual):
    pose = np.array(rig.T_proximity_tactile)
    pose[0, 3] += 0.05
    other = rig.model_copy(update={"T_proximity_tactile": pose.tolist()})
    assert "mm and" in " ".join(calibrate(clicked(rig), other).warnings)
    assert usual.warnings == ()


def test_the_report_is_json_with_the_promised_keys(usual):
    data = json.loads(json.dumps(usual.to_json(), allow_nan=False))
    assert {"model", "homography", "T_proximity_tactile", "rms_px", "cross_validated_px"} <= data.keys()
    assert {"supported_tolerance", "verdict"} <= data.keys()
    assert np.shape(data["homography"]) == (3, 3)
    assert np.shape(data["T_proximity_tactile"]) == (4, 4)
    assert len(data["models"]["rigid"]["pairs"]) == 12


def test_a_preset_keeps_the_calibration_and_aligns_by_it(rig, usual):
    preset = usual.apply_to(Preset(), set_tolerance=True)
    assert preset_from_text(preset_json(preset), "memory") == preset
    assert preset.value("alignment.rigid.T_proximity_tactile") == tuple(map(tuple, usual.rigid.T_proximity_tactile))
    assert preset.alignment.calibration.proximity_serial == "SIM-L515"
    assert preset.tolerance.t == pytest.approx(usual.chosen.effect.supported_tolerance, abs=1e-4)
    assert preset.rig == rig


def test_the_record_alone_makes_the_pipeline_repeat_nothing(rig, usual, monkeypatch):
    preset = usual.apply_to(Preset())
    made = []
    monkeypatch.setattr(pipeline_module, "make_alignment", lambda *given: made.append(given) or make_alignment(*given))
    pipeline = ContactPipeline(preset, rig)
    pipeline.update(preset.with_value("alignment.calibration", None))
    assert len(made) == 1
    pipeline.update(preset.with_value("alignment.depth_scale", 1.01))
    assert len(made) == 2


@pytest.mark.parametrize(
    ("pixel", "words"),
    [((10, 10), "at the upper left"), ((630, 240), "at the right"), ((320, 470), "at the lower middle")],
)
def test_places_are_named(pixel, words):
    assert place_name(np.array(pixel), (480, 640)) == words


@pytest.mark.parametrize(("shift_mm", "boundary_mm"), [((4.0, 0.0, 0.0), 4.0), ((0.0, 0.0, 5.0), 5.0)])
def test_the_present_alignment_is_judged_by_the_new_one(rig, shift_mm, boundary_mm):
    report = calibrate(clicked(rig, 40), rig, "rigid")
    moved = np.array(rig.T_proximity_tactile)
    moved[:3, 3] += 1e-3 * np.array(shift_mm)
    errors = replacement(report, Preset().with_value("alignment.rigid.T_proximity_tactile", moved.tolist()))
    assert not errors.worse
    assert errors.present.boundary_mm == pytest.approx(boundary_mm, rel=0.25)
    assert errors.present.supported_tolerance > errors.new.supported_tolerance
    exact = replacement(report, report.apply_to(Preset()))
    assert exact.present.boundary_mm == pytest.approx(report.chosen.effect.boundary_mm)
