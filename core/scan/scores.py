"""A patch against the contact that paint shows on an aligned scan."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from ..errors import TactuneError
from ..evaluation.distances import area_error_mm2, cloud_distances
from ..model.arrays import BoolArray, Float64Array
from ..model.frames import Matrix4
from .paint import SPACING_M, surface_points
from .pose import transformed
from .scan import Scan


@dataclass(frozen=True, eq=False)
class ScanTruth:
    """The true contact that a scan shows.

    Attributes
    ----------
    points : float64, shape (K, 3)
        Evenly spread over the contact, metres, proximity depth frame.
    area_mm2 : float
        As for patches: projected on the plane across the optical axis.
    """

    points: Float64Array
    area_mm2: float


def scan_truth(scan: Scan, contact: BoolArray, pose: Matrix4, spacing_m: float = SPACING_M) -> ScanTruth:
    """Place a scan's contact in the proximity frame.

    Parameters
    ----------
    scan : Scan
    contact : bool, shape (N,)
        As from `painted_contact`.
    pose : 4 x 4
        ``T_proximity_scan``.
    spacing_m : float
        A point has the area of a square of this side.

    Raises
    ------
    TactuneError
        The pose puts contact behind the camera; and as `contact_points` does.
    """
    found, normals = surface_points(scan, contact, spacing_m)
    points = transformed(pose, found)
    if len(points) and points[:, 2].min() <= 0:
        raise TactuneError(
            "the transform puts the scan's contact behind the proximity camera; it must take the scan's frame, in "
            "metres, to the proximity depth frame"
        )
    turned = normals @ np.asarray(pose)[:3, :3].T
    # What a pixel sees of a tilted surface, n, along its ray, p: p / p_z is 1 long across the axis.
    projected = np.abs((turned * points).sum(axis=1)) / points[:, 2]
    return ScanTruth(points, float(projected.sum()) * 1e6 * spacing_m**2)


def score_against_scan(patch: npt.ArrayLike, area_mm2: float, truth: ScanTruth) -> dict[str, float]:
    """Compare a patch, (N, 3) in metres, and its area with the truth.

    Returns
    -------
    dict
        `CloudDistances` in millimetres, ``patch_to_truth_rms_mm`` and so on, nan where either is empty, and
        ``area_error_mm2``, how much larger the patch is.
    """
    apart = asdict(cloud_distances(patch, truth.points))
    scores = {f"{name.removesuffix('_m')}_mm": 1e3 * value for name, value in apart.items()}
    area = area_mm2 if math.isfinite(area_mm2) else 0.0
    return scores | {"area_error_mm2": area_error_mm2(area, truth.area_mm2)}
