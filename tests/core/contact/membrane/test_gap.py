"""The gap between membrane and object that the membrane test passes on with a patch."""

import numpy as np

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.model.patch import Provenance
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source


def test_the_gap_is_zero_in_contact_and_grows_outside_its_edge():
    preset = load_preset("simulator")
    with open_source("sim:cup?press=medium") as source:
        frame, rig = source.next_frame(), source.rig
    patch = ContactPipeline(preset, rig).process(frame)
    gap = patch.membrane.gap_m.get()
    assert gap.shape == frame.proximity_depth.shape
    assert np.nanmax(gap[patch.mask]) <= preset.membrane.gap_m
    rim = gap[patch.provenance == Provenance.RIM]
    assert np.nanmedian(rim) > 4 * preset.membrane.gap_m
    assert np.isnan(gap[patch.provenance == Provenance.OUTSIDE_REGION]).all()
    assert np.isnan(gap[:5]).all()  # far from the object
    assert patch.membrane.firm_m2 > 0.001
