"""Fields of the contact tests: from the error in examples, or else from the noise of the rig."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from ...errors import AdviceError, FrameError, counted
from ...model.frames import SensorFrame
from ...model.robust import spread
from ...preset import CameraNoise
from ...rig.noise import depth_noises
from ...rig.untouched import tile_medians
from ...sources.base import Progress, part_of
from .examples import CURVES, Judge, curve_of, known_examples, usual_value
from .proposal import Evidence, Proposal

#: Without examples, t covers this number of standard deviations of the noise of both depths: 95 % of the pixels.
_T_SIGMAS: Final = 2.0
#: Fewest frames from which noise is measured, and the number of the newest ones that are used.
_MIN_FRAMES, _FRAMES = 2, 4

#: The scene moves if more than the second share of the image tiles changes by more than the first number of standard
#: deviations; standard deviation over median absolute deviation.
_MOVED_SIGMAS, _MOVED_TILES = 5.0, 0.03

_NAMES: Final = {
    "tolerance.t": "tolerance t",
    "outliers.ratio": "ratio",
    "outliers.min_cluster_area_mm2": "smallest cluster",
    "membrane.gap_m": "largest gap",
    "membrane.trust_m": "equilibrium length",
    "membrane.min_area_mm2": "smallest contact",
}


def suggest_tolerance(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose t: from examples of contact, or else from the noise."""
    if _painted(evidence):
        return _from_examples("tolerance", evidence, progress)
    proximity, tactile = _noises(evidence, "tolerance", progress)
    rig = evidence.rig
    rounding_m = math.hypot(rig.proximity.depth_unit_m, rig.tactile.depth_unit_m) / math.sqrt(12)
    sigma_m = max(math.hypot(proximity.total_m, tactile.total_m), rounding_m)  # equal frames have no noise
    t = tolerance_for(sigma_m, tactile.distance_m)
    return _proposal(
        evidence,
        "tolerance",
        {"tolerance.t": t},
        f"The difference of both depths has a noise of {1e3 * sigma_m:.1f} mm at {1e3 * tactile.distance_m:.0f} mm "
        f"distance; t covers {_T_SIGMAS:g} standard deviations. {_WEAKER}",
        "Nearly all contact passes, and no larger gap than noise requires.",
        weak=True,
    )


def tolerance_for(sigma_m: float, distance_m: float) -> float:
    """Return the tolerance t that the noise of the difference of both depths asks for at a distance, both metres."""
    return min(float(f"{_T_SIGMAS * sigma_m / distance_m:.2g}"), 1.0)


def suggest_outliers(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose ratio and smallest cluster of the outlier removal: from examples, or else from the noise."""
    if _painted(evidence):
        return _from_examples("outliers", evidence, progress)
    return _smallest_group("outliers", "outliers.min_cluster_area_mm2", evidence, progress)


def suggest_membrane(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the fields of the membrane test: from examples of contact, or else its smallest contact only."""
    if _painted(evidence):
        return _from_examples("membrane", evidence, progress)
    return _smallest_group("membrane", "membrane.min_area_mm2", evidence, progress)


_WEAKER: Final = "This is weaker than examples of painted contact."


def _painted(evidence: Evidence) -> bool:
    return any(example.contact is not None for example in evidence.examples)


def _from_examples(section: str, evidence: Evidence, progress: Progress) -> Proposal:
    """Choose the fields of a section one after the other, each by its curve."""
    examples = known_examples(evidence)
    judge = Judge(evidence.preset, evidence.rig, examples)
    preset, changes, curves = evidence.preset, {}, []
    paths = list(CURVES[section])
    for number, path in enumerate(paths):
        curve = curve_of(path, preset, judge, part_of(progress, number, len(paths)))
        curves.append(curve)
        changes[path] = curve.proposed
        preset = preset.with_value(path, curve.proposed)
    first, last = curves[0], curves[-1]
    before, after = first.at(first.present), last.at(last.proposed)
    touched = sum(example.contact is not None for example in examples)
    return _proposal(
        evidence,
        section,
        changes,
        f"In {counted(touched, 'frame')} with painted contact and "
        f"{counted(len(examples) - touched, 'untouched frame')}, the best values leave {sum(after):.0f} mm² of missed "
        "and false contact per frame.",
        f"Missed contact changes from {before[0]:.0f} to {after[0]:.0f} mm² per frame, false contact from "
        f"{before[1]:.0f} to {after[1]:.0f} mm².",
    )


def _smallest_group(section: str, path: str, evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the smallest group that is kept: larger than what noise makes, and than what untouched frames show."""
    shipped, present = usual_value(path), float(evidence.preset.value(path))
    examples = known_examples(evidence)
    reasons, enough_mm2 = [], shipped
    if section == "outliers":
        noise_mm2, sentence = _noise_group_mm2(evidence, part_of(progress, 0, 2))
        enough_mm2 = max(enough_mm2, noise_mm2)
        reasons.append(sentence)
    values = np.unique([*CURVES[section][path], shipped, present])
    if examples:
        judge = Judge(evidence.preset, evidence.rig, examples)
        curve = curve_of(path, evidence.preset, judge, part_of(progress, 1, 2))
        clean = curve.values[curve.false_mm2 <= curve.false_mm2.min() + 1e-9]
        enough_mm2 = max(enough_mm2, float(clean.min()))
        false_mm2, left_mm2 = curve.at(present)[1], curve.at(enough_mm2)[1]
        left = (
            f", and {left_mm2:.0f} mm² if groups below {enough_mm2:.0f} mm² are dropped" if present < enough_mm2 else ""
        )
        reasons.append(
            f"In the untouched frames {false_mm2:.0f} mm² per frame count as contact with the present value{left}."
        )
    if enough_mm2 == shipped:
        reasons.append(f"{shipped:g} mm² is the shipped value.")
    if enough_mm2 > values[-1]:
        raise AdviceError(
            f"{section}: noise would make groups of {enough_mm2:.0f} mm², which is more than contact; hold the scene "
            "still, or measure the rig's noise (Check cameras)"
        )
    proposed = present if present >= enough_mm2 else float(values[values >= enough_mm2].min())
    return _proposal(
        evidence,
        section,
        {path: proposed},
        f"{' '.join(reasons)} {_WEAKER}",
        f"Groups below {proposed:g} mm² are dropped, those of real contact too.",
        weak=True,
    )


def _noise_group_mm2(evidence: Evidence, progress: Progress) -> tuple[float, str]:
    """Return the area over which noise is correlated, pi times its length squared, and a sentence."""
    proximity, tactile = _noises(evidence, "outliers", progress)
    lengths_m = [
        noise.length_px * noise.distance_m / camera.intrinsics.fx
        for noise, camera in ((proximity, evidence.rig.proximity), (tactile, evidence.rig.tactile))
    ]
    area_mm2 = 1e6 * math.pi * max(lengths_m) ** 2
    return (
        area_mm2,
        f"Noise is correlated over {1e3 * max(lengths_m):.1f} mm, so it makes groups of {area_mm2:.0f} mm².",
    )


def _noises(evidence: Evidence, section: str, progress: Progress) -> tuple[CameraNoise, CameraNoise]:
    """Return the noise of the proximity and of the tactile camera: the preset's, or that of the newest frames."""
    if (noise := evidence.preset.noise) is not None:
        return noise.proximity, noise.tactile
    frames = list({frame.sequence: frame for frame in evidence.frames}.values())[-_FRAMES:]
    remedy = "measure the rig's noise (Check cameras), or paint the contact in a frame"
    if len(frames) < _MIN_FRAMES:
        raise AdviceError(f"{section}: one frame does not tell the noise; let the source play, {remedy}")
    if _moves(frames):
        raise AdviceError(
            f"{section}: the scene moves, so noise can't be told from movement; hold it still, or {remedy}"
        )
    try:
        return depth_noises(frames, evidence.rig, progress)
    except FrameError as error:
        raise AdviceError(
            f"{section}: the noise cannot be measured in the newest frames: {error}; or {remedy}"
        ) from error


def _moves(frames: Sequence[SensorFrame]) -> bool:
    """Return whether a depth changes steadily over the frames, three or more, by more than its noise.

    The second difference of three frames is free of steady movement. Its standard deviation is sqrt(6) times that of
    one frame, and that of the change from the first to the last frame sqrt(2) times.
    """
    if len(frames) < 3:
        return False
    for images in ([frame.tactile_depth for frame in frames], [frame.proximity_depth for frame in frames]):
        first, second, *_, last = (tile_medians(image) for image in images)
        third = tile_medians(images[2])
        known = np.isfinite(first + second + third + last)
        if not known.any():
            continue
        noise = spread((first - 2 * second + third)[known]) / math.sqrt(6)
        moved = np.abs((last - first)[known]) > _MOVED_SIGMAS * math.sqrt(2) * noise
        if moved.mean() > _MOVED_TILES:
            return True
    return False


def _proposal(
    evidence: Evidence, section: str, changes: Mapping[str, Any], sentence: str, expected: str, *, weak: bool = False
) -> Proposal:
    changed = {path: value for path, value in changes.items() if value != evidence.preset.value(path)}
    label = ", ".join(f"{_NAMES[path]} {_shown(path, value)}" for path, value in changed.items())
    label = label[:1].upper() + label[1:] if label else f"Keep {', '.join(_NAMES[path] for path in changes)}"
    return Proposal(section, changed, label, sentence, expected, weak)


def _shown(path: str, value: float) -> str:
    if path.endswith("_m"):
        return f"{1e3 * value:g} mm"
    return f"{value:g} mm²" if path.endswith("_mm2") else f"{value:g}"
