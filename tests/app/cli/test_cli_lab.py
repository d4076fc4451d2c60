"""The commands of the lab: table, strain and bench; the one of scans is tested with scans."""

import csv

import platformdirs
import pytest

from tactune.app.cli import lab
from tactune.core.lab import bench, table
from tactune.core.sources.registry import open_source

GRID = "sim:cup?press=low&grid=dots"


def test_the_table_prints_cell_by_cell_and_goes_on_where_it_stopped(tactune, tmp_path, monkeypatch):
    monkeypatch.setattr(table, "time_table", lambda plan: {})
    monkeypatch.setattr(table, "available_threads", lambda: 1)  # in this process: with coarse scenes
    command = [
        "lab", "table", "--objects", "cup", "--presses", "low,medium", "--membranes", "standard", "--seeds", 1,
        "--methods", "proximity-only,fusion-rigid", "--csv", tmp_path / "cells.csv",
    ]  # fmt: skip
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda _: str(tmp_path))
    status, out, err = tactune(*command)
    assert status == 0
    assert [line[:4] for line in err.splitlines()] == ["1/2 ", "2/2 "]
    assert [line.split()[1] for line in out.splitlines()[1:3]] == ["proximity-only", "fusion-rigid"]
    rows = list(csv.DictReader((tmp_path / "cells.csv").read_text().splitlines()))
    assert [(row["press"], row["method"]) for row in rows] == [
        (press, method) for press in ("low", "medium") for method in ("proximity-only", "fusion-rigid")
    ]
    monkeypatch.setattr(table, "score", None)
    assert tactune(*command).status == 0, "nothing is measured again"
    status, _, err = tactune("lab", "table", "--sensors", "blind")
    assert status == 2 and "no sensor 'blind'" in err


def test_strain_beside_the_solvers(tactune, tmp_path):
    with open_source(GRID) as source:
        facts = source.facts(0)
    lines = tmp_path / "strain.csv"
    status, out, _ = tactune("lab", "strain", "--source", GRID, "--frames", 3, "--average", 2, "--csv", lines)
    assert status == 0 and len(out.splitlines()) == 4
    records = list(csv.DictReader(lines.read_text().splitlines()))
    assert [record["averaged_frames"] for record in records] == ["1", "2", "2"]
    assert float(records[2]["solver_length_percent"]) == pytest.approx(100 * facts.strain.length_seen, abs=0.01)
    assert float(records[2]["length_percent"]) == pytest.approx(100 * facts.strain.length_seen, abs=5)
    status, _, err = tactune("lab", "strain", "--source", "sim:cup?press=low", "--frames", 1)
    assert status == 2 and "grid of dots" in err


def test_the_bench_compares(tactune, monkeypatch):
    monkeypatch.setattr(lab, "_ROUNDS", 1)
    monkeypatch.delitem(bench.ENGINES, "open3d")
    monkeypatch.setattr(bench, "SCENES", {"empty": bench.SCENES["empty"]})
    status, out, _ = tactune("lab", "bench")
    assert status == 0 and "numpy" in out and "tactune" in out
