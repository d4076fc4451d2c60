"""A tolerance that is smaller than the noise of both cameras supports."""

from __future__ import annotations

import math
from typing import Final

from ..fields import tolerance_for
from ..proposal import Finding, Proposal
from .situation import Situation

#: Least share of the pixels in contact that should pass the tolerance.
_MIN_PASSING: Final = 0.8


def find(situation: Situation) -> Finding | None:
    """Return a finding if noise alone makes many pixels in contact fail the tolerance test."""
    preset, distance_m = situation.preset, situation.distance_m
    noise, t = preset.noise, preset.tolerance.t
    if preset.contact_test != "tolerance" or noise is None or not distance_m > 0:
        return None
    sigma_m = math.hypot(noise.proximity.total_m, noise.tactile.total_m)
    if sigma_m == 0:
        return None
    passing = math.erf(t * distance_m / (sigma_m * math.sqrt(2)))
    if passing >= _MIN_PASSING:
        return None
    better = tolerance_for(sigma_m, distance_m)
    measured = f"the noise of both cameras is {1e3 * sigma_m:.1f} mm"
    passes = f"only {100 * passing:.0f} % of contact passes"
    return Finding(
        name="small_tolerance",
        field="tolerance.t",
        sentence=f"t is {1e3 * t * distance_m:.1f} mm here, but {measured}: {passes}.",
        proposal=Proposal(
            section="tolerance",
            changes={"tolerance.t": better},
            label=f"t = {better:g}",
            evidence=f"Measured with the rig: {measured}, one standard deviation.",
            expected="95 % of the pixels in contact pass.",
            weak=True,
        ),
    )
