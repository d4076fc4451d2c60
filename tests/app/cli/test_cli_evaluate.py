"""``tactune evaluate table`` and ``tactune run --method``."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tactune.core.evaluation import sensor_cases, sensor_table
from tactune.core.evaluation import table as table_module
from tactune.core.methods.registry import method_names
from tactune.core.output.cloud_files import read_points

SIM = "sim:cup?press=medium&sensor=datasheet"


def lines(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--methods", "fuson"], "no method 'fuson'; known are straight, fusion-"),
        (["--methods", ","], "--methods is ','"),
        (["--objects", "mug"], "object 'mug' is held out; add --held-out"),
        (["--held-out", "--objects", "cup"], "no object 'cup'"),
        (["--presses", "hard"], "no press 'hard'"),
        (["--plot", "figure.xyz"], "suffix '.xyz'"),
        (["--preset", "nowhere.json"], "nowhere.json"),
        (["--sensors", "magic"], "no sensor 'magic'; choose from clean"),
        (["--sensors", "held-tof"], "sensor 'held-tof' is held out; add --held-out"),
        (["--sensors", "all", "--membranes", "magic"], "no membrane 'magic'; choose from standard"),
        (["--sensors", "all", "--objects", "mug"], "object 'mug' is held out; add --held-out"),
        (["--sensors", ","], "--sensors is ','"),
        (["--sensors", "all", "--methods", "straight"], "use --out in place of --methods"),
        (["--check"], "add --sensors all"),
        (["--membranes", "soft"], "add --sensors all"),
    ],
)
def test_what_cannot_be_is_said_before_anything_is_measured(tmp_path, tactune, words, said):
    assert said in tactune("evaluate", "table", "--work", tmp_path / "work", *words).sentence
    assert not (tmp_path / "work").exists()


def test_a_table_of_the_simulator_goes_on_after_an_interrupt(tmp_path, tactune, monkeypatch):
    small = ["--methods", "fusion-rigid,proximity-only", "--objects", "cup", "--presses", "medium", "--seeds", 1]
    words = ["evaluate", "table", *small, "--no-extra", "--work", tmp_path / "work"]
    measure = table_module.score_run

    def interrupted(name, *rest):
        if name == "proximity-only":
            raise KeyboardInterrupt
        return measure(name, *rest)

    monkeypatch.setattr(table_module, "score_run", interrupted)
    status, _, err = tactune(*words)
    assert status == 130
    assert "1 of 2 cells are kept" in err

    measured = []
    monkeypatch.setattr(table_module, "score_run", lambda name, *rest: measured.append(name) or measure(name, *rest))
    status, out, _ = tactune(*words, "--json", "--csv", tmp_path / "t.csv")
    assert status == 0
    document = json.loads(out)
    assert measured == ["proximity-only"]
    rmse = {cell["method"]: cell["rmse_mm"] for cell in document["cells"]}
    assert 0 < rmse["fusion-rigid"] < rmse["proximity-only"] < 20
    assert len((tmp_path / "t.csv").read_text().splitlines()) == 3


def test_a_table_of_sensors_goes_on_after_an_interrupt_and_checks(tmp_path, tactune, monkeypatch):
    small = ["--membranes", "standard", "--objects", "cup", "--presses", "medium", "--seeds", 1]
    words = ["evaluate", "table", "--sensors", "clean,datasheet", *small, "--work", tmp_path / "work"]
    score, scored = sensor_table.score_runs, []

    def interrupted(runs, scene, *rest):
        if scene.sensor == "datasheet":
            raise KeyboardInterrupt
        return score(runs, scene, *rest)

    def noted(runs, scene, *rest):
        scored.append(scene.sensor)
        return score(runs, scene, *rest)

    monkeypatch.setattr(sensor_table, "score_runs", interrupted)
    status, _, err = tactune(*words)
    assert status == 130
    assert "1 of 2 frames are kept" in err

    monkeypatch.setattr(sensor_table, "score_runs", noted)
    status, out, _ = tactune(*words, "--json", "--out", tmp_path / "out")
    assert status == 0
    document = json.loads(out)
    assert scored == ["datasheet"]
    assert [case["sensor"] for case in document["cases"]] == ["clean", "datasheet"]
    assert all(0 < case["oracle_mm"] <= case["best_fixed_mm"] < case["straight_mm"] for case in document["cases"])
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"sensors.md", "sensors.csv", "cells.csv"}
    with (tmp_path / "out" / "cells.csv").open(encoding="utf-8", newline="") as file:
        assert {(row["contacts"], row["iou"]) for row in csv.DictReader(file)} == {("", "")}, "not computed"

    for largest, status in ((100.0, 0), (0.001, 1)):
        monkeypatch.setattr(sensor_cases, "MAX_OVER_ORACLE", largest)
        monkeypatch.setattr(sensor_cases.SensorCase, "holds_best", True)
        found, text, _ = tactune(*words, "--check")
        assert found == status
        assert text.startswith("medium") and "all three: " in text
        assert ("Cases that do not hold" in text) == bool(status)


@pytest.mark.parametrize("method", ["fusion", *method_names()])
def test_run_knows_every_method(tactune, method):
    status, out, _ = tactune("run", "-s", SIM, "-n", 1, "--json", "--truth", "--method", method)
    assert status == 0
    (record,) = lines(out)
    assert (record["method"], record["failure"]) == (method, "")
    assert record["points"] > 100 and record["iou"] > 0.1


def test_a_method_writes_its_points(tmp_path, tactune):
    words = ["run", "-s", SIM, "-n", 1, "--json", "--method", "tactile-only", "--out", tmp_path, "--format", "ply"]
    status, out, _ = tactune(*words)
    assert status == 0
    (record,) = lines(out)
    points = read_points(tmp_path / "patch_000000.ply")[0]
    assert len(points) == record["points"]
    np.testing.assert_allclose(points.mean(axis=0, dtype=float), record["centroid_m"], rtol=1e-6)


def test_a_recording_needs_an_untouched_frame_and_takes_one(make_recording, tactune):
    recording: Path = make_recording()
    words = ["run", "-s", recording, "--json", "--method", "proximity-only"]
    assert "give --untouched" in tactune(*words).sentence
    status, out, _ = tactune(*words, "--untouched", recording)
    assert status == 0
    assert {record["method"] for record in lines(out)} == {"proximity-only"}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--method", "magic"], "no method 'magic'; known are fusion, fusion-"),
        (["--method", "fusion", "--untouched", "sim"], "remove --untouched"),
        (["--method", "mechanics", "--untouched", "nowhere"], "nowhere"),
    ],
)
def test_run_says_what_is_wrong_with_a_method(make_recording, tactune, words, said):
    assert said in tactune("run", "-s", make_recording(), "--json", *words).sentence
