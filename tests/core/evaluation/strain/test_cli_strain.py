from __future__ import annotations

import csv
import json

import pytest

from tactune.core.sources.registry import open_source

SOURCE = "sim:cup?press=low&grid=dots&sensor=datasheet"


def test_json_has_a_line_a_frame_and_frames_at_rest_are_averaged(tactune):
    with open_source(SOURCE) as source:
        facts = source.facts(0)
    status, out, _ = tactune("strain", "--source", SOURCE, "--frames", 3, "--average", 2, "--json")
    assert status == 0
    record, *others = map(json.loads, out.splitlines())
    assert [record["averaged_frames"], *(other["averaged_frames"] for other in others)] == [1, 2, 2]
    assert record["sequence"] == 0
    assert record["displacement_mm"] == 0.0
    assert record["dots"] == 665
    assert record["strain_length_percent"] == pytest.approx(100 * facts.strain_length, abs=2.0)
    assert record["strain_width_percent"] == pytest.approx(100 * facts.strain_width, abs=2.0)
    assert record["true_strain_width_percent"] == pytest.approx(100 * facts.strain_width, abs=0.01)
    assert record["true_strain_length_seen_percent"] == pytest.approx(100 * facts.strain_length_seen, abs=0.01)


def test_the_spacing_counts_and_table_csv_and_figure_are_written(tactune, tmp_path, monkeypatch):
    figures = pytest.importorskip("matplotlib.figure").Figure
    save, drawn = figures.savefig, {}

    def look(figure, *words, **options):
        drawn.update({line.get_label(): line.get_ydata() for line in figure.axes[0].lines})
        save(figure, *words, **options)

    monkeypatch.setattr(figures, "savefig", look)
    table, figure = tmp_path / "strain.csv", tmp_path / "strain.png"
    status, out, err = tactune(
        "strain", "--source", SOURCE, "--frames", 1, "--spacing-mm", 12, "--csv", table, "--plot", figure
    )
    assert status == 0
    assert err == "tactune: measuring strain in 1 frame ...\n"
    assert f"wrote {table}" in out and f"wrote {figure}" in out
    head, line, *_ = out.splitlines()
    assert "solver: seen (all)" in head
    assert "665" in line and line.endswith(")")
    (row,) = csv.DictReader(table.read_text().splitlines())
    for direction in ("length", "width"):
        assert drawn[f"{direction}, measured"] == [float(row[f"strain_{direction}_percent"])]
        known = float(row[f"true_strain_{direction}_seen_percent"])
        assert drawn[f"{direction}, solver at the dots seen"] == [known]
    assert float(row["strain_length_percent"]) < 2.0  # (1 + 0.16) 10 / 12 - 1 is below 0
    assert figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "words, sentence",
    [
        (("--source", "sim:cup?press=medium", "--frames", 1), "no grid of dots is seen"),
        (("--spacing-mm", 0), "spacing is 0 mm"),
        (("--source", "sim:nothing"), "nothing"),
    ],
)
def test_what_cannot_be_measured_ends_with_a_sentence(tactune, words, sentence, tmp_path):
    table = tmp_path / "strain.csv"
    status, out, err = tactune("strain", *words, "--csv", table)
    assert (status, out) == (2, "")
    assert sentence in err
    assert "Traceback" not in err
    assert not table.exists()


@pytest.mark.parametrize("option", ["--csv", "--plot"])
def test_a_place_that_cannot_be_written_is_told_before_frames_are_measured(tactune, tmp_path, option):
    (tmp_path / "file").touch()
    target = tmp_path / "file" / "strain.png"
    status, out, err = tactune("strain", "--source", SOURCE, "--frames", 1, option, target)
    assert (status, out) == (2, "")
    assert f"cannot write {target}" in err
    assert "measuring" not in err


def test_a_figure_must_be_a_png(tactune, tmp_path):
    status, _, err = tactune("strain", "--plot", tmp_path / "strain.jpg")
    assert status == 2
    assert ".png" in err
