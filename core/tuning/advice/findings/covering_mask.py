"""A mask that covers most of the image."""

from __future__ import annotations

from typing import Final

from ....contact.masking import masked_share
from ..proposal import Finding, Proposal
from .situation import Situation

#: Largest share of the colour image that prints cover.
_MAX_SHARE: Final = 0.5


def find(situation: Situation) -> Finding | None:
    """Return a finding if the mask covers most of the colour image."""
    mask = situation.preset.mask
    if not mask.enabled:
        return None
    share = masked_share(situation.frame.proximity_color, mask)
    if share <= _MAX_SHARE:
        return None
    sentence = f"The mask covers {100 * share:.1f} % of the colour image, and nothing under it counts as contact."
    return Finding(
        name="covering_mask",
        field="mask.hue",
        sentence=sentence,
        proposal=Proposal(
            section="mask",
            changes={"mask.enabled": False},
            label="Mask off",
            evidence=sentence,
            expected="All colours count. Then pick the colour of the prints.",
        ),
        explains_empty=True,
    )
