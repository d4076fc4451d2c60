"""Contact that is too small to tell a bias between the cameras from a gap, on a rig whose bias was not measured."""

from __future__ import annotations

from ..proposal import Finding
from .situation import Situation


def find(situation: Situation) -> Finding | None:
    """Return a finding if the membrane test found contact with a bias that it assumes."""
    facts, preset = situation.patch.membrane, situation.preset
    if facts is None or not preset.membrane.bias or facts.bias_known or not len(situation.patch.points):
        return None
    sentence = "This contact is too small to tell a bias from a gap, and the bias of this rig is not measured."
    if not preset.mask.enabled:
        sentence += " The mask is off, so the contact may be prints; switch the mask on first."
    return Finding(
        name="unknown_bias",
        field="membrane.bias",
        sentence=sentence,
        action="measure_noise",
    )
