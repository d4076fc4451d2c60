"""``tactune preset suggest | findings``: proposals with their evidence, and findings with their own exit status."""

import pytest

from tactune.core import warmup
from tactune.core.preset import Preset
from tactune.core.preset.file import save_preset
from tactune.core.sources.presets import load_preset

SCENE = "sim:cup?press=medium"


@pytest.fixture
def spoiled(tmp_path):
    """A preset without mask and with a wrong depth offset."""
    values = {"mask.enabled": False, "alignment.depth_offset_m": 0.012}
    save_preset(load_preset("simulator").with_values(values), tmp_path / "spoiled.json")
    return tmp_path / "spoiled.json"


def test_each_proposal_is_printed_and_all_are_written(tactune, spoiled, tmp_path):
    out = tmp_path / "mended.json"
    finished = tactune("preset", "suggest", "--source", SCENE, "--preset", spoiled, "--out", out)
    assert finished.status == 0
    assert "mask: Mask hue" in finished.out and "% of the prints" in finished.out
    assert "--set alignment.depth_offset_m=0.0" in finished.out and "±" in finished.out
    mended = load_preset(out)
    assert mended.mask.enabled and mended.alignment.depth_offset_m == 0
    # what is printed does the same
    settings = [word for line in finished.out.splitlines() if "--set" in line for word in line.split()]
    assert tactune("preset", "new", "--from", spoiled, *settings, "--out", tmp_path / "set.json").status == 0
    assert load_preset(tmp_path / "set.json").mask == mended.mask


def test_the_present_frame_can_be_chosen(tactune):
    named = ("preset", "suggest", "--source", "sim:cup", "--preset", "default", "--section", "mask")
    areas = [tactune(*named, "--frame", number).out.partition("changes from ")[2] for number in (0, 45)]
    assert int(areas[0].split()[0].replace(",", "")) < int(areas[1].split()[0].replace(",", ""))


def test_findings_are_printed_with_what_mends_them(tactune, spoiled):
    finished = tactune("preset", "findings", "--source", SCENE, "--preset", spoiled, "--frame", 0)
    assert finished.status == 1
    assert "alignment.depth_offset_m: Bias in this frame −" in finished.out
    assert "--set alignment.depth_offset_m=0.0" in finished.out
    finished = tactune("preset", "findings", "--source", SCENE)
    assert (finished.status, finished.out) == (0, "no findings\n")


def test_a_contact_test_that_cannot_be_used_is_told_without_compiling_it(tactune, recording, tmp_path, monkeypatch):
    monkeypatch.delattr(warmup, "warm_up_if_needed")
    save_preset(Preset(contact_test="pressure"), tmp_path / "pressure.json")
    finished = tactune("preset", "findings", "--source", recording, "--preset", tmp_path / "pressure.json")
    assert finished.status == 1
    assert "compares with the untouched frame, and there is none" in finished.out
