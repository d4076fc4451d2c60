from functools import partial

import numpy as np
import pytest

from rigs import save_rig
from simulated_clicks import ClickNoise, make_clicks
from tactune.core.calibration.points import write_points
from tactune.core.preset import Preset
from tactune.core.preset.file import save_preset
from tactune.core.sources.presets import load_preset


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
    assert (preset.name, preset.tolerance.t) == ("mine", 0.02)
    assert len(preset.alignment.calibration.points) == 10


def test_bad_points_end_with_2_and_one_sentence(run, files):
    path = files / "points.csv"
    path.write_text(path.read_text().replace("\n1,1,", "\n1,1,x"))
    done = run("--points", path, "--rig", files / "rig.json", "--out", files / "new.json")
    assert "line 2: proximity_u" in done.sentence
    assert not (files / "new.json").exists()
