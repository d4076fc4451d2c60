"""A histogram whose peak is off zero: the cameras disagree."""

from __future__ import annotations

from typing import Final

from ....errors import minus
from ....preset import Preset
from ....rig.bias import UNKNOWN_BIAS_M
from ..alignment import propose_alignment
from ..proposal import Evidence, Finding
from ..quick_bias import quick_disagreement
from .situation import Situation

#: A bias of less than this number of standard deviations is not certain.
_CERTAIN: Final = 3.0
#: The membrane test finds a bias by itself in firm contact; for small contact it assumes one of up to this, metres.
_MAX_ASSUMED_M: Final = 2 * UNKNOWN_BIAS_M
#: A bias that an uncalibrated depth offset causes is reported from this size on, metres: it displaces the patch.
_MAX_OWN_M: Final = 0.003


def find(situation: Situation) -> Finding | None:
    """Return a finding if the bias between the cameras is larger than the contact test stands."""
    preset, distance_m = situation.preset, situation.distance_m
    if situation.one_camera or not distance_m > 0:
        return None
    largest_m, expected_m = _largest_m(preset, distance_m), _corrected_m(preset)
    above_m = max(largest_m - abs(expected_m), 0.0)
    own_m = 0.0 if preset.alignment.calibration is not None else preset.alignment.depth_offset_m
    if own_m:
        above_m = min(above_m, _MAX_OWN_M)
    found = quick_disagreement(situation.frame, situation.patch, preset, situation.rig, above_m)
    if found is None:
        return None
    excess_m = found.bias.bias_m - expected_m
    if abs(excess_m + own_m) < abs(excess_m):  # the cameras agree better without the offset
        largest_m = min(largest_m, _MAX_OWN_M)
    if abs(excess_m) <= max(largest_m, _CERTAIN * found.bias.sigma_m):
        return None
    evidence = Evidence(preset, situation.rig, (situation.frame,), situation.untouched)
    proposal = propose_alignment(evidence, found)
    bias_m = found.bias.bias_m
    place = minus(f"{100 * bias_m / distance_m:+.1f} %, {1e3 * bias_m:+.1f} mm")
    return Finding(
        name="peak",
        field="alignment.depth_offset_m",
        sentence=f"Peak of the differences at {place}: the cameras disagree.",
        proposal=proposal if proposal.changes else None,
        action="" if proposal.changes else "measure_noise",
        explains_empty=True,
    )


def _largest_m(preset: Preset, distance_m: float) -> float:
    """Return the largest bias beyond the corrected one that is not reported: half of what leaves no contact."""
    limits = preset.test.bias_limits(preset, distance_m)
    return min((limits.good_m + limits.fair_m) / 2, _MAX_ASSUMED_M)


def _corrected_m(preset: Preset) -> float:
    """Return the bias that the contact test subtracts because it was measured with the rig."""
    noise = preset.noise
    corrects = preset.contact_test == "membrane" and preset.membrane.bias
    return noise.bias_m if corrects and noise is not None and noise.bias_from != "unknown" else 0.0
