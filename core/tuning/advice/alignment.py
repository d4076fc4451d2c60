"""Depth offset of the alignment, from the surfaces that both cameras see."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...contact.membrane.bias import rig_bias
from ...contact.membrane.section import LARGEST_BIAS_M
from ...contact.membrane.steps import firm_contact_bias
from ...errors import AdviceError, PresetError, minus
from ...model.clouds import valid_depth
from ...rig.bias import MeasuredBias, depth_differences, pressed_bias, print_bias, scene_bias
from ...sources.base import Progress
from .proposal import Evidence, Proposal

#: A bias is mended beyond this number of standard deviations, and from this size on, metres.
_CERTAIN, _SMALLEST_M = 3.0, 0.0005


def suggest_alignment(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the depth offset with which both cameras agree.

    The membrane test takes the tactile depth for true and subtracts a bias from the proximity depth, in each frame. For
    this test an offset that was not calibrated is proposed to be 0, unless the bias is larger than the test corrects.
    """
    preset, rig = evidence.preset, evidence.rig
    progress(0.1, "Comparing both depths")
    found = [scene_bias(*depth_differences(evidence.frame, preset, rig))]
    if found[0] is None:
        density_m4 = rig_bias(preset.noise, rig).noise_m4
        free = [frame for frame in (evidence.untouched, *evidence.frames) if frame is not None]
        progress(0.3, "Measuring the bias on prints")
        found.append(print_bias(free, rig, preset, density_m4))
        progress(0.6, "Measuring the bias in contact")
        found.append(pressed_bias(evidence.frames, firm_contact_bias(preset, rig), density_m4))
    best = min((bias for bias in found if bias is not None), key=lambda bias: bias.sigma_m, default=None)
    if best is None:
        raise AdviceError(
            "alignment: a bias between the cameras can't be told from a gap here; set the mask to the colour of prints "
            "that reflect infrared, or press an object firmly (10 cm² or more)"
        )
    return propose_alignment(evidence, best)


def propose_alignment(evidence: Evidence, bias: MeasuredBias) -> Proposal:
    """Return the proposal that follows from a measured bias."""
    preset, section = evidence.preset, evidence.preset.alignment
    counts = evidence.frame.tactile_depth[valid_depth(evidence.frame.tactile_depth)]
    raw_m = float(np.median(counts)) * evidence.rig.tactile.depth_unit_m if len(counts) else 0.0
    without_m = bias.bias_m + section.depth_offset_m + (section.depth_scale - 1) * raw_m
    sentence = (
        f"The proximity camera reads {_mm(bias.bias_m)} ± {1e3 * bias.sigma_m:.1f} mm against the tactile camera, "
        f"measured {bias.place}."
    )
    if abs(bias.bias_m) <= max(_CERTAIN * bias.sigma_m, _SMALLEST_M):
        return _keep(sentence, "The cameras agree within the uncertainty; nothing changes.")
    corrects = preset.contact_test == "membrane" and preset.membrane.bias and abs(without_m) < LARGEST_BIAS_M
    if corrects and section.calibration is None and bias.origin != "scene":
        words = f"the membrane test corrects the remaining {_mm(without_m)} by itself."
        if section.depth_offset_m == 0 and section.depth_scale == 1:
            return _keep(sentence, f"Nothing changes: {words}")
        neutral = {"alignment.depth_offset_m": 0.0, "alignment.depth_scale": 1.0}
        return _proposal(evidence, neutral, raw_m, sentence, f"Tactile depth is used as measured; {words}")
    changes = {"alignment.depth_offset_m": section.depth_offset_m + bias.bias_m}
    try:
        preset.with_values(changes)
    except PresetError:
        return _keep(sentence, "No depth offset that a preset allows corrects it; check both depth units.")
    expected = f"Both depths agree within {1e3 * bias.sigma_m:.1f} mm on the same surface."
    return _proposal(evidence, changes, raw_m, sentence, expected)


def _proposal(evidence: Evidence, changes: dict[str, Any], raw_m: float, sentence: str, expected: str) -> Proposal:
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
        change_m += (after.depth_scale - present.alignment.depth_scale) * raw_m
        changed["noise"] = noise.model_dump(mode="json") | {"bias_m": noise.bias_m - change_m}
    return Proposal("alignment", changed, ", ".join(parts), sentence, expected)


def _keep(sentence: str, expected: str) -> Proposal:
    return Proposal("alignment", {}, "Keep the depth offset", sentence, expected)


def _mm(metres: float) -> str:
    rounded = round(1e3 * metres, 1)
    return minus(f"{rounded:+.1f} mm") if rounded else "0 mm"
