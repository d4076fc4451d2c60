"""``tactune preset new | show | validate | schema``."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tactune.core.contact.checks import preset_notes
from tactune.core.model.rig_file import load_rig
from tactune.core.preset import Preset
from tactune.core.preset import file as preset_file
from tactune.core.preset.file import save_preset
from tactune.core.preset.preset import json_schema
from tactune.core.rig.untouched import load_untouched, save_untouched
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source

Tactune = Callable[..., Any]


def test_new_writes_a_preset_for_the_rig_with_what_was_set(tactune: Tactune, recording: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.json"
    finished = tactune(
        *("preset", "new", "--rig", recording / "rig.json", "--set", "alignment.model=homography", "--out", file),
        *("--set", "mask.hue=[150,170]", "--set", "tolerance.t=0.01", "--set", "notes=on the bench"),
    )
    assert finished.status == 0
    preset = load_preset(file)
    assert preset.name == "mine"
    assert preset.rig == load_rig(recording / "rig.json")
    assert preset.alignment.model == "homography"
    assert preset.mask.hue == (150, 170)
    assert preset.mask.enabled
    assert preset.tolerance.t == 0.01
    assert preset.notes == "on the bench"
    assert not preset.range.enabled
    assert preset.outliers == Preset().outliers


def test_a_section_stays_off_when_told_so(tactune: Tactune, recording: Path, tmp_path: Path) -> None:
    words = ["--set", "mask.hue=[1,2]", "--set", "mask.enabled=false", "--set", "name=quiet"]
    assert tactune("preset", "new", "--rig", recording / "rig.json", "--out", tmp_path / "a.json", *words).status == 0
    preset = load_preset(tmp_path / "a.json")
    assert preset.mask.hue == (1, 2)
    assert not preset.mask.enabled
    assert preset.name == "quiet"


def test_the_contact_test_is_chosen_by_name_or_by_one_of_its_fields(
    tactune: Tactune, recording: Path, tmp_path: Path
) -> None:
    def made(name: str, *settings: str) -> Preset:
        words = [word for setting in settings for word in ("--set", setting)]
        assert tactune("preset", "new", "--rig", recording / "rig.json", "--out", tmp_path / name, *words).status == 0
        return load_preset(tmp_path / name)

    assert made("a.json").contact_test == "membrane", "the default"
    assert made("b.json", "contact_test=tolerance").contact_test == "tolerance"
    share = made("e.json", "tolerance.t=0.01")
    assert (share.contact_test, share.tolerance.t) == ("tolerance", 0.01)
    gap = made("c.json", "membrane.gap_m=0.001")
    assert (gap.contact_test, gap.membrane.gap_m) == ("membrane", 0.001)
    assert made("d.json", "membrane.gap_m=0.001", "contact_test=tolerance").contact_test == "tolerance"


def test_run_takes_the_contact_test_of_the_preset(tactune: Tactune, recording: Path, tmp_path: Path) -> None:
    file = tmp_path / "fine.json"
    words = ["--set", "membrane.gap_m=0.0001", "--set", "membrane.min_area_mm2=0"]
    assert tactune("preset", "new", "--rig", recording / "rig.json", "--out", file, *words).status == 0
    finished = tactune("run", "--source", f"folder:{recording}", "--preset", file, "--json", "--truth")
    assert finished.status == 0
    records = [json.loads(line) for line in finished.out.splitlines()]
    assert set(records[0]["stage_ms"]) == {"fusion", "equilibrium", "edge", "clusters", "points"}
    assert records[0]["points"] == 0
    assert all(record["iou"] > 0.8 for record in records[2:])


def test_the_rig_comes_from_a_source_or_another_preset_too(tactune: Tactune, recording: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    assert tactune("preset", "new", "--rig", f"folder:{recording}", "--out", first).status == 0
    assert tactune("preset", "new", "--rig", first, "--out", second).status == 0
    assert load_preset(second).rig == load_rig(recording / "rig.json")


def test_new_starts_from_another_preset_and_its_rig(tactune: Tactune, recording: Path, tmp_path: Path) -> None:
    first, second, third = (tmp_path / f"{name}.json" for name in ("first", "second", "third"))
    rig = load_rig(recording / "rig.json")
    values = {"notes": "by hand", "tolerance.t": 0.011, "outliers.k": 7, "created": "2020-01-02T03:04:05Z"}
    save_preset(Preset(name="named", rig=rig).with_values(values), first)

    assert tactune("preset", "new", "--from", first, "--set", "outliers.k=9", "--out", second).status == 0
    preset = load_preset(second)
    assert (preset.name, preset.rig, preset.notes) == ("second", rig, "by hand")
    assert (preset.tolerance.t, preset.outliers.k) == (0.011, 9)
    assert preset.created.year > 2020

    words = ["--rig", recording / "rig.json", "--set", "alignment.model=homography", "--set", "name=other"]
    assert tactune("preset", "new", "--from", "simulator", *words, "--out", third).status == 0
    preset, shipped = load_preset(third), load_preset("simulator")
    assert (preset.name, preset.rig, preset.alignment.model) == ("other", rig, "homography")
    assert (preset.mask, preset.tolerance) == (shipped.mask, shipped.tolerance)


def test_a_start_that_was_made_for_another_rig_is_noted(tactune: Tactune, recording: Path, tmp_path: Path) -> None:
    first, second, third = (tmp_path / f"{name}.json" for name in ("first", "second", "third"))
    rig = load_rig(recording / "rig.json")
    other = rig.model_copy(update={"tactile": rig.tactile.model_copy(update={"serial": "another"})})
    save_preset(Preset(rig=other, contact_test="tolerance"), first)
    assert (
        "calibrate again"
        in tactune("preset", "new", "--from", first, "--rig", recording / "rig.json", "-o", second).err
    )
    assert tactune("preset", "new", "--from", first, "-o", third).err == ""


def test_without_a_rig_anywhere_or_with_nothing_to_start_from_is_one_sentence(tactune: Tactune, tmp_path: Path) -> None:
    out = tmp_path / "mine.json"
    assert "--rig" in tactune("preset", "new", "--out", out).sentence
    sentence = tactune("preset", "new", "--from", "default", "--out", out).sentence
    assert "preset default names no rig" in sentence
    assert "--rig" in sentence
    assert "nothing" in tactune("preset", "new", "--from", "nothing", "--out", out).sentence
    assert not out.exists()


def test_the_untouched_frame_goes_along_with_the_preset_that_new_starts_from(
    tactune: Tactune, recording: Path, tmp_path: Path
) -> None:
    first, second = tmp_path / "first.json", tmp_path / "elsewhere" / "second.json"
    second.parent.mkdir()
    with open_source(str(recording)) as source:
        frame = source.next_frame()
    assert frame is not None
    record = save_untouched(frame, 1, first)
    save_preset(Preset(rig=source.rig, untouched=record), first)
    assert tactune("preset", "new", "--from", first, "--out", second).status == 0
    load_untouched(record, second)

    (first.parent / record.file).unlink()
    third = tmp_path / "third.json"
    assert "untouched" in tactune("preset", "new", "--from", first, "--out", third).sentence
    assert not third.exists()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ([], ["mask.hue"]),
        (["contact_test=tolerance"], []),
        (["contact_test=tolerance", "alignment.model=homography"], []),
        (["membrane.gap_m=0.001", "mask.hue=[150,170]"], []),
        (["contact_test=membrane"], ["mask.hue"]),
        (["contact_test=membrane", "mask.hue=[150,170]", "alignment.model=homography"], ["one plane"]),
        (["contact_test=membrane", "alignment.model=homography"], ["mask.hue", "one plane"]),
    ],
)
def test_what_is_probably_not_meant_is_noted_and_nothing_else(
    tactune: Tactune, recording: Path, tmp_path: Path, settings: list[str], words: list[str]
) -> None:
    file = tmp_path / "mine.json"
    options = [word for setting in settings for word in ("--set", setting)]
    new = tactune("preset", "new", "--rig", recording / "rig.json", "--out", file, *options)
    checked = tactune("preset", "validate", file)
    assert (new.status, checked.status) == (0, 0)
    assert new.err == checked.err == "".join(f"note: {note}\n" for note in preset_notes(load_preset(file)))
    assert new.err.count("note: ") == len(words)
    for line, word in zip(new.err.splitlines(), words, strict=True):
        assert word in line


def test_a_file_is_replaced_only_by_force(tactune: Tactune, recording: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.json"
    words = ["preset", "new", "--rig", recording / "rig.json", "--out", file]
    assert tactune(*words).status == 0
    before = file.read_bytes()
    assert "--force" in tactune(*words, "--set", "tolerance.t=0.5").sentence
    assert file.read_bytes() == before
    assert tactune(*words, "--set", "tolerance.t=0.5", "--force").status == 0
    assert load_preset(file).tolerance.t == 0.5


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("mask.hues=[1,2]", ["mask.hues", "mask.hue?"]),
        ("tolerance.t=7", ["tolerance.t", "7", "0 to 1"]),
        ("tolerance.t=high", ["tolerance.t", "high"]),
        ("tolerance.t=NaN", ["tolerance.t"]),
        ("mask.hue=[1,2,3]", ["mask.hue"]),
        ("mask.hue=[1,180]", ["mask.hue[1]", "180", "0 to 179"]),
        ("outliers.k=2.5", ["outliers.k", "2.5"]),
        ("mask.enabled=maybe", ["mask.enabled", "maybe"]),
        ("range.limits_m=[0.5,0.1]", ["range.limits_m"]),
        ("alignment=rigid", ["alignment"]),
        ("tolerance.t", ["tolerance.t", "FIELD=VALUE"]),
        ("mask.hue=" + "[" * 50_000, ["mask.hue"]),
        ("alignment.rigid.T_proximity_tactile={}", ["alignment.rigid.T_proximity_tactile"]),
    ],
)
def test_a_bad_setting_is_named_and_nothing_written(
    tactune: Tactune, recording: Path, tmp_path: Path, setting: str, named: list[str]
) -> None:
    file = tmp_path / "mine.json"
    sentence = tactune("preset", "new", "--rig", recording / "rig.json", "--out", file, "--set", setting).sentence
    for word in named:
        assert word in sentence
    assert not file.exists()


def test_a_bad_alignment_a_bad_rig_and_a_bad_place_are_named(tactune: Tactune, recording: Path, tmp_path: Path) -> None:
    rig = recording / "rig.json"
    out = tmp_path / "mine.json"
    assert (
        "sideways" in tactune("preset", "new", "--rig", rig, "--set", "alignment.model=sideways", "--out", out).sentence
    )
    assert "nowhere" in tactune("preset", "new", "--rig", "nowhere", "--out", out).sentence
    assert "/dev/null" in tactune("preset", "new", "--rig", rig, "--out", "/dev/null/mine.json").sentence

    for_any_rig = tmp_path / "any.json"
    save_preset(Preset(), for_any_rig)
    assert "any.json" in tactune("preset", "new", "--rig", for_any_rig, "--out", out).sentence
    rig.write_text("{")
    assert "rig.json" in tactune("preset", "new", "--rig", rig, "--out", out).sentence
    assert not out.exists()


def test_show_prints_a_file_that_loads_to_the_same_preset(tactune: Tactune, tmp_path: Path) -> None:
    finished = tactune("preset", "show", "default")
    (tmp_path / "copy.json").write_text(finished.out)
    assert finished.status == 0
    assert load_preset(tmp_path / "copy.json") == load_preset("default")
    assert "nothing" in tactune("preset", "show", "nothing").sentence


def test_validate_names_the_good_and_the_bad(tactune: Tactune, tmp_path: Path) -> None:
    good, bad, missing = tmp_path / "good.json", tmp_path / "bad.json", tmp_path / "missing.json"
    save_preset(Preset(name="fine"), good)
    document = json.loads(good.read_text())
    document["tolerance"]["t"] = -1
    bad.write_text(json.dumps(document))

    assert tactune("preset", "validate", good, "default").status == 0
    finished = tactune("preset", "validate", bad, good, missing)
    assert finished.status == 2
    assert f"{good}: good, preset 'fine'" in finished.out
    assert "bad.json: tolerance.t is -1" in finished.err
    assert "missing.json" in finished.err


def test_validate_names_fields_that_are_gone_in_files_and_recordings(
    tactune: Tactune, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, file = tmp_path / "old.mcap", tmp_path / "old.json"
    assert tactune("record", "--source", recording, "--preset", "default", "--out", old).status == 0
    save_preset(Preset(name="old"), file)
    monkeypatch.setattr(preset_file, "GONE", ("cameras.tactile_delay_s",))
    finished = tactune("preset", "validate", file, old)
    assert finished.status == 0
    assert finished.out.count("cameras.tactile_delay_s") == 2


def test_schema_is_the_schema(tactune: Tactune) -> None:
    assert json.loads(tactune("preset", "schema").out) == json_schema()
