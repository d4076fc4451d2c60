"""``tactune tune``: options, samplers, front, best preset, the file of trials, and errors in a sentence."""

import json
from pathlib import Path

import numpy as np
import pytest

from long_search import front_of, lines_of, trials_of
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.model.metrics import pixel_scores
from tactune.core.preset.file import save_preset
from tactune.core.rig.untouched import load_untouched, save_untouched
from tactune.core.sources.folder import FolderSource
from tactune.core.sources.presets import load_preset

GRID = ("--set", "tolerance.t=0.002,0.007,0.03", "--set", "outliers.k=5,20")


def test_a_grid_tries_each_combination_and_writes_the_best_preset(tune, make_recording, tmp_path):
    one, other = make_recording("one"), make_recording("other", seed=5)
    done = tune("-s", one, "-s", other, *GRID, "--objective", "iou,rmse", "--out", "best.json")
    assert done.status == 0, done.err
    assert "Not beaten by any of 6 trials" in done.out
    again = tune("-s", one, "-s", other, *GRID, "--objective", "iou,rmse", "--study", "best.study.log", "--json")
    trials = trials_of(again.out)
    assert sorted(trials) == list(range(6)), "the trials of the first run are told again, and none is added"
    best = load_preset(tmp_path / "work" / "best.json")
    top = max(trials.values(), key=lambda trial: trial["figures"]["iou"])
    assert top["values"] == {"tolerance.t": best.tolerance.t, "outliers.k": best.outliers.k}
    assert best.tolerance.t == 0.007 and best.name == "default, tuned"
    assert f"Trial {top['number']} of 6, found by tactune tune" in best.notes and one in best.notes
    means = []
    for name in ("one", "other"):
        source = FolderSource(tmp_path / name)
        pipeline = ContactPipeline(best, source.rig)
        scores = [pixel_scores(pipeline.process(frame).mask, frame.truth.contact).iou for frame in source]
        means.append(np.nanmean(scores))
    assert top["figures"]["iou"] == pytest.approx(sum(means) / 2)


def test_a_search_begins_with_the_present_preset_and_is_never_worse(tune, recording):
    words = ("-s", recording, "--objective", "iou,ms", "--trials", 24, "--json")
    done = tune(*words)
    assert done.status == 0, done.err
    trials = trials_of(done.out)
    assert len(trials) == 24
    assert trials[0]["present"] and trials[0]["values"]["tolerance.t"] == 0.03
    front = lines_of(done.out)[-1]["front"]
    assert trials[front[0]]["figures"]["iou"] == max(trial["figures"]["iou"] for trial in trials.values())
    assert trials[front[0]]["figures"]["iou"] > trials[0]["figures"]["iou"]
    for number in front:  # no trial is better in both
        mine = trials[number]["figures"]
        others = (trial["figures"] for trial in trials.values() if trial["figures"]["points"])
        assert not any(other["iou"] >= mine["iou"] and other["ms"] < mine["ms"] for other in others)
    more = trials_of(tune(*words, "--trials", 30).out)
    assert len(more) == 30 and all(more[number] == trial for number, trial in trials.items())
    drawn = [json.dumps(trial["values"]) for trial in more.values()]
    assert len(set(drawn)) == 30, "a search that goes on draws the same trials again"


def test_without_truth_the_most_stable_is_best_and_what_finds_nothing_is_not(tune, make_recording):
    blind = make_recording(with_truth=False)
    sets = ("--set", "range.limits_m=[1,2],[0.1,0.5]", "--set", "range.enabled=true", "--set", "tolerance.t=0.01,0.1")
    done = tune("-s", blind, *sets, "--json")
    assert lines_of(done.out)[0]["objectives"] == ["stability", "ms"]
    assert {tuple(values["range.limits_m"]) for values in front_of(done.out)} == {(0.1, 0.5)}
    assert "has no ground truth" in tune("-s", blind, *sets, "--objective", "rmse").sentence
    nothing = ("--set", "range.limits_m=[1,2]", "--set", "range.enabled=true", "--objective", "ms")
    assert "no trial found any contact" in tune("-s", blind, *nothing, "--study", "n.log").sentence


def test_a_best_value_at_the_end_of_its_range_is_said(tune, recording):
    done = tune("-s", recording, "--set", "tolerance.t=0.002,0.003,0.004", "--objective", "iou")
    assert "The best tolerance.t, 0.004, is the largest one that was allowed." in done.out


@pytest.mark.parametrize(("text", "expected"), [("2", [0, 1]), ("1:4", [1, 2]), ("::2", [0, 2])])
def test_frames_as_people_write_them(tune, recording, tmp_path, text, expected):
    words = ("--set", "tolerance.t=0.007", "--objective", "iou", "--json")
    (trial,) = trials_of(tune("-s", recording, "--frames", text, *words).out).values()
    source = FolderSource(tmp_path / "rec")
    pipeline = ContactPipeline(load_preset("default").with_values(
        {"contact_test": "tolerance", "tolerance.t": 0.007}), source.rig)  # fmt: skip
    frames = [source.read(index) for index in expected]
    scores = [pixel_scores(pipeline.process(frame).mask, frame.truth.contact).iou for frame in frames]
    assert trial["figures"]["iou"] == pytest.approx(np.nanmean(scores))


def test_the_best_preset_keeps_the_untouched_frame(tune, recording, tmp_path):
    source = FolderSource(tmp_path / "rec")
    path = tmp_path / "base.json"
    base = load_preset("default").with_value("contact_test", "tolerance")
    record = save_untouched(source.read(0), 1, path)
    save_preset(base.with_value("untouched", record.model_dump(mode="json")), path)
    (tmp_path / "else").mkdir()
    out = tmp_path / "else" / "best.json"
    assert tune("-s", recording, "-p", path, *GRID, "--objective", "iou", "--out", out).status == 0
    best = load_preset(out)
    assert load_untouched(best.untouched, out).proximity_depth.shape == source.read(0).proximity_depth.shape


def test_a_file_of_something_else_is_left_alone(tune, recording, tmp_path):
    notes = tmp_path / "notes"
    for content in ("mine\n", '{"name": "mine"}'):
        notes.write_text(content)
        assert "is not the file of a search" in tune("-s", recording, *GRID, "--study", notes).sentence
        assert "was not written by a search" in tune("-s", recording, *GRID, "--out", notes).sentence
        assert notes.read_text() == content


@pytest.mark.parametrize("line", ['{"op_code":"x","worker_id":3}', '{"op_code":' + "[" * 100_000])
def test_a_damaged_file_is_told_in_one_sentence(tune, recording, tmp_path, line):
    study = tmp_path / "s.log"
    study.write_text(f"{line}\n")
    assert "is damaged, not the file of a search" in tune("-s", recording, *GRID, "--study", study).sentence
    assert study.read_text() == f"{line}\n"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("-s", "REC", "--set", "tolerance.t=0.1", "--set", "tolerance.t=0.2"), "given twice"),
        (("-s", "REC", "--objective", "beauty"), "there is no objective 'beauty'"),
        *((("-s", "REC", "--frames", text), "has 3 frames") for text in ("9:", "0", "4:2")),
        *((("-s", "REC", "--frames", text), "write a number of frames") for text in ("a", "1:2:0", "-1", "")),
        (("-s", "REC", "--out", "/dev/null/best.json"), "cannot write"),
        (("-s", "REC", "--study", "/dev/zero"), "no ordinary file"),
        (("-s", "REC", "--frames", "1", "--objective", "stability"), "there is only one"),
        (("-s", "live:sim:cup"), "record it first"),
        (("-s", "folder:/nowhere"), "there is no folder"),
        (("-s", "REC", "--scheduler", "nonsense"), "no Dask scheduler with a worker answers at nonsense"),
        (("-s", "REC", "--scheduler", "tcp://127.0.0.1:1", "--jobs", "2"), "remove it or --scheduler"),
    ],
)
def test_errors_are_one_sentence(tune, recording, words, expected):
    assert expected in tune(*(recording if word == "REC" else word for word in words)).sentence


def test_a_preset_that_the_search_starts_from_is_not_replaced(tune, recording, tolerance_preset):
    before = tolerance_preset.read_text()
    assert "starts from" in tune("-s", recording, *GRID, "--out", tolerance_preset).sentence
    assert tolerance_preset.read_text() == before
    assert Path(tolerance_preset).exists()
