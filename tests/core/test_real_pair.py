"""One real scene of an L515 and a D435: measured facts must not change."""

from pathlib import Path

import numpy as np
import pytest

from reference_patches import reference_patch
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source

PRESET = Path(__file__).resolve().parents[1] / "data" / "real_pair.json"


@pytest.fixture(scope="module")
def scene(shared_data):
    with open_source(f"folder:{shared_data / 'real_pair'}") as source:
        frame = source.next_frame()
        assert frame is not None
        yield source.rig, frame


def share_passing(rig, frame, **values):
    """Share of the pixels with depth in both cameras that pass the tolerance test, per cent."""
    preset = Preset(contact_test="tolerance").with_values(
        {"outliers.enabled": False} | {path.replace("__", "."): v for path, v in values.items()}
    )
    patch = ContactPipeline(preset, rig).process(frame)
    return float(100 * patch.mask.sum() / np.isfinite(patch.relative_difference).sum())


@pytest.mark.parametrize(("t", "expected"), [(0.01, 2.1), (0.02, 7.7), (0.03, 46.9), (0.04, 80.0), (0.10, 95.3)])
def test_the_share_that_passes_is_the_measured_one(scene, t, expected):
    assert share_passing(*scene, tolerance__t=t) == pytest.approx(expected, abs=0.1)


def test_the_tuned_preset_gives_the_references_patch(scene):
    rig, frame = scene
    preset = load_preset(PRESET)
    contact = ContactPipeline(preset, rig)
    assert contact.warnings == []
    patch = contact.process(frame)
    reference = reference_patch(preset, rig, frame)
    assert np.array_equal(patch.provenance, reference.provenance)
    assert np.array_equal(patch.points, reference.points)
    assert len(patch.points) > 300_000
