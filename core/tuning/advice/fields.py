"""Fields of the contact tests: from the error in examples of contact, or else from the noise of the rig."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np

from ...contact.pipeline import ContactPipeline
from ...errors import AdviceError, FrameError, counted
from ...model.arrays import BoolArray, Float64Array
from ...model.clouds import pixel_areas_m2, valid_depth
from ...model.frames import Rig, SensorFrame
from ...model.robust import spread
from ...preset import CameraNoise, Preset
from ...rig.noise import depth_noises
from ...rig.untouched import tile_medians
from ...sources.base import Progress, part_of
from .proposal import Evidence, Example, Proposal

#: Fields that examples tell, by section, in the order in which they are chosen, and the values that are tried.
TRIED: Final[dict[str, dict[str, tuple[float, ...]]]] = {
    "tolerance": {"tolerance.t": tuple(float(f"{t:.2g}") for t in np.geomspace(0.002, 0.08, 24))},
    "outliers": {
        "outliers.ratio": (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0),
        "outliers.min_cluster_area_mm2": (0, 5, 10, 20, 30, 50, 75, 100, 150),
    },
    "membrane": {
        "membrane.gap_m": (0.0, 1e-5, 2e-5, 5e-5, 1e-4, 1.5e-4, 2e-4, 3e-4, 5e-4),
        "membrane.trust_m": (0.006, 0.008, 0.012, 0.016, 0.02, 0.028, 0.04),
        "membrane.min_area_mm2": (0, 5, 10, 15, 20, 30, 50, 75, 100, 150, 200),
    },
}
_NAMES: Final = {
    "tolerance.t": "tolerance t",
    "outliers.ratio": "ratio",
    "outliers.min_cluster_area_mm2": "smallest cluster",
    "membrane.gap_m": "largest gap",
    "membrane.trust_m": "equilibrium length",
    "membrane.min_area_mm2": "smallest contact",
}
#: The value chosen among equally good ones, where it is not the default of the field: the paper keeps all clusters, the
#: shipped preset `simulator` drops those below this area.
_USUAL: Final = {"outliers.min_cluster_area_mm2": 30.0}
#: Values whose error exceeds the smallest by at most this are equally good, and so are distances by this share.
_TIE: Final = 0.01
#: Without examples, t covers this number of standard deviations of the noise of both depths: 95 % of the pixels.
_T_SIGMAS: Final = 2.0
#: Fewest frames from which noise is measured, and the number of the newest ones that are used.
_MIN_FRAMES, _FRAMES = 2, 4
#: The scene moves if more than the second share of the image tiles changes by more than the first number of standard
#: deviations.
_MOVED_SIGMAS, _MOVED_TILES = 5.0, 0.03
_WEAKER: Final = "This is weaker than examples with marked contact."


def suggest_tolerance(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose t: from examples of contact, or else from the noise."""
    if evidence.marked:
        return _from_examples("tolerance", evidence, progress)
    proximity, tactile = _noises(evidence, "tolerance", progress)
    rig = evidence.rig
    rounding_m = math.hypot(rig.proximity.depth_unit_m, rig.tactile.depth_unit_m) / math.sqrt(12)
    sigma_m = max(math.hypot(proximity.total_m, tactile.total_m), rounding_m)  # equal frames have no noise
    return _proposal(
        evidence,
        "tolerance",
        {"tolerance.t": tolerance_for(sigma_m, tactile.distance_m)},
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
    if evidence.marked:
        return _from_examples("outliers", evidence, progress)
    return _smallest_group("outliers", "outliers.min_cluster_area_mm2", evidence, progress)


def suggest_membrane(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the fields of the membrane test: from examples of contact, or else its smallest contact only."""
    if evidence.marked:
        return _from_examples("membrane", evidence, progress)
    return _smallest_group("membrane", "membrane.min_area_mm2", evidence, progress)


# Examples of contact


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Missed and false contact along the values of one field, as means over the examples.

    Attributes
    ----------
    values : float64, shape (N,)
        Ascending; the present value is among them.
    missed_mm2, false_mm2 : float64, shape (N,)
        Area of contact that is not found, and area that is found without contact.
    error : float64, shape (N,)
        Their sum as a share of the union of known and found contact; 1 if nothing is found. The sum alone is smallest
        for finding nothing where false contact is larger than contact.
    proposed : float
        The value with the smallest error of those whose distance between known and found contact is not larger than
        that of the present one: a larger patch may cover more, but invent contact far away. Of nearly equal values it
        is the present one, else the nearest to the shipped one.
    """

    values: Float64Array
    missed_mm2: Float64Array
    false_mm2: Float64Array
    error: Float64Array
    proposed: float

    def at(self, value: float) -> tuple[float, float]:
        """Return the missed and the false area at one of the values, mm^2."""
        index = int(np.argmin(np.abs(self.values - value)))
        return float(self.missed_mm2[index]), float(self.false_mm2[index])


def error_curve(path: str, evidence: Evidence, progress: Progress = lambda share, words: None) -> ErrorCurve:
    """Compute the error of a field's values in the examples; a pipeline for each repeats only steps that changed."""
    section, rig, examples = path.partition(".")[0], evidence.rig, evidence.all_examples
    in_use = {"contact_test": "membrane" if section == "membrane" else "tolerance"}
    preset = evidence.preset.with_values(in_use | ({"outliers.enabled": True} if section == "outliers" else {}))
    if preset.averaged_frames > 1:  # examples belong to different scenes
        preset = preset.with_value(preset.test.frames_field, 1)
    pipelines = [ContactPipeline(preset, rig) for _ in examples]
    areas_mm2 = [_areas_mm2(example, rig) for example in examples]
    default, present = usual_value(path), float(preset.value(path))
    values = np.unique([*TRIED[section][path], default, present])
    measured = np.zeros((len(values), len(examples), 3))
    for number, value in enumerate(values):
        progress(number / len(values), f"Trying {path} = {value:g}")
        tried = preset.with_value(path, float(value))
        for index, (example, pipeline, areas) in enumerate(zip(examples, pipelines, areas_mm2, strict=True)):
            pipeline.update(tried)
            found, contact = pipeline.process(example.frame).mask, example.known_contact
            if example.known is not None:
                found = found & example.known
            measured[number, index, :2] = areas[contact & ~found].sum(), areas[found & ~contact].sum()
            if contact.any():
                measured[number, index, 2] = _distance_px(found, contact) * math.sqrt(float(np.median(areas[contact])))
    missed_mm2, false_mm2, distance_mm = measured.mean(axis=1).T
    contact_mm2 = np.mean([areas[each.known_contact].sum() for each, areas in zip(examples, areas_mm2, strict=True)])
    error = (missed_mm2 + false_mm2) / np.maximum(contact_mm2 + false_mm2, 1e-9)
    near = distance_mm <= (1 + _TIE) * distance_mm[values == present]
    tied = values[near & (error <= error[near].min() + _TIE)]
    proposed = present if present in tied else float(tied[np.argmin(np.abs(tied - default))])
    return ErrorCurve(values, missed_mm2, false_mm2, error, proposed)


def usual_value(path: str) -> float:
    """Return the shipped value of a field that examples tell."""
    return _USUAL.get(path, float(Preset().value(path)))


def _areas_mm2(example: Example, rig: Rig) -> Float64Array:
    """Return the area of each proximity pixel at its depth; without a depth, at the median depth of the contact."""
    counts = example.frame.proximity_depth
    valid = valid_depth(counts)
    near = valid if example.contact is None else valid & example.contact
    usual = float(np.median(counts[near])) if near.any() else 0.0
    depth = np.where(valid, counts, usual).astype(np.float32) * np.float32(rig.proximity.depth_unit_m)
    return pixel_areas_m2(depth, rig.proximity.intrinsics) * 1e6


def _distance_px(found: BoolArray, contact: BoolArray) -> float:
    """Return the mean of the RMS distances from found to known contact and back.

    If nothing is found, it is the diagonal of the contact's bounding box, so that finding nothing never pays.
    """
    if not found.any():
        return float(np.linalg.norm(np.ptp(np.argwhere(contact), axis=0)))
    rms = []
    for here, there in ((found, contact), (contact, found)):
        to_there = cv2.distanceTransform((~there).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        rms.append(math.sqrt(float(np.mean(np.square(to_there[here])))))
    return sum(rms) / 2


def _from_examples(section: str, evidence: Evidence, progress: Progress) -> Proposal:
    """Choose the fields of a section one after the other, each by its curve."""
    changes: dict[str, float] = {}
    curves, now = [], evidence
    for number, path in enumerate(TRIED[section]):
        curve = error_curve(path, now, part_of(progress, number, len(TRIED[section])))
        curves.append(curve)
        changes[path] = curve.proposed
        now = Evidence(now.preset.with_value(path, curve.proposed), now.rig, now.frames, now.untouched, now.examples)
    before = curves[0].at(float(evidence.preset.value(next(iter(TRIED[section])))))
    after = curves[-1].at(curves[-1].proposed)
    touched = len(evidence.marked)
    free = len(evidence.all_examples) - touched
    return _proposal(
        evidence,
        section,
        changes,
        f"In {counted(touched, 'frame')} with marked contact and {counted(free, 'untouched frame')}, the best values "
        f"leave {sum(after):.0f} mm² of missed and false contact per frame.",
        f"Missed contact changes from {before[0]:.0f} to {after[0]:.0f} mm² per frame, false contact from "
        f"{before[1]:.0f} to {after[1]:.0f} mm².",
    )


# Noise


def _smallest_group(section: str, path: str, evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the smallest group that is kept: larger than what noise makes, and than what untouched frames show."""
    shipped, present = usual_value(path), float(evidence.preset.value(path))
    reasons, enough_mm2 = [], shipped
    if section == "outliers":
        cameras = evidence.rig.proximity, evidence.rig.tactile
        noises = zip(_noises(evidence, "outliers", part_of(progress, 0, 2)), cameras, strict=True)
        length_m = max(noise.length_px * noise.distance_m / camera.intrinsics.fx for noise, camera in noises)
        noise_mm2 = 1e6 * math.pi * length_m**2
        enough_mm2 = max(enough_mm2, noise_mm2)
        reasons.append(f"Noise is correlated over {1e3 * length_m:.1f} mm, so it makes groups of {noise_mm2:.0f} mm².")
    values = np.unique([*TRIED[section][path], shipped, present])
    if evidence.all_examples:
        curve = error_curve(path, evidence, part_of(progress, 1, 2))
        enough_mm2 = max(enough_mm2, float(values[curve.false_mm2 <= curve.false_mm2.min() + 1e-9].min()))
        false_mm2, kept_mm2 = curve.at(present)[1], float(np.interp(enough_mm2, values, curve.false_mm2))
        drop = f", and {kept_mm2:.0f} mm² if groups below {enough_mm2:.0f} mm² are dropped"
        reasons.append(
            f"In the untouched frames {false_mm2:.0f} mm² per frame count as contact with the present "
            f"value{drop if present < enough_mm2 else ''}."
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


def _noises(evidence: Evidence, section: str, progress: Progress) -> tuple[CameraNoise, CameraNoise]:
    """Return the noise of the proximity and of the tactile camera: the preset's, or that of the newest frames."""
    if (noise := evidence.preset.noise) is not None:
        return noise.proximity, noise.tactile
    frames = list({frame.sequence: frame for frame in evidence.frames}.values())[-_FRAMES:]
    remedy = "measure the rig's noise (Check cameras), or mark the contact in a frame"
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
        first, second, third, last = (tile_medians(images[index]) for index in (0, 1, 2, -1))
        known = np.isfinite(first + second + third + last)
        if known.any():
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
