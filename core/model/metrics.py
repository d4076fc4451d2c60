"""How well a contact patch agrees with the truth: pixels and clouds."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

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
    both = int(np.count_nonzero(mask & truth))
    claimed, true = int(np.count_nonzero(mask)), int(np.count_nonzero(truth))
    return PixelScores(_share(both, claimed + true - both), _share(both, claimed), _share(both, true))


def _share(part: int, whole: int) -> float:
    return part / whole if whole else math.nan


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
    return TruthTree(second).symmetric_rmse_m(first)


class TruthTree:
    """The true cloud of a frame (N, 3), in the order of the pixels, for scoring many patches of this frame.

    The distance to a patch is measured from at most ``samples`` true points, every n-th. It varies smoothly, so the
    symmetric RMSE with 6000 stays within 1 % of that with all. The distances from a patch are not sampled, because few
    stray points decide them.
    """

    def __init__(self, truth: npt.ArrayLike, samples: float = math.inf) -> None:
        points = np.asarray(truth, np.float64).reshape(-1, 3)
        self._tree = _tree(points)
        self._sample = points[:: max(1, math.ceil(len(points) / samples))]

    def symmetric_rmse_m(self, patch: npt.ArrayLike) -> float:
        points = np.asarray(patch, np.float64).reshape(-1, 3)
        if self._tree.n == 0 or len(points) == 0:
            return math.nan
        there, back = self._tree.query(points)[0], _tree(points).query(self._sample)[0]
        return (_rms(there) + _rms(back)) / 2


def _tree(points: Float64Array) -> cKDTree:
    """Return a search tree, built in half the usual time, which suits points of a smooth surface."""
    from scipy.spatial import cKDTree  # not above: it takes long to import, and the window needs masks only

    return cKDTree(points, balanced_tree=False, compact_nodes=False)


def _rms(distances: Any) -> float:
    return math.sqrt(float(np.mean(np.square(distances))))
