"""Float32 against float64."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from random_cases import BOUND_ULPS, differing_ulps, random_case, ulps_to_thresholds
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.lab.reference import reference_patch


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), adversarial=st.booleans())
def test_any_seed(seed, adversarial):
    ulps = differing_ulps(*random_case(np.random.default_rng(seed), adversarial=adversarial))
    assert (ulps <= BOUND_ULPS).all()


def test_a_wrong_pipeline_is_found_out():
    """A tolerance that is 5 % too large differs far beyond rounding."""
    preset, rig, frame = random_case(np.random.default_rng(5), adversarial=False)
    wrong = preset.with_value("tolerance.t", preset.tolerance.t * 1.05)
    found = ContactPipeline(wrong, rig).process(frame).provenance
    right = reference_patch(preset, rig, frame, np.float64).provenance
    where = np.flatnonzero(found != right)
    assert len(where) > 0
    assert (ulps_to_thresholds(preset, rig, frame)[where] > BOUND_ULPS).any()
