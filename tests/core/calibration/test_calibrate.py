"""The calibration as a whole: models, verdicts, refusals, the preset that it gives, and ``tactune calibrate``."""

from functools import partial

import numpy as np
import pytest

from rigs import save_rig
from simulated_clicks import ClickNoise, judged_places, make_clicks
from tactune.core.calibration.calibrate import calibrate
from tactune.core.calibration.check import compare_alignments, is_worse
from tactune.core.calibration.points import write_points
from tactune.core.errors import CalibrationError
from tactune.core.model.alignment import PointPair
from tactune.core.preset import Preset
from tactune.core.preset.file import save_preset
from tactune.core.sources.presets import load_preset

RANDOM = np.random.default_rng(0).uniform(0, 639, 12)


def clicked(rig, count=12, seed=0, **options):
    return make_clicks(rig, count, seed, **options).pairs()


def changed(pair, **values):
    return pair.model_copy(update=values)


def pair_of(name, proximity, tactile, depth_m=None):
    (pu, pv), (tu, tv) = (map(float, place) for place in (proximity, tactile))
    return PointPair(id=str(name), proximity_u=pu, proximity_v=pv, tactile_u=tu, tactile_v=tv, tactile_depth_m=depth_m)


def test_points_that_span_depth_make_it_recommend_rigid(rig):
    report = calibrate(clicked(rig, color_share=0.5), rig)
    assert (report.model, report.recommended) == ("rigid", "rigid")
    plane, rigid = report.quality["homography"], report.quality["rigid"]
    assert rigid.agreement.cross_validated_px < 0.6 * plane.agreement.cross_validated_px
    assert plane.excluded == rigid.excluded == ()
    assert plane.supported_tolerance > 1.5 * rigid.supported_tolerance
    assert "take the rigid model" in calibrate(clicked(rig, color_share=0.5), rig, "homography").verdict
    assert rigid.boundary_error_mm < plane.boundary_error_mm < 10  # 8 mm and less off its plane


def test_wrong_depths_make_it_recommend_the_homography(rig, plane):
    clicks = plane.clicks(0, 12)
    pairs = [pair_of(i, clicks.proximity[i], clicks.tactile[i], 0.2 + 0.01 * (i % 5)) for i in range(12)]
    report = calibrate(pairs, rig)
    assert report.model == "homography"
    assert plane.error(report.homography).mean() < 4.0


def test_a_homography_that_is_wrong_off_its_plane_is_not_good(rig):
    rng = np.random.default_rng(0)
    tactile = rng.uniform((60, 60), (540, 420), (20, 2))
    depth = rng.uniform(0.28, 0.32, 20)  # contradicts pixels that are all shifted alike
    pairs = [pair_of(i, (u + 40.0, v), (u, v), depth[i]) for i, (u, v) in enumerate(tactile)]
    report = calibrate(pairs, rig, "homography")
    assert report.chosen.alignment_px < 0.1
    assert report.chosen.boundary_error_mm > 5
    assert not report.verdict.startswith("Good") and "nothing more is needed" not in report.verdict


def test_distortion_left_in_the_clicks_is_named_and_contained_in_the_bound(rig):
    centre = np.array([320.0, 240.0])

    def distorted(pixels):
        from_centre = pixels - centre
        return pixels + from_centre * (from_centre**2).sum(axis=-1, keepdims=True) * 6.0 / 400**3

    places, true = judged_places(rig)
    for bent in (False, True):
        pairs = clicked(rig, 120, 0)
        if bent:
            moved = [distorted(np.array(pair.proximity)).tolist() for pair in pairs]
            pairs = [changed(pair, proximity_u=u, proximity_v=v) for pair, (u, v) in zip(pairs, moved, strict=True)]
        report = calibrate(pairs, rig, "rigid", membrane=places)
        seen = distorted(true) if bent else true
        error = np.sqrt(np.mean(np.sum((report.rigid.predict(places) - seen) ** 2, axis=1)))
        assert error < report.chosen.alignment_bound_95_px < 4 * error
        assert ("lens distortion" in report.verdict) == bent


def test_points_without_depth_give_a_homography_and_say_why(rig, plane):
    clicks = plane.clicks(0, 8)
    pairs = [pair_of(i, clicks.proximity[i], clicks.tactile[i]) for i in range(8)]
    report = calibrate(pairs, rig)
    assert report.model == "homography"
    assert "only 0 of the 8 pairs have a tactile depth" in report.refused["rigid"]
    with pytest.raises(CalibrationError, match="tactile depth"):
        calibrate(pairs, rig, "rigid")


def test_four_points_never_show_a_residual_of_zero_as_quality(rig):
    report = calibrate(clicked(rig, 4), rig, "homography")
    quality = report.quality["homography"]
    assert quality.rms_px is quality.agreement.cross_validated_px is None
    assert report.to_json()["rms_px"] is None
    assert "mean nothing" in report.verdict and "at least 2 more" in report.verdict
    assert "Residual of the homography" not in report.words()


def test_points_of_one_depth_are_asked_for_another_inflation_level(rig):
    pairs = [pair for pair in clicked(rig, 200, 1) if 0.262 < pair.tactile_depth_m < 0.275][:24]
    report = calibrate(pairs, rig, "rigid")
    assert report.depth_span_mm < 14
    assert "another inflation level" in report.verdict


@pytest.mark.parametrize(("noise", "word"), [(ClickNoise(0.1, 0.1, 1e-4), "Good"), (ClickNoise(3, 3, 2e-3), "Poor")])
def test_the_verdict_follows_the_noise(rig, noise, word):
    assert calibrate(clicked(rig, 20, 5, noise=noise), rig).verdict.startswith(word)


def test_the_expected_error_is_the_one_that_happens(rig):
    places, true = judged_places(rig)
    expected, happened = [], []
    for seed in range(12):
        report = calibrate(clicked(rig, 12, seed), rig, "rigid", membrane=places[::9])
        expected.append(report.chosen.alignment_px**2)
        happened.append(np.mean(np.sum((report.rigid.predict(places) - true) ** 2, axis=1)))
    # twelve pairs cannot exclude smooth errors, so some is added for them
    assert 0.8 * np.mean(happened) < np.mean(expected) < 2.0 * np.mean(happened)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda pairs: [*pairs, changed(pairs[0], id="again", tactile_depth_m=0.2)], "1 and again are the same points"),
        (lambda pairs: [*pairs[1:], changed(pairs[0], id="2")], "two pairs have the id 2"),
        (lambda pairs: pairs[:3], "at least 4"),
        (lambda pairs: [changed(pair, enabled=False) for pair in pairs], "there are 0"),
        (lambda pairs: [changed(p, proximity_u=u) for p, u in zip(pairs, RANDOM.tolist(), strict=True)], "agree"),
    ],
)
def test_impossible_pairs_are_refused_with_the_reason(rig, change, words):
    with pytest.raises(CalibrationError, match=words):
        calibrate(change(clicked(rig)), rig)


@pytest.mark.parametrize(("offset_m", "certain"), [(0.0, False), (0.015, True)])
def test_an_offset_of_the_depth_is_corrected_only_if_it_is_certain(rig, offset_m, certain):
    noise = ClickNoise(0.07, 0.07, 0.0003)
    for seed in range(2):
        pairs = clicked(rig, 150, seed, noise=noise, color_share=0.5)
        waves = [np.sin(p.tactile_u / 60 + seed) * np.sin(p.tactile_v / 60 + seed) for p in pairs]
        pairs = [
            changed(p, tactile_depth_m=p.tactile_depth_m - offset_m + 0.0005 * wave)
            for p, wave in zip(pairs, waves, strict=True)
        ]
        report = calibrate(pairs, rig, "rigid")
        assert report.depth_offset.used == certain
        assert ("Depth offset: " in report.words()) == certain
        assert report.rigid.alignment.offset_m == (report.depth_offset.offset_m if certain else 0.0)


def preset_of(pose):
    return Preset().with_value("alignment.rigid.T_proximity_tactile", np.asarray(pose).tolist())


def bent(pairs):
    """Pairs whose depths share a smooth error of 3 mm."""
    return [
        changed(pair, tactile_depth_m=pair.tactile_depth_m + 0.003 * np.sin(pair.tactile_u / 150)) for pair in pairs
    ]


@pytest.mark.parametrize(("count", "make"), [(12, bent), (40, list)])
def test_a_new_alignment_is_not_better_than_the_true_one(rig, count, make):
    """It fits its own pairs better, as every fit does, and shares their errors."""
    verdicts = []
    for seed in range(5):
        compared = compare_alignments(
            calibrate(make(clicked(rig, count, seed)), rig, "rigid"), preset_of(rig.T_proximity_tactile)
        )
        verdicts.append(compared.verdict)
        assert compared.half_width_px > 0
    assert "better" not in verdicts and verdicts.count("equal") >= 3


def test_an_alignment_that_has_moved_is_told_from_a_new_one(rig):
    report = calibrate(clicked(rig, 24), rig, "rigid")
    moved = np.array(rig.T_proximity_tactile)
    moved[0, 3] += 0.004
    compared = compare_alignments(report, preset_of(moved))
    assert compared.verdict == "better" and not is_worse(report, preset_of(moved))
    assert compared.better_px == pytest.approx(4e-3 * rig.proximity.intrinsics.fx / 0.29, rel=0.35)


def test_pairs_that_the_present_alignment_was_fitted_to_tell_nothing(rig):
    report = calibrate(clicked(rig, 40), rig, "rigid")
    saved = report.apply_to(Preset())
    assert compare_alignments(report, saved) is None
    assert not is_worse(report, saved)
    more = [*clicked(rig, 40), *(changed(pair, id=f"new {pair.id}") for pair in clicked(rig, 20, seed=1))]
    assert compare_alignments(calibrate(more, rig, "rigid"), saved).pairs == 20
    assert is_worse(calibrate(clicked(rig, 8, noise=ClickNoise(1.5, 1.5, 0.001)), rig, "rigid"), saved)


@pytest.fixture
def files(tmp_path, rig):
    clean = make_clicks(rig, 10, 0, ClickNoise(0.0, 0.0, 0.0), color_share=0.4)
    write_points(tmp_path / "points.csv", clean.pairs())
    save_rig(rig, tmp_path / "rig.json")
    return tmp_path


@pytest.fixture
def run(tactune):
    return partial(tactune, "calibrate")


def test_the_preset_gets_the_pose(run, files, rig):
    save_preset(Preset(name="mine").with_value("tolerance.t", 0.02), files / "mine.json")
    status, out, err = run("--points", files / "points.csv", "--rig", files / "rig.json", "--out", files / "mine.json")
    assert (status, err) == (0, "")
    assert f"wrote {files / 'mine.json'}" in out and "Verdict: " in out
    preset = load_preset(files / "mine.json")
    assert np.allclose(preset.alignment.rigid.T_proximity_tactile, rig.T_proximity_tactile, atol=1e-6)
    assert (preset.name, preset.tolerance.t, preset.rig) == ("mine", 0.02, rig)
    record = preset.alignment.calibration
    assert (record.proximity_serial, len(record.points)) == ("SIM-L515", 10)
