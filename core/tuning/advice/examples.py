"""How much contact a preset misses and how much it invents in examples, along the values of one field."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from ...contact.pipeline import ContactPipeline
from ...errors import AdviceError
from ...model.arrays import Float64Array
from ...model.clouds import pixel_areas_m2, valid_depth
from ...model.frames import Rig
from ...preset import Preset
from ...sources.base import Progress
from .proposal import Evidence, Example

#: Fields with a curve, by section, in the order in which they are chosen, and the values that are tried.
CURVES: Final[dict[str, dict[str, tuple[float, ...]]]] = {
    "tolerance": {"tolerance.t": tuple(float(f"{t:.2g}") for t in np.geomspace(0.002, 0.08, 24))},
    "outliers": {
        "outliers.ratio": (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0),
        "outliers.min_cluster_area_mm2": (0, 5, 10, 20, 30, 50, 75, 100, 150),
    },
    "membrane": {
        "membrane.gap_m": (0.0, 1e-5, 2e-5, 5e-5, 1e-4, 1.5e-4, 2e-4, 3e-4, 5e-4),
        "membrane.trust_m": (0.006, 0.008, 0.012, 0.016, 0.02, 0.028, 0.04),
        "membrane.min_area_mm2": (0, 5, 10, 20, 30, 50, 75, 100, 150, 200),
    },
}
#: Values whose error exceeds the smallest by at most this are equally good.
_TIE: Final = 0.01
#: The value chosen among equally good ones, where it is not the default of the field: the paper keeps all clusters, the
#: shipped preset `simulator` drops those below this area.
_USUAL: Final = {"outliers.min_cluster_area_mm2": 30.0}


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Missed and false contact along the values of one field, as means over the examples.

    Attributes
    ----------
    path : str
        The field, such as ``"tolerance.t"``.
    values : float64, shape (N,)
        Ascending; the present and the proposed value are among them.
    missed_mm2, false_mm2 : float64, shape (N,)
        Area of contact that is not found, and area that is found without contact. Mean per example.
    present, proposed : float
        The proposed value has the smallest `error`; of nearly equal ones the nearest to the shipped value.
    contact_mm2 : float
        Area of the painted contact, mean per example.
    """

    path: str
    values: Float64Array
    missed_mm2: Float64Array
    false_mm2: Float64Array
    present: float
    proposed: float
    contact_mm2: float

    @property
    def error(self) -> Float64Array:
        """Missed and false area as a share of the union of painted and found contact; 1 if nothing is found.

        The sum of both areas alone is smallest for finding nothing where false contact is larger than contact.
        """
        union = self.contact_mm2 + self.false_mm2
        return np.asarray((self.missed_mm2 + self.false_mm2) / np.maximum(union, 1e-9))

    def at(self, value: float) -> tuple[float, float]:
        """Return the missed and the false area at a value, interpolated, mm^2."""
        missed, false = (float(np.interp(value, self.values, area)) for area in (self.missed_mm2, self.false_mm2))
        return missed, false


class Judge:
    """Measures what presets miss and invent in examples. A pipeline for each example repeats only steps that changed.

    Parameters
    ----------
    preset : Preset
    rig : Rig
    examples : sequence of Example

    Attributes
    ----------
    contact_mm2 : float
        Area of the painted contact, mean per example.
    """

    def __init__(self, preset: Preset, rig: Rig, examples: tuple[Example, ...]) -> None:
        self._examples = examples
        self._pipelines = [ContactPipeline(_single(preset), rig) for _ in examples]
        self._areas_mm2 = [_areas_mm2(example, rig) for example in examples]
        painted = zip(examples, self._areas_mm2, strict=True)
        self.contact_mm2 = sum(_contact_mm2(example, areas) for example, areas in painted) / len(examples)

    def areas_mm2(self, preset: Preset) -> tuple[float, float]:
        """Return the missed and the false area, means per example, mm^2."""
        missed = false = 0.0
        for example, pipeline, areas in zip(self._examples, self._pipelines, self._areas_mm2, strict=True):
            pipeline.update(_single(preset))
            found = pipeline.process(example.frame).mask
            known = np.True_ if example.known is None else example.known
            contact = np.False_ if example.contact is None else example.contact
            missed += float(areas[contact & ~found & known].sum())
            false += float(areas[found & ~contact & known].sum())
        return missed / len(self._examples), false / len(self._examples)


def known_examples(evidence: Evidence) -> tuple[Example, ...]:
    """Return the examples, the untouched frame among them."""
    untouched = () if evidence.untouched is None else (Example(evidence.untouched),)
    return (*evidence.examples, *untouched)


def error_curve(path: str, evidence: Evidence, progress: Progress = lambda share, words: None) -> ErrorCurve:
    """Compute the error of a field's values in the examples, the untouched frame among them.

    Parameters
    ----------
    path : str
        A field in `CURVES`.
    evidence : Evidence
    progress : callable, optional
        As for `suggest`.

    Raises
    ------
    AdviceError
        The field has no curve, or there is no example.
    """
    examples = known_examples(evidence)
    if not examples:
        raise AdviceError(
            f"{path}: without examples nothing is known to be missed or false; mark the frame as untouched, or paint "
            "its contact"
        )
    return curve_of(path, evidence.preset, Judge(evidence.preset, evidence.rig, examples), progress)


def curve_of(path: str, preset: Preset, judge: Judge, progress: Progress) -> ErrorCurve:
    """Compute the curve of a field around a preset."""
    section = path.partition(".")[0]
    if path not in CURVES.get(section, {}):
        paths = ", ".join(path for fields in CURVES.values() for path in fields)
        raise AdviceError(f"there is no error curve of {path!r}; choose one of {paths}")
    preset = preset.with_values(_in_use(section))
    default, present = usual_value(path), float(preset.value(path))
    values = np.unique([*CURVES[section][path], default, present])
    areas = np.empty((len(values), 2))
    for number, value in enumerate(values):
        progress(number / len(values), f"Trying {path} = {value:g}")
        areas[number] = judge.areas_mm2(preset.with_value(path, float(value)))
    curve = ErrorCurve(path, values, areas[:, 0], areas[:, 1], present, present, judge.contact_mm2)
    tied = values[curve.error <= curve.error.min() + _TIE]
    return replace(curve, proposed=float(tied[np.argmin(np.abs(tied - default))]))


def usual_value(path: str) -> float:
    """Return the shipped value of a field with a curve."""
    return _USUAL.get(path, float(Preset().value(path)))


def _in_use(section: str) -> dict[str, Any]:
    """Return the fields that make a section of a contact test count."""
    test = "membrane" if section == "membrane" else "tolerance"
    return {"contact_test": test} | ({"outliers.enabled": True} if section == "outliers" else {})


def _single(preset: Preset) -> Preset:
    """Return the preset without averaging over frames: examples belong to different scenes."""
    frames = preset.test.frames_field
    return preset if preset.averaged_frames == 1 else preset.with_value(frames, 1)


def _areas_mm2(example: Example, rig: Rig) -> Float64Array:
    """Return the area of each proximity pixel at its depth; without a depth, at the median depth of the contact."""
    counts = example.frame.proximity_depth
    valid = valid_depth(counts)
    near = valid if example.contact is None else valid & example.contact
    usual = float(np.median(counts[near])) if near.any() else 0.0
    depth = np.where(valid, counts, usual).astype(np.float32) * np.float32(rig.proximity.depth_unit_m)
    return pixel_areas_m2(depth, rig.proximity.intrinsics) * 1e6


def _contact_mm2(example: Example, areas_mm2: Float64Array) -> float:
    """Return the area of known contact."""
    if example.contact is None:
        return 0.0
    return float(areas_mm2[example.contact if example.known is None else example.contact & example.known].sum())
