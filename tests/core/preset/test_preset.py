import json
import os
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import given

from any_preset import presets
from tactune.core.contact.checks import check_rig, preset_notes
from tactune.core.errors import ExportError, PresetError
from tactune.core.preset import Preset
from tactune.core.preset import file as preset_file
from tactune.core.preset.file import preset_and_note, preset_json, save_preset, shipped_presets
from tactune.core.preset.preset import json_schema
from tactune.core.sources.presets import load_preset

SCHEMA = jsonschema.Draft202012Validator(json_schema())


@given(presets)
def test_a_preset_survives_its_file_bit_for_bit(preset):
    assert preset_and_note(preset_json(preset), "memory")[0] == preset


@given(presets)
def test_every_preset_file_satisfies_the_shipped_schema(preset):
    assert list(SCHEMA.iter_errors(json.loads(preset_json(preset)))) == []


def test_the_checked_in_schema_is_the_models():
    shipped = json.loads((preset_file.importlib.resources.files("tactune.presets") / "preset.schema.json").read_text())
    assert shipped == json_schema(), "run `tactune preset schema > presets/preset.schema.json`"


def test_the_default_preset_holds_the_papers_values():
    default = load_preset("default")
    assert (default.tolerance.t, default.outliers.k, default.outliers.ratio) == (0.03, 20, 2.0)
    assert shipped_presets()[:2] == ["default", "simulator"]
    for name in shipped_presets():
        assert load_preset(name).name == name
        place = Path(str(preset_file.importlib.resources.files("tactune.presets"))) / f"{name}.json"
        with pytest.raises(ExportError, match="another name"):
            save_preset(Preset(), place)


def test_a_verdict_goes_with_the_values_that_it_was_about(make_rig):
    preset = load_preset("simulator").with_value(
        "verdict", {"links_mm": {"noise": 1.0}, "judged": "2026-01-02T03:04:05Z"}
    )
    assert (
        preset.with_values({"name": "mine", "rig": make_rig().model_dump(), "tolerance.t": preset.tolerance.t}).verdict
        is not None
    )
    assert preset.with_value("pressure.gauge_pa", 1500.0).verdict is not None, "newtons do not move the boundary"
    assert preset.with_value("membrane.gap_m", 0.0007).verdict is None


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("tolerance.t", 2, ["tolerance.t is 2", "equal to 1"]),
        ("mask.hue", [1, 200], ["mask.hue.1 is 200", "179"]),
        ("mask.value", [9, 2], ["value", "9", "2", "swap"]),
        ("outliers.k", True, ["outliers.k is True"]),
        ("outliers.ratio", 0, ["outliers.ratio is 0", "than 0"]),
        ("range.limits_m", [0.4, 0.1], ["0.4", "0.1", "swap"]),
        ("region.rectangle", [0, 0, 0, 5], ["region.rectangle", "empty"]),
        ("contact_test", "magic", ["contact_test is 'magic'", "membrane"]),
        ("membrane.gap_m", 1.8, ["membrane.gap_m is 1.8", "0.005"]),
        ("alignment.homography.H_p_t", [[1, 0, 0], [1, 0, 0], [0, 0, 1]], ["singular"]),
        ("alignment.rigid.T_proximity_tactile", np.diag([2.0, 1, 1, 1]), ["no rotation"]),
        ("alignment.rigid.T_proximity_tactile", np.eye(3), ["4 x 4"]),
        ("tolerance.t", float("nan"), ["tolerance.t is"]),
        ("alignment.rigid.T_proximity_tactile", np.eye(4) + np.eye(4)[:, :1] @ np.eye(4)[3:] * 2, ["is it in mm"]),
        ("mask.hu", [0, 1], ["no field 'mask.hu'", "mask.hue"]),
        ("mask", {}, ["no field 'mask'"]),
    ],
)
def test_a_bad_value_is_refused_with_path_value_and_remedy(path, value, words):
    with pytest.raises(PresetError) as caught:
        Preset().with_value(path, value)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "line 1"),
        ("[]", "schema"),
        ('{"schema": "other"}', "'other'"),
        ('{"schema": "tactune.preset", "schema_version": true}', "schema_version is True"),
        ('{"schema": "tactune.preset", "schema_version": 99, "tool_version": "7.1"}', "update Tactune .*7.1"),
        ('{"schema": "tactune.preset", "schema_version": 1, "toleranc": {}}', "toleranc is no field.*tolerance"),
        ('{"schema": "tactune.preset", "schema_version": 1, "tolerance": {"t": 0.1, "u": 1}}', "tolerance.u is no"),
        ("[" * 100_000, "JSON"),
        ('{"schema": "tactune.preset", "schema_version": 1, "notes": "\\ud800"}', "Unicode"),
        (json.dumps({"schema": "tactune.preset", "schema_version": 1} | {f"x{i}": 0 for i in range(99)}), "92 more"),
    ],
)
def test_a_file_that_is_no_preset_is_refused_in_words(text, words, tmp_path):
    (tmp_path / "bad.json").write_text(text)
    with pytest.raises(PresetError, match=words) as caught:
        load_preset(tmp_path / "bad.json")
    assert "bad.json" in str(caught.value)
    assert len(str(caught.value)) < 500


def test_a_preset_that_an_earlier_version_wrote_opens_with_all_that_it_holds():
    text = (Path(__file__).parents[2] / "data" / "first_preset.json").read_text()
    read, note = preset_and_note(text, "first")
    assert note.startswith("noise.slow_m")
    assert [pair.tactile_u for pair in read.alignment.calibration.points] == [3.0, 3.0]
    assert (read.noise.bias_m, read.cameras.tactile_delay_s, read.untouched.frames) == (0.0004, 0.01, 15)


def test_a_preset_with_a_field_that_is_gone_says_which_and_loads(tmp_path, monkeypatch):
    preset = Preset(name="old").with_value("tolerance.t", 0.04)
    document = json.loads(preset_json(preset))
    document["tolerance"]["share"] = document["polish"] = 3
    text = json.dumps(document)
    with pytest.raises(PresetError, match=r"tolerance\.share is no field"):
        preset_and_note(text, "old.json")
    monkeypatch.setattr(preset_file, "GONE", ("polish", "tolerance.share", "tolerance.other", "name.part"))
    read, note = preset_and_note(text, "old.json")
    assert read == preset
    assert "polish, tolerance.share of" in note
    assert preset_and_note(preset_json(preset), "new.json") == (preset, "")


def test_a_preset_of_the_dent_test_uses_the_pressure_test_and_says_so():
    document = json.loads(preset_json(Preset())) | {"contact_test": "dent", "dent": {"limit_m": 0.002}}
    read, note = preset_and_note(json.dumps(document), "old.json")
    assert read.contact_test == "pressure"
    assert "dent" in note and "pressure" in note


def test_only_ordinary_files_are_replaced_and_a_link_stays_one(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path / "pipe", tmp_path, Path("/")):
        with pytest.raises(ExportError, match="no ordinary file"):
            save_preset(Preset(), place)
    with pytest.raises(PresetError, match="no ordinary file"):
        load_preset("/dev/zero")
    (tmp_path / "link.json").symlink_to("real.json")
    save_preset(Preset(name="linked"), tmp_path / "link.json")
    assert (tmp_path / "link.json").is_symlink()
    assert load_preset(tmp_path / "real.json").name == "linked"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.json", "pipe", "real.json"]


def test_a_membrane_preset_without_the_mask_or_on_a_homography_is_noted(make_rig):
    tolerance = Preset(contact_test="tolerance").with_value("alignment.model", "homography")
    assert preset_notes(tolerance) == []
    assert [name for name in shipped_presets() if preset_notes(load_preset(name))] == ["default"]  # its mask is off
    (unmasked,) = preset_notes(Preset(name="cup"))
    assert "'cup'" in unmasked
    both = Preset(name="cup").with_value("alignment.model", "homography")
    assert preset_notes(both) == [unmasked, *check_rig(both, make_rig())]
