"""One real scene of an L515 and a D435: measured facts must not change."""

import numpy as np
import pytest

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.preset import Preset
from tactune.core.sources.registry import open_source


@pytest.fixture(scope="module")
def scene(shared_data):
    with open_source(f"folder:{shared_data / 'real_pair'}") as source:
        frame = source.next_frame()
        assert frame is not None
        yield source.rig, frame


@pytest.mark.parametrize(("t", "expected"), [(0.01, 2.1), (0.02, 7.7), (0.03, 46.9), (0.04, 80.0), (0.10, 95.3)])
def test_the_share_that_passes_is_the_measured_one(scene, t, expected):
    """Of the pixels with depth in both cameras, per cent."""
    rig, frame = scene
    preset = Preset(contact_test="tolerance").with_values({"outliers.enabled": False, "tolerance.t": t})
    patch = ContactPipeline(preset, rig).process(frame)
    share = 100 * patch.mask.sum() / np.isfinite(patch.relative_difference).sum()
    assert share == pytest.approx(expected, abs=0.1)
