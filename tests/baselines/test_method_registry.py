from __future__ import annotations

import numpy as np
import pytest

from tactune.core.baselines.registry import make_method, method_names, needs_reference
from tactune.core.errors import RigMismatchError, TactuneError
from tactune.core.pipeline import ContactPipeline
from tactune.core.preset_file import load_preset

NAMES = (
    "fusion-rigid",
    "fusion-homography",
    "fusion-calibrated",
    "proximity-only",
    "tactile-only",
    "tactile-threshold",
    "mechanics",
)


def test_names():
    assert method_names() == NAMES
    assert [name for name in NAMES if not needs_reference(name)] == list(NAMES[:3])


@pytest.mark.parametrize("name", NAMES)
def test_every_method_finds_the_cup(cup_frames, name):
    rig, reference, pressed = cup_frames
    method = make_method(name, load_preset("simulator"), rig, reference)
    patch = method.find(pressed)
    assert method.name == name
    assert patch.failure == ""
    assert patch.points.dtype == np.float32
    assert patch.points.shape == (len(patch.points), 3)
    assert len(patch.points) > 2000
    assert patch.mask.dtype == bool
    assert patch.mask.shape == rig.proximity.intrinsics.shape
    assert (patch.mask & pressed.truth.contact).sum() > 0.5 * pressed.truth.contact.sum()
    # points lie where the mask says
    pixels = np.rint(rig.proximity.intrinsics.project(patch.points)).astype(int)
    column, row = np.clip(pixels, 0, (639, 479)).T
    assert patch.mask[row, column].mean() > 0.8


@pytest.mark.parametrize("model", ["rigid", "homography"])
def test_fusion_is_the_pipeline_with_that_model(cup_frames, model):
    rig, _, pressed = cup_frames
    preset = load_preset("simulator")
    other = preset.with_values({"alignment.model": "homography" if model == "rigid" else "rigid"})
    found = make_method(f"fusion-{model}", other, rig).find(pressed)
    expected = ContactPipeline(preset.with_values({"alignment.model": model}), rig).process(pressed)
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.mask, expected.mask)


@pytest.mark.parametrize("name", [name for name in NAMES if needs_reference(name)])
def test_a_missing_reference_is_told(small_rig, name):
    with pytest.raises(TactuneError, match=f"{name} compares with the untouched membrane.*capture one"):
        make_method(name, load_preset("simulator"), small_rig)


def test_an_unknown_method_is_told(small_rig):
    with pytest.raises(TactuneError, match=r"no method 'magic'; known are fusion-rigid, .*, mechanics"):
        make_method("magic", load_preset("simulator"), small_rig)


def test_a_preset_of_another_rig_is_refused(small_rig):
    with pytest.raises(RigMismatchError):
        make_method("fusion-rigid", load_preset("simulator"), small_rig)
