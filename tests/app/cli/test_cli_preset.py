"""``tactune preset new | show | validate | schema``."""

import json

from tactune.core.model.frames import Rig
from tactune.core.model.rig_file import load_rig
from tactune.core.preset import Preset, UntouchedRecord
from tactune.core.preset import file as preset_file
from tactune.core.preset.file import save_preset
from tactune.core.sources.presets import load_preset


def test_new_writes_a_preset_for_the_rig_with_what_was_set(tactune, recording, tmp_path):
    file = tmp_path / "mine.json"
    finished = tactune(
        *("preset", "new", "--rig", recording / "rig.json", "--set", "alignment.model=homography", "--out", file),
        *("--set", "mask.hue=[150,170]", "--set", "notes=on the bench"),
    )
    assert finished.status == 0
    preset = load_preset(file)
    assert preset.name == "mine"
    assert preset.rig == load_rig(recording / "rig.json")
    assert preset.alignment.model == "homography"
    assert preset.mask.hue == (150, 170)
    assert preset.mask.enabled
    assert preset.notes == "on the bench"
    assert not preset.range.enabled
    assert preset.outliers == Preset().outliers


def test_the_contact_test_is_chosen_by_name_or_by_one_of_its_fields(tactune, recording, tmp_path):
    def made(name, *settings):
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
    assert not made("f.json", "region.rectangle=[1,1,9,9]", "region.enabled=false").region.enabled, "own words win"


def test_a_new_preset_of_one_camera_has_the_test_of_one_camera(tactune, recording, tmp_path):
    one, two = tmp_path / "one.json", tmp_path / "two.json"
    save_preset(Preset(rig=Rig.of_one_camera(load_rig(recording / "rig.json").tactile)), one)
    made = tactune("preset", "new", "--from", one, "--out", two)
    assert made.status == 0 and not made.err
    assert load_preset(two).contact_test == "pressure"


def test_new_starts_from_another_preset_and_its_rig(tactune, recording, tmp_path):
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
    made = tactune("preset", "new", "--from", "simulator", *words, "--out", third)
    assert made.status == 0 and "calibrate again" in made.err
    preset, shipped = load_preset(third), load_preset("simulator")
    assert (preset.name, preset.rig, preset.alignment.model) == ("other", rig, "homography")
    assert (preset.mask, preset.tolerance) == (shipped.mask, shipped.tolerance)


def test_show_prints_a_file_that_loads_to_the_same_preset(tactune, tmp_path):
    finished = tactune("preset", "show", "default")
    (tmp_path / "copy.json").write_text(finished.out)
    assert finished.status == 0
    assert load_preset(tmp_path / "copy.json") == load_preset("default")
    assert "nothing" in tactune("preset", "show", "nothing").sentence


def test_validate_names_the_good_and_the_bad(tactune, tmp_path):
    good, bad = tmp_path / "good.json", tmp_path / "bad.json"
    save_preset(Preset(name="fine"), good)
    document = json.loads(good.read_text())
    document["tolerance"]["t"] = -1
    bad.write_text(json.dumps(document))
    assert tactune("preset", "validate", good).out == f"{good}: good, preset 'fine' for any rig\n"
    assert "bad.json: tolerance.t is -1" in tactune("preset", "validate", bad).sentence
    record = UntouchedRecord(file="untouched-0123456789ab.npz", sha256="0" * 64, frames=15)
    save_preset(Preset(untouched=record), tmp_path / "alone.json")
    assert "untouched-0123456789ab.npz" in tactune("preset", "validate", tmp_path / "alone.json").sentence


def test_validate_names_fields_that_are_gone_in_files_and_recordings(tactune, recording, tmp_path, monkeypatch):
    old, file = tmp_path / "old.mcap", tmp_path / "old.json"
    assert tactune("record", "--source", recording, "--preset", "default", "--out", old).status == 0
    save_preset(Preset(name="old"), file)
    monkeypatch.setattr(preset_file, "GONE", ("cameras.tactile_delay_s",))
    for path in (file, old):
        finished = tactune("preset", "validate", path)
        assert finished.status == 0 and "cameras.tactile_delay_s" in finished.out
