"""Fields of the contact tests: from the error in examples of contact, or else from the noise of the rig."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from ...contact.dent import noise_limit_m
from ...contact.pipeline import ContactPipeline
from ...errors import AdviceError, counted
from ...model.arrays import Float64Array
from ...model.clouds import pixel_areas_m2, valid_depth
from ...model.frames import Rig
from ...preset import Preset
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
    "dent.limit_m": "smallest dent",
}
#: The value chosen among equally good ones, where it is not the default of the field: the paper keeps all clusters, the
#: shipped preset `simulator` drops those below this area.
_USUAL: Final = {"outliers.min_cluster_area_mm2": 30.0}
#: Values whose error exceeds the smallest by at most this are equally good.
_TIE: Final = 0.01
#: Without examples, t covers this number of standard deviations of the noise of both depths: 95 % of the pixels.
_T_SIGMAS: Final = 2.0


def suggest_fields(section: str, evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the fields of a section of a contact test: from marked contact, or else t from the noise of the rig."""
    if evidence.marked:
        return _from_examples(section, evidence, progress)
    noise = evidence.preset.noise
    if section != "tolerance" or noise is None:
        remedy = " or measure the rig's noise (F6)" if section == "tolerance" else ""
        raise AdviceError(f"{section}: marked contact tells these values; mark it in a frame (Examples…){remedy}")
    sigma_m = math.hypot(noise.proximity.total_m, noise.tactile.total_m)
    distance_m = noise.tactile.distance_m
    return _proposal(
        evidence,
        section,
        {"tolerance.t": min(float(f"{_T_SIGMAS * sigma_m / distance_m:.2g}"), 1.0)},
        f"The difference of both depths has a noise of {1e3 * sigma_m:.1f} mm at {1e3 * distance_m:.0f} mm distance; t "
        f"covers {_T_SIGMAS:g} standard deviations. This is weaker than examples with marked contact.",
        "Nearly all contact passes, and no larger gap than noise requires.",
    )


def suggest_dent(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the smallest dent that the measured noise allows, rounded up to 0.1 mm."""
    noise = evidence.preset.noise
    if noise is None:
        raise AdviceError("dent: the noise of the camera tells the smallest dent; measure it (F6)")
    limit_m = noise_limit_m(noise)
    return _proposal(
        evidence,
        "dent",
        {"dent.limit_m": max(math.ceil(1e4 * limit_m), 1) / 1e4},
        f"Noise explains movements up to {1e3 * limit_m:.1f} mm of a membrane at rest.",
        "Nothing but noise is left out.",
    )


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Missed and false contact along the ascending values of one field, as means over the examples, mm^2.

    ``error`` is their sum as a share of the union of known and found contact, 1 if nothing is found: the sum alone is
    smallest for finding nothing where false contact is larger than contact. ``proposed`` has the smallest error; of
    nearly equal values it is the present one, else the nearest to the shipped one.
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
    measured = np.zeros((len(values), len(examples), 2))
    for number, value in enumerate(values):
        progress(number / len(values), f"Trying {_NAMES[path]} {_shown(path, value)}")
        tried = preset.with_value(path, float(value))
        for index, (example, pipeline, areas) in enumerate(zip(examples, pipelines, areas_mm2, strict=True)):
            pipeline.update(tried)
            found, contact = pipeline.process(example.frame).mask, example.mask
            measured[number, index] = areas[contact & ~found].sum(), areas[found & ~contact].sum()
    missed_mm2, false_mm2 = measured.mean(axis=1).T
    contact_mm2 = np.mean([areas[each.mask].sum() for each, areas in zip(examples, areas_mm2, strict=True)])
    error = (missed_mm2 + false_mm2) / np.maximum(contact_mm2 + false_mm2, 1e-9)
    tied = values[error <= error.min() + _TIE]
    proposed = present if present in tied else float(tied[np.argmin(np.abs(tied - default))])
    return ErrorCurve(values, missed_mm2, false_mm2, error, proposed)


def usual_value(path: str) -> float:
    return _USUAL.get(path, float(Preset().value(path)))


def _areas_mm2(example: Example, rig: Rig) -> Float64Array:
    """Return the area of each proximity pixel at its depth; without a depth, at the median depth of the contact."""
    counts = example.frame.proximity_depth
    valid = valid_depth(counts)
    near = valid if example.contact is None else valid & example.contact
    usual = float(np.median(counts[near])) if near.any() else 0.0
    depth = np.where(valid, counts, usual).astype(np.float32) * np.float32(rig.proximity.depth_unit_m)
    return pixel_areas_m2(depth, rig.proximity.intrinsics) * 1e6


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


def _proposal(evidence: Evidence, section: str, changes: Mapping[str, Any], sentence: str, expected: str) -> Proposal:
    changed = {path: value for path, value in changes.items() if value != evidence.preset.value(path)}
    label = ", ".join(f"{_NAMES[path]} {_shown(path, value)}" for path, value in changed.items())
    label = label[:1].upper() + label[1:] if label else f"Keep {', '.join(_NAMES[path] for path in changes)}"
    return Proposal(section, changed, label, sentence, expected)


def _shown(path: str, value: float) -> str:
    if path.endswith("_m"):
        return f"{1e3 * value:g} mm"
    if path == "tolerance.t":
        return f"{100 * value:g} %"
    return f"{value:g} mm²" if path.endswith("_mm2") else f"{value:g}"
