"""How well a contact patch agrees with the truth: pixels and clouds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..errors import TactuneError
from .arrays import BoolArray, Float32Array, Float64Array
from .clouds import pixel_areas_m2, truth_points
from .frames import GroundTruth, Rig, SensorFrame
from .patch import ContactPatch

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


@dataclass(frozen=True)
class PixelScores:
    """Agreement of a mask with the true mask, pixel by pixel; nan where nothing can be compared."""

    iou: float  # Intersection over union
    precision: float  # Share of the mask that is true
    recall: float  # Share of the truth that is in the mask


def pixel_scores(mask: BoolArray, truth: BoolArray) -> PixelScores:
    """Compare two masks of one camera, bool, shape (H, W)."""
    if mask.shape != truth.shape:
        raise ValueError(f"the masks have the shapes {mask.shape} and {truth.shape}; compare masks of one camera")
    both = int(np.count_nonzero(mask & truth))
    claimed, true = int(np.count_nonzero(mask)), int(np.count_nonzero(truth))
    return PixelScores(_share(both, claimed + true - both), _share(both, claimed), _share(both, true))


def _share(part: int, whole: int) -> float:
    return part / whole if whole else math.nan


@dataclass(frozen=True)
class PatchOverlap:
    """How far two patches of one frame agree: intersection over union, and the area that only one of them covers.

    Without a pixel in either, ``iou`` is nan.
    """

    iou: float
    only_a_mm2: float
    only_b_mm2: float


def patch_overlap(a: ContactPatch, b: ContactPatch) -> PatchOverlap:
    """Compare two patches of the same frame."""
    return PatchOverlap(pixel_scores(a.mask, b.mask).iou, _area_outside_mm2(a, b), _area_outside_mm2(b, a))


def _area_outside_mm2(patch: ContactPatch, other: ContactPatch) -> float:
    depth_m = patch.points[~other.mask[patch.mask], 2]
    return float(pixel_areas_m2(depth_m, patch.rig.proximity.intrinsics).sum() * 1e6)


def true_contact(frame: SensorFrame, rig: Rig) -> tuple[Float32Array, float]:
    """Return the points of the true contact (metres, proximity depth frame) and its area in mm^2."""
    if frame.truth is None:
        raise TactuneError("the scene has no ground truth, so no method can be scored on it; choose a simulated one")
    points = truth_points(frame.truth, rig)
    return points, 1e6 * float(pixel_areas_m2(points[:, 2], rig.proximity.intrinsics).sum())


def compare_with_truth(patch: ContactPatch, truth: GroundTruth, rig: Rig) -> dict[str, float]:
    """Return the `PixelScores` of a patch by name, and `symmetric_rmse_m` of both clouds as ``rmse_mm``."""
    scores = asdict(pixel_scores(patch.mask, truth.contact))
    return {**scores, "rmse_mm": 1e3 * symmetric_rmse_m(patch.points, truth_points(truth, rig))}


def symmetric_rmse_m(first: npt.ArrayLike, second: npt.ArrayLike) -> float:
    """Return the mean of both directed RMS distances of two clouds, as in Yin et al.; nan if one is empty."""
    a, b = np.asarray(first, np.float64).reshape(-1, 3), np.asarray(second, np.float64).reshape(-1, 3)
    if len(a) == 0 or len(b) == 0:
        return math.nan
    return (_rms(nearest_distances(_tree(b), a)) + _rms(nearest_distances(_tree(a), b))) / 2


class TruthTree:
    """The true cloud of a frame (N, 3), in the order of the pixels, for scoring many patches of this frame quickly.

    The distance to a patch is measured from at most ``samples`` true points, every n-th. It varies smoothly, so the
    symmetric RMSE stays within 1 % of `symmetric_rmse_m`. The distances from a patch are not sampled, because few stray
    points decide them.
    """

    def __init__(self, truth: npt.ArrayLike, samples: int = 6000) -> None:
        points = np.asarray(truth, np.float64).reshape(-1, 3)
        self._tree = _tree(points, quick=True)
        self._sample = points[:: max(1, -(-len(points) // samples))]

    def symmetric_rmses_m(self, patches: Sequence[Float32Array]) -> list[float]:
        """Return the symmetric RMSE of each patch (M, 3); points that several patches share are looked up once."""
        if self._tree.n == 0 or not patches:
            return [math.nan] * len(patches)
        points = np.concatenate(patches)
        _, first, which = np.unique(_hashes(points), return_index=True, return_inverse=True)
        distances = nearest_distances(self._tree, points[first].astype(np.float64))[which]
        there = np.split(distances, np.cumsum([len(patch) for patch in patches])[:-1])
        return [self._symmetric_m(patch, mine) for patch, mine in zip(patches, there, strict=True)]

    def _symmetric_m(self, patch: Float32Array, to_truth: Float64Array) -> float:
        if len(patch) == 0:
            return math.nan
        back = nearest_distances(_tree(patch.astype(np.float64), quick=True), self._sample)
        return (_rms(to_truth) + _rms(back)) / 2


def _hashes(points: Float32Array) -> npt.NDArray[np.uint64]:
    """Return 64 bits for each point, which are sorted faster than three coordinates: equal for equal points."""
    x, y, z = np.ascontiguousarray(points, np.float32).view(np.uint32).T.astype(np.uint64)
    both = (x << np.uint64(32) | y) * np.uint64(0x9E3779B97F4A7C15)
    return np.asarray((both ^ both >> np.uint64(29)) * np.uint64(0xBF58476D1CE4E5B9) + z, np.uint64)


def _tree(points: Float64Array, quick: bool = False) -> cKDTree:
    """Return a search tree; for points of a smooth surface a quick one is built in half the time."""
    from scipy.spatial import cKDTree  # not above: it takes long to import, and the window needs masks only

    return cKDTree(points, balanced_tree=not quick, compact_nodes=not quick)


def nearest_distances(tree: cKDTree, points: Float64Array) -> Float64Array:
    return np.asarray(tree.query(points)[0], np.float64)


def _rms(distances: Float64Array) -> float:
    return math.sqrt(float(np.mean(np.square(distances))))
