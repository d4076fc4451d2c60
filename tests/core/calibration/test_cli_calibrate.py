from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest

from html_pages import HtmlPage
from rigs import save_rig
from simulated_clicks import ClickNoise, make_clicks
from tactune.core.calibration import write_points
from tactune.core.preset import Preset
from tactune.core.preset.file import save_preset
from tactune.core.sources.presets import load_preset


@pytest.fixture
def files(tmp_path, rig):
    clean = make_clicks(rig, 10, 0, ClickNoise(0.0, 0.0, 0.0), color_share=0.4)
    write_points(tmp_path / "points.csv", clean.correspondences())
    save_rig(rig, tmp_path / "rig.json")
    return tmp_path


@pytest.fixture
def run(tactune):
    return partial(tactune, "calibrate")


def test_json_holds_the_pose_and_the_preset_gets_it(run, files, rig):
    save_preset(Preset(name="mine").with_value("tolerance.t", 0.02), files / "mine.json")
    status, out, err = run(
        "--points", files / "points.csv", "--rig", files / "rig.json", "--json", "--out", files / "mine.json"
    )
    assert (status, err) == (0, "")
    report = json.loads(out)
    assert report["model"] == "rigid"
    assert np.allclose(report["T_proximity_tactile"], rig.T_proximity_tactile, atol=1e-8)
    preset = load_preset(files / "mine.json")
    assert np.allclose(preset.alignment.rigid.T_proximity_tactile, rig.T_proximity_tactile, atol=1e-8)
    assert (preset.name, preset.tolerance.t) == ("mine", 0.02)
    assert len(preset.alignment.calibration.points) == 10


@pytest.mark.parametrize("model", ["auto", "homography", "rigid"])
def test_words_hold_the_verdict(run, files, model):
    status, out, _ = run("--points", files / "points.csv", "--rig", files / "rig.json", "--model", model)
    assert status == 0
    assert "Verdict: " in out
    assert "supported tolerance t" in out


def test_a_report_that_cannot_be_written_changes_no_preset(run, files):
    (files / "quality.html").mkdir()
    options = ("--report", files / "quality.html", "--out", files / "mine.json")
    status, _, err = run("--points", files / "points.csv", "--rig", files / "rig.json", *options)
    assert status == 2
    assert "cannot write" in err
    assert not (files / "mine.json").exists()


def test_the_report_is_one_file_with_its_numbers_and_pictures(run, files, tmp_path):
    path = tmp_path / "quality.html"
    status, out, _ = run("--points", files / "points.csv", "--rig", files / "rig.json", "--report", path, "--json")
    assert status == 0
    page, found = HtmlPage(path), json.loads(out)
    assert found["verdict"] in page.text
    for name in ("rms_px", "cross_validated_px", "alignment_px", "alignment_bound_95_px", "boundary_error_mm"):
        assert f"{found[name]:.2f}" in page.text
    assert f"{found['supported_tolerance']:.4f}" in page.text
    assert len(page.images) == 3 and all(image.std() > 0 for image in page.images.values())


def test_depth_scale_is_reported(run, files):
    _, out, _ = run("--points", files / "points.csv", "--rig", files / "rig.json", "--depth-fit", "both", "--json")
    assert json.loads(out)["depth_scale"] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace("\n1,1,", "\n1,1,x"), "line 2: proximity_u"),
        (lambda text: "\n".join(text.split("\n")[:4]), "at least 4"),
        (lambda text: "", "is empty"),
    ],
)
def test_bad_points_end_with_2_and_one_sentence(run, files, change, words):
    path = files / "points.csv"
    path.write_text(change(path.read_text()))
    assert words in run("--points", path, "--rig", files / "rig.json", "--out", files / "new.json").sentence
    assert not (files / "new.json").exists()
