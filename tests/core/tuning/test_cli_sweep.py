"""``tactune sweep``: options, table, best preset and terminal output."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from pyarrow import parquet

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.preset.file import preset_json, save_preset
from tactune.core.rig.untouched import load_untouched, save_untouched
from tactune.core.sources.folder import FolderSource
from tactune.core.sources.presets import load_preset

SETS = ("--set", "tolerance.t=0.002,0.007,0.03", "--set", "outliers.k=5,20")


def rows_of(path: Path) -> list[dict[str, object]]:
    return parquet.read_table(path).to_pylist()


def test_table_and_best_preset(sweep, make_recording, tmp_path):
    one, other = make_recording("one"), make_recording("other", seed=5)
    done = sweep("-s", one, "-s", other, *SETS, "--objective", "iou", "--best", "best.json")
    assert done.status == 0, done.err
    rows = rows_of(tmp_path / "work" / "sweep.parquet")
    assert len(rows) == 12
    assert {(row["source"], row["tolerance.t"], row["outliers.k"]) for row in rows} == {
        (source, t, k) for source in (one, other) for t in (0.002, 0.007, 0.03) for k in (5, 20)
    }
    for row in rows:
        assert row["mask.hue"] == [0, 179] and row["alignment.model"] == "rigid" and row["contact_test"] == "tolerance"
        assert row["ms"] > 0 and row["failure"] == "" and row["frames"] == 3
    means: dict[tuple[object, object], float] = {}
    for row in rows:
        key = row["tolerance.t"], row["outliers.k"]
        means[key] = means.get(key, 0.0) + row["iou"] / 2
    best = load_preset(tmp_path / "work" / "best.json")
    assert (best.tolerance.t, best.outliers.k) == max(means, key=means.__getitem__)
    assert best.tolerance.t == 0.007
    assert best.name == "default, best iou"
    assert "Best of 6 settings by iou" in best.notes and one in best.notes and "tolerance.t 0.007" in best.notes
    source = FolderSource(tmp_path / "one")
    found = [len(ContactPipeline(best, source.rig).process(source.read(index)).points) for index in range(3)]
    (row,) = (
        row for row in rows
        if (row["source"], row["tolerance.t"], row["outliers.k"]) == (one, best.tolerance.t, best.outliers.k)
    )  # fmt: skip
    assert sum(found) / 3 == pytest.approx(row["points"])
    table = done.out.splitlines()
    first = next(line for line in table if line.strip().startswith("0.0"))
    assert first.split()[:2] == ["0.007", str(best.outliers.k)]
    assert "Mean iou over all other parameters" in done.out


def test_the_same_command_does_nothing_twice_and_a_sweep_file_says_the_same(sweep, recording, tmp_path):
    done = sweep("-s", recording, *SETS, "--frames", "1:3")
    assert done.status == 0
    assert "frames" not in done.err
    journal = tmp_path / "work" / "sweep.runs.jsonl"
    before, table = journal.read_bytes(), rows_of(tmp_path / "work" / "sweep.parquet")
    asked = {
        "source": [recording], "set": {"tolerance.t": [0.002, 0.007, 0.03], "outliers.k": "5,20"}, "frames": "1:3",
        "objective": "iou", "preset": "tolerance.json",
    }  # fmt: skip
    (tmp_path / "sweep.json").write_text(json.dumps(asked))
    done = sweep("--file", tmp_path / "sweep.json", "--json")
    document = json.loads(done.out)
    assert journal.read_bytes() == before
    assert rows_of(tmp_path / "work" / "sweep.parquet") == table
    assert (document["runs"], document["failed"], document["objective"]) == (6, 0, "iou")
    values = [found["value"] for found in document["top"]]
    assert values == sorted(values, reverse=True)
    assert {(effect["parameter"], effect["value"]) for effect in document["effects"]} == {
        ("tolerance.t", "0.002"), ("tolerance.t", "0.007"), ("tolerance.t", "0.03"), ("outliers.k", "5"),
        ("outliers.k", "20"),
    }  # fmt: skip
    wider = sweep("--file", tmp_path / "sweep.json", "--set", "outliers.k=5,20,30")
    assert wider.status == 0
    assert journal.read_bytes().startswith(before) and len(journal.read_bytes().splitlines()) == 1 + 9


def test_a_sample_runs_so_many_and_its_effects_are_grouped(sweep, recording, tmp_path):
    done = sweep("-s", recording, "--set", "tolerance.t=0.002:0.03:log", "--sample", 20, "--seed", 3, "--json")
    document = json.loads(done.out)
    assert document["runs"] == 20
    assert len({row["tolerance.t"] for row in rows_of(tmp_path / "work" / "sweep.parquet")}) == 20
    assert [effect["runs"] for effect in document["effects"]] == [4] * 5


def test_without_truth_the_steadiest_is_best_and_no_error_can_be_asked_for(sweep, make_recording):
    blind = make_recording(with_truth=False)
    document = json.loads(sweep("-s", blind, *SETS, "--json").out)
    assert document["objective"] == "stability"
    assert "has no ground truth" in sweep("-s", blind, *SETS, "--objective", "rmse_mm", "-o", "b.parquet").sentence


def test_seeds_are_for_simulated_sources(sweep, recording):
    done = sweep("-s", recording, "--seeds", 3)
    assert done.status == 0
    assert "--seeds changes the noise of simulated sources only" in done.err


def test_frames_that_a_source_does_not_have_are_said(sweep, recording):
    done = sweep("-s", recording, "--frames", "1:99", "-p", "default")
    assert done.status == 0
    assert f"{recording} ends after 3 frames, so of --frames 1:99 only 2 are used" in done.err


def test_frames_that_are_few_or_far_apart_to_average_are_said(sweep, recording):
    few = f"{recording} gives 3 frames, so membrane.frames 15 averages no more than that"
    done = sweep("-s", recording, "--method", "fusion-averaged", "-p", "default")
    assert done.status == 0 and done.err.count(few) == 1
    far = f"{recording} gives one frame in 2, so membrane.frames 2 averages frames that do not follow each other"
    sets = ("--set", "contact_test=membrane", "--set", "membrane.frames=1,2", "-p", "default")
    assert sweep("-s", recording, *sets, "--frames", "::2", "-o", "far.parquet").err.count(far) == 1
    for words in (sets, ("--method", "fusion-membrane", "-p", "default", "--frames", "::2")):
        assert "membrane.frames" not in sweep("-s", recording, *words, "--replace").err


def test_the_table_tells_the_values_that_a_method_sets_itself(sweep, recording, tmp_path):
    methods = ("--method", "fusion-homography", "--method", "fusion-averaged", "--method", "fusion")
    assert sweep("-s", recording, *methods, "-p", "default", "--set", "range.enabled=false").status == 0
    base = load_preset("default")
    usual = base.contact_test, base.alignment.model, base.membrane.frames
    assert {
        row["method"]: (row["contact_test"], row["alignment.model"], row["membrane.frames"])
        for row in rows_of(tmp_path / "work" / "sweep.parquet")
    } == {
        "fusion-homography": ("tolerance", "homography", base.membrane.frames),
        "fusion-averaged": ("membrane", "rigid", 15),
        "fusion": usual,
    }


def test_a_best_value_at_the_edge_is_said_in_words_and_json(sweep, recording):
    words = ("-s", recording, "--set", "tolerance.t=0.002,0.003,0.004", "--objective", "iou")
    assert "The best tolerance.t, 0.004, is the largest tried; try larger ones, too." in sweep(*words).out
    found = json.loads(sweep(*words, "--json").out)["at_edge"]
    assert found == [{"parameter": "tolerance.t", "value": 0.004, "edge": "largest"}]


def test_a_table_is_not_replaced_by_one_that_has_not_all_its_runs(sweep, recording, tmp_path):
    table = tmp_path / "work" / "sweep.parquet"
    assert sweep("-s", recording, "--set", "outliers.k=5,20").status == 0
    before = table.read_bytes()
    other = ("-s", recording, "--set", "outliers.k=5,30")
    sentence = sweep(*other).sentence
    assert "sweep.parquet has 1 of its 2 runs from another sweep" in sentence and "--replace" in sentence
    assert table.read_bytes() == before
    assert sweep(*other, "--replace").status == 0
    assert [row["outliers.k"] for row in rows_of(table)] == [5, 30]
    table.write_bytes(b"damaged")
    assert "is no table of a sweep" in sweep(*other).sentence


def test_failed_runs_are_rows_with_a_reason(sweep, recording, tmp_path):
    done = sweep("-s", recording, "--method", "fusion", "--method", "mechanics")
    assert done.status == 0
    assert "1 run failed, such as: mechanics compares with the untouched membrane" in done.err
    rows = {row["method"]: row for row in rows_of(tmp_path / "work" / "sweep.parquet")}
    assert rows["fusion"]["failure"] == "" and rows["mechanics"]["rmse_mm"] is None


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), "give --source"),
        (("-s", "REC", "--set", "tolerance.q=1"), "did you mean tolerance.t"),
        (("-s", "REC", "--set", "tolerance.t=3"), "allowed: 0 to 1"),
        (("-s", "REC", "--set", "tolerance.t=0:1:1000", "--set", "outliers.k=1:1000:1000"), "--sample N"),
        (("-s", "REC", "--set", "tolerance.t=0:1", "--sample", "1000000"), "smaller --sample"),
        (("-s", "REC", "--sample", "5"), "nothing to sample"),
        (("-s", "REC", "--set", "tolerance.t=0.1", "--set", "tolerance.t=0.2"), "given twice"),
        (("-s", "REC", "--objective", "beauty"), "there is no objective 'beauty'"),
        (("-s", "REC", "--method", "magic"), "there is no method 'magic'"),
        (
            ("-s", "REC", "--method", "fusion", "--method", "fusion-averaged", "--set", "membrane.frames=1,5"),
            "fusion-averaged always has membrane.frames 15, so other values would change nothing; use",
        ),
        (("-s", "REC", "--method", "fusion-rigid", "--set", "contact_test=membrane"), "contact_test tolerance"),
        (
            ("-s", "REC", "--method", "fusion-homography", "--set", "alignment.model=rigid,homography"),
            "remove --set alignment.model",
        ),
        (("-s", "REC", "--method", "mechanics", "--best", "b.json"), "no preset can name the method mechanics"),
        (("-s", "REC", "--frames", "9:"), "has 3 frames"),
        (("-s", "REC", "--out", "sweep.csv"), "ends in .parquet"),
        (("-s", "REC", "--best", "sweep.parquet"), "name two files"),
        (("-s", "live:sim:cup",), "record it first"),
        (("-s", "folder:/nowhere",), "there is no folder"),
        (("-s", "REC", "--file", "missing.json"), "cannot read missing.json"),
        (("-s", "REC", "--file", "/dev/zero"), "no ordinary file"),
        (("-s", "REC", "--best", "sweep.runs.jsonl"), "name two files"),
        (("-s", "REC", "--best", "/tmp"), "which is not a file"),
        (("-s", "REC", "--scheduler", "nonsense"), "is no scheduler's address"),
        (("-s", "REC", "--scheduler", "tcp://127.0.0.1:1", "--jobs", "2"), "remove it or --scheduler"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_said_before_anything_runs(sweep, recording, tmp_path, words, expected):
    done = sweep(*(recording if word == "REC" else word for word in words))
    assert expected in done.sentence
    assert list((tmp_path / "work").iterdir()) == []


def test_sweep_files_with_mistakes_are_refused(sweep, tmp_path):
    for text, words in (("{", "sweep has the fields"), ('{"sources": []}', "sources"), ('{"seeds": "2"}', "seeds")):
        (tmp_path / "s.json").write_text(text)
        assert words in sweep("--file", tmp_path / "s.json").sentence


def test_a_table_that_no_sweep_has_written_is_left_alone(sweep, recording, tmp_path):
    (tmp_path / "mine.parquet").write_text("precious")
    assert "already there" in sweep("-s", recording, "-o", tmp_path / "mine.parquet").sentence
    assert (tmp_path / "mine.parquet").read_text() == "precious"


def test_the_best_preset_replaces_only_what_a_sweep_has_written(sweep, recording, tmp_path):
    mine = tmp_path / "mine.json"
    mine.write_text(preset_json(load_preset("default")))
    assert "was not written by a sweep" in sweep("-s", recording, "--best", mine).sentence
    assert "starts from" in sweep("-s", recording, "-p", mine, "--best", mine).sentence
    assert mine.read_text() == preset_json(load_preset(mine))
    for _ in range(2):
        assert sweep("-s", recording, "-p", mine, "--best", "best.json").status == 0


def test_the_best_preset_takes_the_untouched_frame_of_its_preset_along(sweep, recording, tmp_path):
    (tmp_path / "there").mkdir()
    begun, best = tmp_path / "there" / "begun.json", tmp_path / "best.json"
    kept = save_untouched(FolderSource(tmp_path / "rec").read(0), 1, begun)
    save_preset(load_preset("default").model_copy(update={"untouched": kept}), begun)
    assert sweep("-s", recording, "-p", begun, "--best", best).status == 0
    assert load_untouched(load_preset(best).untouched, best).sequence == 0


def test_other_methods_compare_with_the_presets_own_untouched_frame(sweep, recording, tmp_path):
    begun = tmp_path / "begun.json"
    kept = save_untouched(FolderSource(tmp_path / "rec").read(0), 1, begun)
    save_preset(load_preset("default").model_copy(update={"untouched": kept}), begun)
    for preset, failures in (("default", 1), (begun, 0)):
        words = ("-s", recording, "-p", preset, "--method", "tactile-threshold", "--json")
        document = json.loads(sweep(*words, "-o", f"{failures}.parquet").out)
        assert document["failed"] == failures


@pytest.mark.parametrize(
    ("module", "words", "extra"),
    [("pyarrow", (), "sweep"), ("joblib", (), "sweep"), ("distributed", ("--scheduler", "tcp://h:1"), "cluster")],
)
def test_a_missing_extra_is_named(sweep, recording, monkeypatch, module, words, extra):
    monkeypatch.setitem(sys.modules, module, None)
    assert f"pip install 'tactune[{extra}]'" in sweep("-s", recording, *words).sentence
