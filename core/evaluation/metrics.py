"""How well a contact patch agrees with the truth: pixel scores and the distance between clouds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..contact.pipeline import ContactPatch
from ..methods.method import MethodPatch
from ..model.arrays import BoolArray
from ..model.clouds import PointCloud, ray_table
from ..model.frames import GroundTruth, Rig
from .distances import cloud_distances


@dataclass(frozen=True)
class PixelScores:
    """How a mask agrees with the true mask, pixel by pixel.

    Attributes
    ----------
    iou : float
        Pixels in both over pixels in either; 1 where both masks are empty.
    precision : float
        Share of the mask that is true; 1 where the mask is empty (it claims nothing false).
    recall : float
        Share of the truth that is in the mask; 1 where the truth is empty (nothing is missed).
    """

    iou: float
    precision: float
    recall: float


def pixel_scores(mask: BoolArray, truth: BoolArray) -> PixelScores:
    """Compare two masks.

    Parameters
    ----------
    mask, truth : bool, shape (H, W)

    Raises
    ------
    ValueError
        The masks have different shapes.
    """
    if mask.shape != truth.shape:
        raise ValueError(f"the masks have the shapes {mask.shape} and {truth.shape}; compare masks of one camera")
    both = int(np.count_nonzero(mask & truth))
    claimed, true = int(np.count_nonzero(mask)), int(np.count_nonzero(truth))
    return PixelScores(
        iou=_share(both, claimed + true - both), precision=_share(both, claimed), recall=_share(both, true)
    )


def symmetric_rmse_m(first: npt.ArrayLike, second: npt.ArrayLike) -> float:
    """Return the average symmetric root mean square distance of two clouds, in their unit (metres).

    The mean of the two directed values, each the root mean square over one cloud's points of the
    distance to the nearest point of the other cloud.

    Parameters
    ----------
    first, second : array_like, shape (N, 3) and (M, 3)

    Returns
    -------
    float
        0 for the same cloud; nan where either cloud is empty, since then there is no distance.
    """
    return cloud_distances(first, second).symmetric_rmse_m


def truth_cloud(truth: GroundTruth, rig: Rig) -> PointCloud:
    """Deproject the true contact: the true depth at every contact pixel that has one.

    Returns
    -------
    PointCloud
        Metres, proximity depth frame, row-major pixel order; empty where the truth has no depth.
    """
    if truth.depth_m is None:
        return PointCloud(np.empty((0, 3), np.float32))
    pixels = truth.contact & np.isfinite(truth.depth_m)
    depth = truth.depth_m[pixels][:, None]
    rays = ray_table(rig.proximity.intrinsics)[pixels]
    return PointCloud(np.concatenate([rays * depth, depth], axis=1).astype(np.float32))


def compare_with_truth(patch: ContactPatch | MethodPatch, truth: GroundTruth, rig: Rig) -> dict[str, float]:
    """Score a patch.

    Returns
    -------
    dict
        ``iou``, ``precision``, ``recall`` as in `PixelScores`, and ``rmse_mm``, the average symmetric
        RMSE of the patch's points and `truth_cloud` in millimetres, nan where either is empty.
    """
    scores = pixel_scores(patch.mask, truth.contact)
    rmse_mm = 1e3 * symmetric_rmse_m(patch.points, truth_cloud(truth, rig).points)
    return {"iou": scores.iou, "precision": scores.precision, "recall": scores.recall, "rmse_mm": rmse_mm}


def method_area_mm2(patch: MethodPatch, rig: Rig) -> float:
    """Return a patch's area, projected on the plane across the optical axis.

    The area of its proximity pixels at its mean square depth: the points may be another camera's pixels.
    """
    if len(patch.points) == 0:
        return 0.0
    lens = rig.proximity.intrinsics
    square_m2 = float(np.mean(np.square(patch.points[:, 2], dtype=np.float64)))
    return 1e6 * np.count_nonzero(patch.mask) * square_m2 / (lens.fx * lens.fy)


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 1.0
