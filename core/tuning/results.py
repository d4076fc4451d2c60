"""The result of one run of a sweep, and the measures of a frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from statistics import fmean, median
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..evaluation.metrics import method_area_mm2, pixel_scores, truth_cloud
from ..methods.method import MethodPatch
from ..model.arrays import BoolArray, Float32Array
from ..model.clouds import pixel_areas_m2
from ..model.frames import Rig, SensorFrame


@dataclass(frozen=True)
class Result:
    """The result of a run: means over its frames; None if no frame has a value.

    Attributes
    ----------
    key : str
        Of the run.
    rmse_mm : float or None
        Average symmetric RMSE, over frames in which both truth and patch have points.
    iou, precision, recall : float or None
        In proximity pixels, over frames with truth.
    area_error_mm2 : float or None
        Mean absolute difference to the true area, over frames with truth.
    area_mm2, points : float or None
        Of the patch.
    stability : float or None
        Mean IoU of the masks of consecutive frames; None if no frame has a patch.
    frames, missed : int
        Number of processed frames, and of frames with true contact in which no contact was found.
    ms : float or None
        Median computation time of a frame on one thread.
    failure : str
        Why the method could not be built or failed on a frame; empty if it did not.
    """

    key: str
    rmse_mm: float | None = None
    iou: float | None = None
    precision: float | None = None
    recall: float | None = None
    area_error_mm2: float | None = None
    area_mm2: float | None = None
    points: float | None = None
    stability: float | None = None
    frames: int = 0
    missed: int = 0
    ms: float | None = None
    failure: str = ""


#: Numeric fields of a result.
MEASURES = tuple(item.name for item in fields(Result) if item.name not in ("key", "failure"))


def result_from_json(found: Any) -> Result:
    """Return the result from a JSON object.

    Raises
    ------
    ValueError
        The object is not a result: a field is missing, unknown or has the wrong type.
    """
    kinds = {item.name: item.type for item in fields(Result)}
    if not isinstance(found, dict) or found.keys() != kinds.keys():
        raise ValueError("it has not the fields of a result")
    for name, kind in kinds.items():
        allowed = {"str": (str,), "int": (int,)}.get(str(kind), (int, float, type(None)))
        if not isinstance(found[name], allowed) or isinstance(found[name], bool):
            raise ValueError(f"{name} is {found[name]!r}")
    return Result(**found)


class JudgedFrame:
    """Measures patches against the truth of one frame; values that depend on the truth alone are computed once."""

    def __init__(self, frame: SensorFrame, rig: Rig) -> None:
        self.frame = frame
        self._rig = rig
        self._last: tuple[MethodPatch, dict[str, float]] | None = None

    def judge(self, patch: MethodPatch) -> dict[str, float]:
        """Return the measures of a patch in this frame; nan where one is undefined."""
        if self._last is not None and _same(self._last[0], patch):
            return self._last[1]
        numbers = {"points": float(len(patch.points)), "area_mm2": method_area_mm2(patch, self._rig)}
        if self.frame.truth is not None:
            pixels = pixel_scores(patch.mask, self.frame.truth.contact)
            numbers |= {
                "iou": pixels.iou,
                "precision": pixels.precision,
                "recall": pixels.recall,
                "area_error_mm2": abs(numbers["area_mm2"] - self._area_mm2),
                "rmse_mm": self._rmse_mm(patch),
                "missed": float(len(patch.points) == 0 and bool(self.frame.truth.contact.any())),
            }
        self._last = patch, numbers
        return numbers

    @cached_property
    def _truth(self) -> Float32Array:
        assert self.frame.truth is not None
        return truth_cloud(self.frame.truth, self._rig).points

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._truth.astype(np.float64))

    @cached_property
    def _area_mm2(self) -> float:
        return 1e6 * float(pixel_areas_m2(self._truth[:, 2], self._rig.proximity.intrinsics).sum())

    def _rmse_mm(self, patch: MethodPatch) -> float:
        """Return the same as `evaluation.metrics.symmetric_rmse_m`; the k-d tree of the truth is reused."""
        if len(patch.points) == 0 or self._tree.n == 0:
            return math.nan
        points = patch.points.astype(np.float64)
        there, back = self._tree.query(points)[0], cKDTree(points).query(self._tree.data)[0]
        return 500.0 * sum(math.sqrt(float(np.mean(np.square(distances)))) for distances in (there, back))


@dataclass
class Tally:
    """Collects the measures of all frames of one run."""

    key: str
    _numbers: dict[str, list[float]] = field(default_factory=dict)
    _ms: list[float] = field(default_factory=list)
    _frames: int = 0
    _failure: str = ""
    _mask: BoolArray | None = None
    _overlaps: list[float] = field(default_factory=list)

    def add(self, frame: JudgedFrame, patch: MethodPatch, ms: float) -> None:
        """Add the patch of the next frame."""
        self._frames += 1
        self._ms.append(ms)
        if patch.failure:
            self.fail(f"frame {frame.frame.sequence}: {patch.failure}")
            return
        for name, number in frame.judge(patch).items():
            self._numbers.setdefault(name, []).append(number)
        if self._mask is not None:
            self._overlaps.append(pixel_scores(self._mask, patch.mask).iou)
        self._mask = patch.mask

    def fail(self, reason: str) -> None:
        """Record why there is no patch; the first reason is kept."""
        self._failure = self._failure or reason

    def result(self) -> Result:
        """Return the result over all frames."""
        means = {name: _mean(numbers) for name, numbers in self._numbers.items() if name != "missed"}
        found_something = any(self._numbers.get("points", ()))
        return Result(
            self.key,
            **means,
            stability=_mean(self._overlaps) if found_something else None,
            frames=self._frames,
            missed=int(sum(self._numbers.get("missed", ()))),
            ms=median(self._ms) if self._ms else None,
            failure=self._failure,
        )


def _mean(numbers: Sequence[float]) -> float | None:
    known = [number for number in numbers if math.isfinite(number)]
    return fmean(known) if known else None


def _same(first: MethodPatch, second: MethodPatch) -> bool:
    return np.array_equal(first.points, second.points) and np.array_equal(first.mask, second.mask)
