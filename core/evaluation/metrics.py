"""How well a contact patch agrees with the truth: pixels, clouds, boundaries, areas, separate contacts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from ..contact.pipeline import ContactPatch
from ..methods.method import MethodPatch
from ..model.arrays import BoolArray, Float32Array, Float64Array
from ..model.clouds import PointCloud, pixel_areas_m2, ray_table
from ..model.frames import GroundTruth, Rig


@dataclass(frozen=True)
class PixelScores:
    """Agreement of a mask with the true mask, pixel by pixel.

    Attributes
    ----------
    iou : float
        Intersection over union; 1 if both masks are empty.
    precision : float
        Share of the mask that is true; 1 if the mask is empty.
    recall : float
        Share of the truth that is in the mask; 1 if the truth is empty.
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


@dataclass(frozen=True)
class PatchOverlap:
    """How far two patches of one frame agree.

    Attributes
    ----------
    iou : float
        Intersection over union of the pixels; 1 if both patches are empty.
    only_a_mm2, only_b_mm2 : float
        Area that only one of them covers, projected on the plane across the optical axis.
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


def symmetric_rmse_m(first: npt.ArrayLike, second: npt.ArrayLike) -> float:
    """Return the average symmetric root mean square distance of two clouds, in their unit (metres).

    Mean of both directed values; each is the root mean square distance of one cloud's points to their nearest
    neighbours in the other cloud.

    Parameters
    ----------
    first, second : array_like, shape (N, 3) and (M, 3)

    Returns
    -------
    float
        0 for equal clouds; nan if either cloud is empty.
    """
    return cloud_distances(first, second).symmetric_rmse_m


def truth_cloud(truth: GroundTruth, rig: Rig) -> PointCloud:
    """Deproject the true contact: the true depth at every contact pixel that has one.

    Returns
    -------
    PointCloud
        Metres, proximity depth frame, row-major pixel order; empty if the truth has no depth.
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
        RMSE of the patch's points and `truth_cloud` in millimetres, nan if either is empty.
    """
    scores = pixel_scores(patch.mask, truth.contact)
    rmse_mm = 1e3 * symmetric_rmse_m(patch.points, truth_cloud(truth, rig).points)
    return {"iou": scores.iou, "precision": scores.precision, "recall": scores.recall, "rmse_mm": rmse_mm}


def method_area_mm2(patch: MethodPatch, rig: Rig) -> float:
    """Return a patch's area, projected on the plane across the optical axis.

    Number of proximity pixels times the pixel area at the points' mean square depth. (The points may come from the
    other camera's pixels, so they are not counted.)
    """
    if len(patch.points) == 0:
        return 0.0
    lens = rig.proximity.intrinsics
    square_m2 = float(np.mean(np.square(patch.points[:, 2], dtype=np.float64)))
    return 1e6 * np.count_nonzero(patch.mask) * square_m2 / (lens.fx * lens.fy)


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 1.0


@dataclass(frozen=True)
class CloudDistances:
    """Distances between two clouds, metres; nan if either is empty.

    A directed distance is that of each point of one cloud to its nearest neighbour in the other.

    Attributes
    ----------
    patch_to_truth_rms_m, truth_to_patch_rms_m : float
        Root mean square of the directed distances.
    symmetric_rmse_m : float
        Mean of these two, as in Yin et al.
    hausdorff_m : float
        Largest directed distance of both directions.
    percentile_95_m : float
        Larger of both directions' 95th percentiles: a Hausdorff distance without outliers.
    chamfer_m : float
        Mean of the two mean directed distances.
    """

    patch_to_truth_rms_m: float
    truth_to_patch_rms_m: float
    symmetric_rmse_m: float
    hausdorff_m: float
    percentile_95_m: float
    chamfer_m: float


def cloud_distances(patch: npt.ArrayLike, truth: npt.ArrayLike) -> CloudDistances:
    """Compare two clouds.

    Parameters
    ----------
    patch, truth : array_like, shape (N, 3) and (M, 3)
        Metres, in the same coordinate frame.
    """
    a, b = np.asarray(patch, np.float64).reshape(-1, 3), np.asarray(truth, np.float64).reshape(-1, 3)
    if len(a) == 0 or len(b) == 0:
        return CloudDistances(*[math.nan] * 6)
    there, back = _nearest(cKDTree(b), a), _nearest(cKDTree(a), b)
    there_rms, back_rms = _rms(there), _rms(back)
    return CloudDistances(
        patch_to_truth_rms_m=there_rms,
        truth_to_patch_rms_m=back_rms,
        symmetric_rmse_m=(there_rms + back_rms) / 2,
        hausdorff_m=float(max(there.max(), back.max())),
        percentile_95_m=float(max(np.percentile(there, 95), np.percentile(back, 95))),
        chamfer_m=float((there.mean() + back.mean()) / 2),
    )


class TruthTree:
    """The true cloud of a frame, for scoring many patches of this frame quickly.

    Parameters
    ----------
    truth : float, shape (N, 3)
        Metres; in the order of the pixels.
    samples : int
        Upper limit of the true points whose distance to a patch is measured; every n-th one is. This distance varies
        smoothly, so the symmetric RMSE stays within 1 % of `symmetric_rmse_m`. The distances from a patch to the truth
        are not sampled, because few stray points decide them.
    """

    def __init__(self, truth: npt.ArrayLike, samples: int = 6000) -> None:
        points = np.asarray(truth, np.float64).reshape(-1, 3)
        self._tree = _quick_tree(points)
        self._sample = points[:: max(1, -(-len(points) // samples))]

    def symmetric_rmses_m(self, patches: Sequence[Float32Array]) -> list[float]:
        """Return the symmetric RMSE of each patch, metres; nan if either cloud is empty.

        Parameters
        ----------
        patches : sequence of float32, shape (M, 3)
            Points that several patches share are looked up once.
        """
        if self._tree.n == 0 or not patches:
            return [math.nan] * len(patches)
        points = np.concatenate(patches)
        _, first, which = np.unique(_hashes(points), return_index=True, return_inverse=True)
        distances = _nearest(self._tree, points[first].astype(np.float64))[which]
        there = np.split(distances, np.cumsum([len(patch) for patch in patches])[:-1])
        return [self._symmetric_m(patch, mine) for patch, mine in zip(patches, there, strict=True)]

    def _symmetric_m(self, patch: Float32Array, to_truth: Float64Array) -> float:
        if len(patch) == 0:
            return math.nan
        return (_rms(to_truth) + _rms(_nearest(_quick_tree(patch.astype(np.float64)), self._sample))) / 2


def _hashes(points: Float32Array) -> npt.NDArray[np.uint64]:
    """Return 64 bits for each point, which are sorted faster than three coordinates: equal for equal points."""
    x, y, z = np.ascontiguousarray(points, np.float32).view(np.uint32).T.astype(np.uint64)
    both = (x << np.uint64(32) | y) * np.uint64(0x9E3779B97F4A7C15)
    return np.asarray((both ^ both >> np.uint64(29)) * np.uint64(0xBF58476D1CE4E5B9) + z, np.uint64)


def _quick_tree(points: Float64Array) -> cKDTree:
    """Return a tree that is built in half the time and answers as fast, for points of a smooth surface."""
    return cKDTree(points, balanced_tree=False, compact_nodes=False)


def boundary_distance_px(patch: BoolArray, truth: BoolArray) -> float:
    """Return the average symmetric distance of the outlines of two masks, pixels; nan if either is empty.

    Mean of both directed mean distances from the pixels of one outline to the nearest of the other. An outline pixel
    is a mask pixel with a 4-neighbour outside the mask.

    Parameters
    ----------
    patch, truth : bool, shape (H, W)
    """
    outlines = [_outline(mask) for mask in (patch, truth)]
    if not (outlines[0].any() and outlines[1].any()):
        return math.nan
    directed = [
        float(cv2.distanceTransform((~other).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[mine].mean())
        for mine, other in (outlines, outlines[::-1])
    ]
    return sum(directed) / 2


def separate_contacts(mask: BoolArray, min_pixels: int = 30) -> int:
    """Return the number of 8-connected groups of at least ``min_pixels`` pixels."""
    count, _, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    return int(np.count_nonzero(stats[1:count, cv2.CC_STAT_AREA] >= min_pixels))


def _outline(mask: BoolArray) -> BoolArray:
    padded = np.pad(mask, 1)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask & ~inner


def _nearest(tree: cKDTree, points: Float64Array) -> Float64Array:
    return np.asarray(tree.query(points)[0], np.float64)


def _rms(distances: Float64Array) -> float:
    return math.sqrt(float(np.mean(np.square(distances))))
