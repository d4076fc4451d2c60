"""Warnings about valid presets that are probably not intended."""

from __future__ import annotations

from tactune.core.contact.checks import check_rig, homography_notes, mask_notes, preset_notes
from tactune.core.preset import Preset
from tactune.core.preset.file import shipped_presets
from tactune.core.sources.presets import load_preset


def test_shipped_presets_and_the_tolerance_test_give_no_notes():
    for name in shipped_presets():
        preset = load_preset(name)
        assert preset_notes(preset) == mask_notes(preset)
        assert bool(mask_notes(preset)) == (name == "default"), "its mask is off, as the print's colour is unknown"
    tolerance = Preset(contact_test="tolerance")
    assert preset_notes(tolerance) == preset_notes(tolerance.with_value("alignment.model", "homography")) == []


def test_the_membrane_test_is_noted_without_the_mask_and_on_a_homography():
    membrane = Preset(name="cup", contact_test="membrane")
    assert preset_notes(membrane) == mask_notes(membrane)
    assert "'cup'" in mask_notes(membrane)[0]
    assert preset_notes(membrane.with_value("mask.enabled", True)) == []
    both = membrane.with_value("alignment.model", "homography")
    assert preset_notes(both) == mask_notes(both) + homography_notes(both)


def test_a_run_warns_of_the_homography_in_the_same_words(make_rig):
    preset = Preset(contact_test="membrane").with_value("alignment.model", "homography")
    assert check_rig(preset, make_rig()) == homography_notes(preset)
