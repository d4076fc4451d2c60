"""``tactune run``, and ``tactune convert`` into a folder."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tactune.app.cli import common
from tactune.core.contact.pipeline import ContactPipeline

COMMAND = [sys.executable, "-m", "tactune.app"]


def json_lines(text):
    def refuse(constant):
        raise AssertionError(f"{constant} is no JSON")

    return [json.loads(line, parse_constant=refuse) for line in text.splitlines()]


def test_json_lines_say_what_the_patch_is(tactune, recording):
    finished = tactune("run", "--source", recording, "--json")
    lines = json_lines(finished.out)
    assert finished.status == 0
    assert [line["sequence"] for line in lines] == [0, 1, 2, 3]
    numbers = {"frame", "sequence", "time_s", "points", "area_mm2", "centroid_m", "averaged_frames"}
    doubt = {"touch_probability", "boundary_error_mm", "doubt"}
    assert set(lines[0]) == numbers | doubt | {"stage_ms", "contacts", "findings"}
    for contact in lines[-1]["contacts"]:
        assert set(contact) == doubt | {"area_mm2", "centroid_m"}
    assert lines[0]["points"] == 0
    assert lines[0]["centroid_m"] is None
    assert lines[0]["area_mm2"] == 0
    assert lines[3]["area_mm2"] == pytest.approx(lines[3]["points"] * (300 / 60) ** 2)
    assert lines[3]["centroid_m"] == pytest.approx([-0.06, -0.02, 0.3], abs=0.005)
    assert list(lines[3]["stage_ms"]) == ["fusion", "equilibrium", "edge", "clusters", "points"]


def test_truth_is_compared_where_it_is_known(tactune, make_recording):
    everything = ("--set", "tolerance.t=0.03", "--set", "outliers.enabled=false")
    lines = json_lines(tactune("run", "-s", make_recording(), "-p", "default", *everything, "--json", "--truth").out)
    assert [line["touched"] for line in lines] == [False, True, True, True]
    for score in ("iou", "precision", "recall"):
        assert [line[score] for line in lines] == [None, 1, 1, 1]
    assert lines[0]["rmse_mm"] is None
    assert lines[3]["rmse_mm"] == pytest.approx(0, abs=1e-3)

    unlabelled = tactune("run", "-s", make_recording("unlabelled", with_truth=False), "--json", "--truth")
    assert [line["iou"] for line in json_lines(unlabelled.out)] == [None] * 4
    assert len(unlabelled.err.splitlines()) == 1


def test_a_full_disk_behind_standard_output_is_told_in_one_sentence(recording):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*COMMAND, "run", "--source", str(recording), "--json"],
            check=False, stdout=full, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    assert done.returncode == 2
    assert "No space left" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_reader_that_stops_reading_ends_the_command_silently(recording):
    command = [*COMMAND, "run", "--source", str(recording), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 1


def test_interrupted_with_finished_files_intact(tactune, recording, tmp_path, monkeypatch):
    out, process = tmp_path / "out", ContactPipeline.process
    for file in recording.glob("*/frame.json"):  # the camera's numbers begin at 50; files count from 0
        file.write_text(file.read_text().replace('"sequence": ', '"sequence": 5'))

    def interrupted(self, frame):
        if frame.sequence == 52:
            for _ in range(2):  # the second follows at once
                os.kill(os.getpid(), signal.SIGINT)
        return process(self, frame)

    monkeypatch.setattr(ContactPipeline, "process", interrupted)
    done = tactune("run", "--source", recording, "--out", out)
    assert (done.status, done.err) == (130, "tactune: stopped after 3 of 4 frames\n")
    assert done.out.startswith("3 frames of folder:")
    assert {file.name for file in out.iterdir()} == {f"patch_00000{number}.npz" for number in range(3)}
    with np.load(out / "patch_000001.npz") as saved:
        assert len(saved["points"]) > 0


def test_the_second_signal_acts_as_usual(monkeypatch):
    monkeypatch.setattr(common, "_ONE_PRESS_S", 0.0)
    with pytest.raises(KeyboardInterrupt), common.stop_on_signals():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)


def test_estimates_the_tilt_of_each_patch(tactune):
    options = ("run", "--source", "sim:cup?press=medium", "--frames", "2", "--estimate", "tilt", "--json")
    tilts = [record["tilt"] for record in json_lines(tactune(*options).out)]
    assert len(tilts) == 2
    for tilt in tilts:
        assert abs(tilt["roll_rad"]) < 0.2
        assert 0 < tilt["roll_sigma_rad"] < 0.05
