"""Radial distortion from pairs: estimated, used by the pipeline, and told from two planes."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_clicks import make_clicks, project_points
from tactune.core import ContactPipeline
from tactune.core.calibration import Correspondence, calibrate
from tactune.core.calibration.distortion import advise_distortion, two_planes
from tactune.core.errors import CalibrationError
from tactune.core.model.frames import Rig
from tactune.core.model.intrinsics import Distortion
from tactune.core.preset import Preset
from tactune.core.sources.simulator.scene import simulator_rig


@pytest.fixture
def rig() -> Rig:
    return simulator_rig()


@pytest.fixture
def bent(rig):
    update = {"distortion": Distortion.BROWN_CONRADY, "coefficients": (-0.2, 0.0, 0.0, 0.0, 0.0)}
    return rig.with_lenses(rig.tactile.intrinsics.model_copy(update=update), rig.proximity.intrinsics)


def test_the_distortion_of_one_lens_is_found_with_its_uncertainty(rig, bent):
    advice = advise_distortion(make_clicks(bent, 54, 1).correspondences(), rig)
    for name, true in (("tactile", -0.2), ("proximity", 0.0)):
        value, sigma = advice.k1[name]
        assert abs(value - true) < 3 * sigma < 0.1
    assert advice.sentence.startswith("Estimate lens distortion: residuals ")
    assert advice.sentence.endswith("from 54 pairs.")


def test_wrong_pairs_do_not_spoil_the_estimate(rig, bent):
    pairs = make_clicks(bent, 60, 2).correspondences()
    pairs = [replace(pair, proximity_u=pair.proximity_u + 25) if int(pair.id) % 12 == 0 else pair for pair in pairs]
    value, sigma = advise_distortion(pairs, rig).k1["tactile"]
    assert abs(value + 0.2) < 3 * sigma < 0.1


def test_distortion_that_folds_the_membrane_over_is_named_and_not_offered(rig):
    update = {"distortion": Distortion.BROWN_CONRADY, "coefficients": (-0.5, 0.0, 0.0, 0.0, 0.0)}
    very_bent = rig.with_lenses(rig.tactile.intrinsics.model_copy(update=update), rig.proximity.intrinsics)
    pairs = make_clicks(very_bent, 40, 2).correspondences()
    for estimate in (False, True):
        with pytest.raises(CalibrationError, match=r"^lens distortion explains the pairs .* too strong .* chessboard$"):
            calibrate(pairs, rig, "rigid", estimate_distortion=estimate)


def test_nothing_is_offered_without_distortion_or_where_the_rig_states_it(rig, bent):
    assert not advise_distortion(make_clicks(rig, 54, 3).correspondences(), rig).found
    assert not advise_distortion(make_clicks(bent, 54, 3).correspondences(), bent).found


def test_the_estimate_is_saved_with_the_rig_and_the_pipeline_uses_it(rig, bent):
    pairs = make_clicks(bent, 54, 4).correspondences()
    plain, report = calibrate(pairs, rig), calibrate(pairs, rig, estimate_distortion=True)
    assert plain.verdict.endswith(plain.distortion.sentence)
    assert not plain.distortion_used
    assert report.distortion_used
    assert report.quality["rigid"].rms_px < 1.8
    preset = report.apply_to(Preset())
    pipeline = ContactPipeline(preset, rig)
    assert pipeline.rig.tactile.intrinsics.coefficients == preset.rig.tactile.intrinsics.coefficients
    assert pipeline.rig.tactile.intrinsics.coefficients[0] == pytest.approx(-0.2, abs=0.05)
    (warning,) = pipeline.warnings
    assert "contains lens distortion that the source does not state" in warning
    pipeline.update(plain.apply_to(Preset()) if plain.rigid else Preset(rig=rig))
    assert pipeline.rig == rig


def test_pairs_on_two_planes_are_no_distortion(rig):
    rng = np.random.default_rng(0)
    depth = np.where(np.arange(54) % 2, 0.27, 0.31)
    space = np.column_stack([rng.uniform((-0.12, -0.08), (0.16, 0.08), (54, 2)), depth])
    seen = project_points(space, rig, np.zeros(54, bool))
    rows = np.column_stack([seen.proximity, seen.tactile]) + rng.normal(0, 0.5, (54, 4))
    pairs = [Correspondence(str(i), *row, depth) for i, (row, depth) in enumerate(
        zip(rows.tolist(), seen.tactile_depth_m.tolist(), strict=True))]  # fmt: skip
    assert not advise_distortion(pairs, rig).found
    assert "the pairs lie on two planes" in two_planes(pairs, rig)
