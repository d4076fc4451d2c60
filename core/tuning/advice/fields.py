"""Fields of the contact tests that follow from the noise of the rig."""

from __future__ import annotations

import math
from typing import Final

from ...contact.pipeline import ContactPipeline
from ...contact.pressure.test import PRESSURE_SIGMAS
from ...errors import AdviceError
from ...sources.base import Progress
from .proposal import Evidence, Proposal

_NAMES: Final = {"tolerance.t": "tolerance t", "pressure.limit": "pressure limit"}
#: t covers this number of standard deviations of the noise of both depths: 95 % of the pixels.
_T_SIGMAS: Final = 2.0


def suggest_tolerance(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the tolerance that the measured noise asks for."""
    noise = evidence.preset.noise
    if noise is None:
        raise AdviceError("tolerance: the noise of both cameras tells the tolerance; measure it (F6)")
    sigma_m = math.hypot(noise.proximity.total_m, noise.tactile.total_m)
    distance_m = noise.tactile.distance_m
    return _proposal(
        evidence,
        "tolerance.t",
        min(float(f"{_T_SIGMAS * sigma_m / distance_m:.2g}"), 1.0),
        f"The difference of both depths has a noise of {1e3 * sigma_m:.1f} mm at {1e3 * distance_m:.0f} mm distance; t "
        f"covers {_T_SIGMAS:g} standard deviations.",
        "Nearly all contact passes, and no larger gap than noise requires.",
    )


def suggest_pressure(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the smallest pressure that the measured noise allows, as a share of the inflation."""
    preset, untouched = evidence.preset, evidence.untouched
    if preset.noise is None or untouched is None:
        raise AdviceError(
            "pressure: the noise of the camera and the untouched frame tell the pressure limit; capture it and "
            "measure the noise (F6)"
        )
    in_use = preset.with_value("contact_test", "pressure")
    facts = ContactPipeline(in_use, evidence.rig, untouched).process(untouched).pressure
    if facts is None or not math.isfinite(facts.relative_sigma):
        raise AdviceError("pressure: the untouched frame shows too little of the membrane; capture it again")
    limit = max(math.ceil(100 * PRESSURE_SIGMAS * facts.relative_sigma), 1) / 100
    return _proposal(
        evidence,
        "pressure.limit",
        limit,
        f"Noise explains pressures up to {limit:.2f} of the inflation, averaged over {2e3 * facts.window_m:.0f} mm.",
        "Nothing but noise is left out.",
    )


def _proposal(evidence: Evidence, path: str, value: float, sentence: str, expected: str) -> Proposal:
    section, name = path.partition(".")[0], _NAMES[path]
    if value == evidence.preset.value(path):
        return Proposal(section, {}, f"Keep {name}", sentence, expected)
    return Proposal(section, {path: value}, f"{name[:1].upper()}{name[1:]} {100 * value:g} %", sentence, expected)
