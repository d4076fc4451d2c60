"""Depth offset and scale of the alignment, from the surfaces that both cameras see."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...contact.membrane.section import LARGEST_BIAS_M
from ...errors import PresetError, minus
from ...model.clouds import valid_depth
from ...rig.bias import MeasuredBias
from ...sources.base import Progress
from .disagreement import Disagreement, depth_differences, measure_disagreement
from .proposal import Evidence, Proposal

#: A bias is mended beyond this number of standard deviations, and from this size on, metres.
_CERTAIN, _SMALLEST_M = 3.0, 0.0005
#: A slope is mended beyond this number of standard deviations, and if it changes the bias by as much between the depths
#: of the rig's working range, metres.
_CERTAIN_SLOPE, _WORKING_RANGE_M, _SMALLEST_CHANGE_M = 5.0, 0.1, 0.002


def suggest_alignment(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the depth offset, and where depth varies enough the scale, with which both cameras agree.

    The membrane test takes the tactile depth for true and subtracts a bias from the proximity depth, in each frame. For
    this test an offset that was not calibrated is proposed to be 0, unless the bias is larger than the test corrects.

    Raises
    ------
    AdviceError
        Contact can't be told from bias.
    """
    return propose_alignment(evidence, *measure_disagreement(evidence, progress))


def propose_alignment(evidence: Evidence, best: Disagreement, contradicting: Sequence[Disagreement] = ()) -> Proposal:
    """Return the proposal that follows from a measured disagreement, and mention those that contradict it."""
    section, bias = evidence.preset.alignment, best.bias
    without_m = bias.bias_m + section.depth_offset_m + (section.depth_scale - 1) * _raw_depth_m(evidence)
    sentence = _sentence(best, contradicting)
    if abs(bias.bias_m) <= max(_CERTAIN * bias.sigma_m, _SMALLEST_M):
        return _keep(sentence, "The cameras agree within the uncertainty; nothing changes.")
    if _test_corrects(evidence, without_m) and not best.same_scene:
        words = f"the membrane test corrects the remaining {_mm(without_m)} by itself."
        if section.depth_offset_m == 0 and section.depth_scale == 1:
            return _keep(sentence, f"Nothing changes: {words}")
        neutral = {"alignment.depth_offset_m": 0.0, "alignment.depth_scale": 1.0}
        return _proposal(evidence, neutral, sentence, f"Tactile depth is used as measured; {words}")
    changes = {"alignment.depth_offset_m": section.depth_offset_m + bias.bias_m}
    if _tells_scale(bias):
        factor = 1 / (1 - bias.per_m)
        sentence += f" The difference grows by {100 * bias.per_m:.1f} ± {100 * bias.per_m_sigma:.1f} % of the depth."
        changes["alignment.depth_scale"] = section.depth_scale * factor
        changes["alignment.depth_offset_m"] = factor * (
            section.depth_offset_m + bias.bias_m - bias.per_m * bias.depth_m
        )
    try:
        evidence.preset.with_values(changes)
    except PresetError:
        return _keep(sentence, "No depth offset and scale that a preset allows corrects it; check both depth units.")
    return _proposal(evidence, changes, sentence, _expected(evidence, changes, best))


def _test_corrects(evidence: Evidence, without_m: float) -> bool:
    """Return whether the contact test corrects the bias without an offset; not if the offset was calibrated."""
    preset = evidence.preset
    corrects = preset.contact_test == "membrane" and preset.membrane.bias and abs(without_m) < LARGEST_BIAS_M
    return corrects and preset.alignment.calibration is None


def _tells_scale(bias: MeasuredBias) -> bool:
    large = abs(bias.per_m) * _WORKING_RANGE_M > _SMALLEST_CHANGE_M
    return large and abs(bias.per_m) > _CERTAIN_SLOPE * bias.per_m_sigma


def _raw_depth_m(evidence: Evidence) -> float:
    """Return the median tactile depth without correction, metres."""
    counts = evidence.frame.tactile_depth
    valid = counts[valid_depth(counts)]
    return float(np.median(valid)) * evidence.rig.tactile.depth_unit_m if len(valid) else 0.0


def _sentence(best: Disagreement, contradicting: Sequence[Disagreement]) -> str:
    bias = best.bias
    words = (
        f"The proximity camera reads {_mm(bias.bias_m)} ± {1e3 * bias.sigma_m:.1f} mm against the tactile camera, "
        f"measured {best.place}."
    )
    for other in contradicting:
        words += f" It contradicts {_mm(other.bias.bias_m)} ± {1e3 * other.bias.sigma_m:.1f} mm {other.place}."
    return words


def _expected(evidence: Evidence, changes: dict[str, Any], best: Disagreement) -> str:
    words = f"Both depths agree within {1e3 * best.bias.sigma_m:.1f} mm on the same surface"
    if not best.same_scene:
        return words + "."
    t, preset = evidence.preset.tolerance.t, evidence.preset
    shares = []
    for each in (preset, preset.with_values(changes)):
        expected, difference = depth_differences(evidence.frame, each, evidence.rig)
        known = np.isfinite(difference)
        shares.append(100 * np.mean(np.abs(difference[known]) <= t * expected[known]))
    return f"{words}; the share of pixels within t = {t:g} changes from {shares[0]:.1f} to {shares[1]:.1f} %."


def _proposal(evidence: Evidence, changes: dict[str, Any], sentence: str, expected: str) -> Proposal:
    """Round the values to 0.1 mm and four digits, and name those that change."""
    present = evidence.preset
    rounded = {path: round(float(value), 4) for path, value in changes.items()}
    changed: dict[str, Any] = {path: value for path, value in rounded.items() if value != present.value(path)}
    parts = []
    if (offset_m := changed.get("alignment.depth_offset_m")) is not None:
        parts.append(f"Depth offset {_mm(offset_m)}")
    if (scale := changed.get("alignment.depth_scale")) is not None:
        parts.append(f"Depth scale {scale:.4f}")
    if changed and (noise := present.noise) is not None and noise.bias_from != "unknown":
        # the bias that was measured with the rig holds after offset and scale, so it changes with them
        after = present.with_values(changed).alignment
        change_m = after.depth_offset_m - present.alignment.depth_offset_m
        change_m += (after.depth_scale - present.alignment.depth_scale) * _raw_depth_m(evidence)
        changed["noise"] = noise.model_dump(mode="json") | {"bias_m": noise.bias_m - change_m}
    return Proposal("alignment", changed, ", ".join(parts), sentence, expected)


def _keep(sentence: str, expected: str) -> Proposal:
    return Proposal("alignment", {}, "Keep the depth offset", sentence, expected)


def _mm(metres: float) -> str:
    rounded = round(1e3 * metres, 1)
    return minus(f"{rounded:+.1f} mm") if rounded else "0 mm"
