"""``tactune preset measure-rig``: noise and bias of a recording of a wall, in sentences and in a preset."""

from datetime import UTC, datetime

import pytest

from side_by_side import HEIGHT, PRINT_MASK, WIDTH, rig, wall_source
from tactune.core.preset import Preset
from tactune.core.preset.file import save_preset
from tactune.core.rig.untouched import load_untouched
from tactune.core.sources.folder import export_folder
from tactune.core.sources.presets import load_preset

__all__ = ["rig"]

LAST_YEAR = datetime(2025, 6, 1, tzinfo=UTC)


@pytest.fixture
def wall(tmp_path, rig):
    export_folder(wall_source(rig, 14), tmp_path / "wall")
    return tmp_path / "wall"


@pytest.fixture
def mine(tmp_path):
    """A preset of last year in a folder of its own."""
    path = tmp_path / "presets" / "mine.json"
    save_preset(Preset(name="mine", created=LAST_YEAR, modified=LAST_YEAR).with_values(PRINT_MASK), path)
    return path


def test_noise_and_bias_are_said_and_stored(tactune, wall, mine):
    finished = tactune("preset", "measure-rig", "--source", wall, "--preset", mine)
    assert finished.status == 0
    tactile, proximity, bias, written = finished.out.splitlines()
    assert tactile.startswith("Tactile noise 0.30 mm") and proximity.startswith("Proximity noise 0.60 mm")
    assert bias.startswith("The proximity camera reads 4.0 ± 0.2 mm farther")
    assert written == f"wrote {mine}"
    preset = load_preset(mine)
    assert preset.noise.bias_m == pytest.approx(0.004, abs=2e-4)
    assert preset.noise.frames == 14
    assert preset.created == LAST_YEAR < preset.modified


def test_a_shipped_preset_is_measured_into_another_file(tactune, rig, tmp_path):
    wall = tmp_path / "apart"  # the proximity camera looks through the membrane at something 60 mm behind
    export_folder(wall_source(rig, 14, bias_m=0.060), wall)
    out = tmp_path / "measured.json"
    finished = tactune("preset", "measure-rig", "--source", wall, "--out", out)
    assert finished.status == 0
    assert "press an object firmly (1,000 mm2 or more)" in finished.out
    preset = load_preset(out)
    assert (preset.name, preset.noise.bias_from, preset.noise.frames) == ("measured", "unknown", 14)


def test_the_untouched_frame_goes_with_the_preset(tactune, wall, mine, tmp_path):
    words = ("--source", wall, "--preset", mine)
    assert tactune("preset", "capture-untouched", *words, "--force").status == 0
    out = tmp_path / "elsewhere" / "copy.json"
    out.parent.mkdir()
    assert tactune("preset", "measure-rig", *words, "--out", out).status == 0
    copied = load_preset(out)
    assert copied.name == "mine"
    assert load_untouched(copied.untouched, out).tactile_depth.shape == (HEIGHT, WIDTH)
    assert load_preset(mine).noise is None


def test_the_inflation_is_measured_from_a_log_of_forces(tactune, mine, tmp_path):
    log = tmp_path / "scale.csv"
    log.write_text("frame,force_n\n0,22.5\n1,22.6\n")
    finished = tactune(
        "preset", "calibrate-force", "--source", "sim:cup?press=medium", "--forces", log, "--preset", mine
    )
    assert finished.status == 0 and finished.out.splitlines()[-1] == f"wrote {mine}"
    section = load_preset(mine).pressure
    assert 1000 < section.gauge_pa < 4000 and section.gauge_sigma_pa > 0.05 * section.gauge_pa
    log.write_text("frame,force_n\n400,22.5\n")
    finished = tactune("preset", "calibrate-force", "--source", "sim:cup?press=medium", "--forces", log)
    assert finished.status == 2 and str(log) in finished.err
