"""How much contact a preset misses and how much it invents in examples, along the values of one field."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np

from ...contact.pipeline import ContactPipeline
from ...errors import AdviceError
from ...model.arrays import BoolArray, Float32Array, Float64Array
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
        "membrane.min_area_mm2": (0, 5, 10, 15, 20, 30, 50, 75, 100, 150, 200),
    },
}
#: Values whose error exceeds the smallest by at most this are equally good, and so are distances by this share.
_TIE: Final = 0.01
#: The value chosen among equally good ones without the present one, where it is not the default of the field: the paper
#: keeps all clusters, the shipped preset `simulator` drops those below this area.
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
    distance_mm : float64, shape (N,)
        Root mean square distance in the image between painted and found contact, both ways. Mean per painted example.
    present, proposed : float
        The proposed value has the smallest `error` of those whose distance is not larger than the present one's: a
        larger patch may cover more of the contact, but invent contact far from it. Of nearly equal values it is the
        present one, else the nearest to the shipped one.
    contact_mm2 : float
        Area of the painted contact, mean per example.
    """

    path: str
    values: Float64Array
    missed_mm2: Float64Array
    false_mm2: Float64Array
    distance_mm: Float64Array
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
        painted = list(zip(examples, self._areas_mm2, strict=True))
        self.contact_mm2 = sum(float(areas[_contact(example)].sum()) for example, areas in painted) / len(examples)

    def measure(self, preset: Preset) -> tuple[float, float, float]:
        """Return the missed and the false area, mm^2, and the distance, mm; see `ErrorCurve`."""
        missed = false = 0.0
        distances = []
        for example, pipeline, areas in zip(self._examples, self._pipelines, self._areas_mm2, strict=True):
            pipeline.update(_single(preset))
            found, contact = pipeline.process(example.frame).mask, _contact(example)
            if example.known is not None:
                found = found & example.known
            missed += float(areas[contact & ~found].sum())
            false += float(areas[found & ~contact].sum())
            if contact.any():
                distances.append(_distance_px(found, contact) * math.sqrt(float(np.median(areas[contact]))))
        count = len(self._examples)
        return missed / count, false / count, sum(distances) / max(len(distances), 1)


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
    measured = np.empty((len(values), 3))
    for number, value in enumerate(values):
        progress(number / len(values), f"Trying {path} = {value:g}")
        measured[number] = judge.measure(preset.with_value(path, float(value)))
    missed_mm2, false_mm2, distance_mm = measured.T
    curve = ErrorCurve(path, values, missed_mm2, false_mm2, distance_mm, present, present, judge.contact_mm2)
    near = curve.distance_mm <= (1 + _TIE) * curve.distance_mm[values == present]
    tied = values[near & (curve.error <= curve.error[near].min() + _TIE)]
    return curve if present in tied else replace(curve, proposed=float(tied[np.argmin(np.abs(tied - default))]))


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


def _contact(example: Example) -> BoolArray:
    """Return the pixels of known contact."""
    if example.contact is None:
        return np.zeros(example.frame.proximity_depth.shape, bool)
    return example.contact if example.known is None else example.contact & example.known


def _distance_px(found: BoolArray, contact: BoolArray) -> float:
    """Return the mean of the RMS distances from found to painted contact and back.

    If nothing is found, it is the diagonal of the contact's bounding box, so that finding nothing never pays.
    """
    if not found.any():
        return float(np.linalg.norm(np.ptp(np.argwhere(contact), axis=0)))
    distances = (_to_nearest_px(there)[here] for here, there in ((found, contact), (contact, found)))
    return sum(math.sqrt(float(np.mean(np.square(each)))) for each in distances) / 2


def _to_nearest_px(inside: BoolArray) -> Float32Array:
    return np.asarray(cv2.distanceTransform((~inside).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)
