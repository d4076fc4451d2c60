"""What is said and saved of one contact patch: its JSON record and its point cloud with attributes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..core.clouds import PointCloud
from ..core.pipeline import ContactPatch


def patch_record(patch: ContactPatch) -> dict[str, Any]:
    """Return the numbers of a patch, ready for JSON (an empty patch has the centroid None)."""
    return {
        "sequence": int(patch.sequence),
        "points": len(patch.points),
        "area_mm2": finite_or_none(patch.area_mm2),
        "centroid_m": patch.centroid_m,
        "stage_ms": {stage: round(ms, 4) for stage, ms in patch.stage_ms.items()},
    }


def patch_cloud(patch: ContactPatch) -> PointCloud:
    """Return the patch's points with, for each, its pixel ``u``, ``v`` and ``relative_difference``."""
    v, u = np.nonzero(patch.mask)
    attributes: dict[str, np.ndarray[Any, np.dtype[np.generic]]] = {
        "u": u.astype(np.uint16),
        "v": v.astype(np.uint16),
        "relative_difference": patch.relative_difference[patch.mask],
    }
    return PointCloud(patch.points, attributes=attributes)


def finite_or_none(number: float | None) -> float | None:
    """Return a number as JSON can hold it: nan and infinity become None."""
    return None if number is None or not math.isfinite(number) else float(number)
