"""A membrane whose bulge cannot be measured, so the membrane test assumes its curvature."""

from __future__ import annotations

import math

from ....contact.membrane.tension import LIMITS_PER_M
from ..proposal import Finding, Proposal
from .situation import Situation


def find(situation: Situation) -> Finding | None:
    """Return a finding if the membrane test uses another curvature of the free membrane than the measured one."""
    facts = situation.patch.membrane
    if facts is None:
        return None
    measured, used = facts.curvature_per_m, facts.used_curvature_per_m
    if math.isnan(measured):
        seen = "The tactile camera sees too little of the membrane to measure its bulge"
    elif not LIMITS_PER_M[0] <= measured <= LIMITS_PER_M[1]:
        seen = f"The membrane has no usual bulge: its curvature measures {measured:.1f} per m"
    else:
        return None
    sentence = f"{seen}; the membrane test assumes {used:g} per m."
    return Finding(
        name="bulge",
        field="contact_test",
        sentence=sentence,
        proposal=Proposal(
            section="contact_test",
            changes={"contact_test": "tolerance"},
            label="Use the tolerance test",
            evidence="The membrane test needs the curvature of the free membrane, its pressure over its tension.",
            expected="Contact no longer depends on the curvature of the membrane.",
            weak=True,
        ),
    )
