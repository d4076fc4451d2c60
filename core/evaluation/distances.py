"""Distances between a contact patch and the truth: clouds, boundaries, areas, separate contacts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from ..model.arrays import BoolArray, Float64Array


@dataclass(frozen=True)
class CloudDistances:
    """How far two clouds lie from each other, in their own unit (metres); nan where either is empty.

    Directed values are over the nearest neighbours of each point of the one cloud in the other.

    Attributes
    ----------
    patch_to_truth_rms_m, truth_to_patch_rms_m : float
        Root mean square of the directed distances.
    symmetric_rmse_m : float
        The mean of these two, as in Yin et al.
    hausdorff_m : float
        The largest distance of either direction.
    percentile_95_m : float
        The larger of both directions' 95th percentiles, a Hausdorff distance without the outliers.
    chamfer_m : float
        The mean of the two mean directed distances.
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
        Metres, one frame.
    """
    a, b = np.asarray(patch, np.float64).reshape(-1, 3), np.asarray(truth, np.float64).reshape(-1, 3)
    if len(a) == 0 or len(b) == 0:
        return CloudDistances(*[math.nan] * 6)
    there, back = _to_nearest(a, b), _to_nearest(b, a)
    there_rms, back_rms = _rms(there), _rms(back)
    return CloudDistances(
        patch_to_truth_rms_m=there_rms,
        truth_to_patch_rms_m=back_rms,
        symmetric_rmse_m=(there_rms + back_rms) / 2,
        hausdorff_m=float(max(there.max(), back.max())),
        percentile_95_m=float(max(np.percentile(there, 95), np.percentile(back, 95))),
        chamfer_m=float((there.mean() + back.mean()) / 2),
    )


def area_error_mm2(patch_mm2: float, truth_mm2: float) -> float:
    """Return how much larger the patch is than the truth, mm^2; negative where it is smaller."""
    return patch_mm2 - truth_mm2


def boundary_distance_px(patch: BoolArray, truth: BoolArray) -> float:
    """Return the average symmetric distance of the outlines of two masks, pixels; nan where either is empty.

    The mean of both directed mean distances from each outline pixel to the nearest of the other
    outline. An outline pixel is one of the mask with a 4-neighbour outside it.

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


def _to_nearest(points: Float64Array, others: Float64Array) -> Float64Array:
    return np.asarray(cKDTree(others).query(points)[0], np.float64)


def _rms(distances: Float64Array) -> float:
    return math.sqrt(float(np.mean(np.square(distances))))
