"""What is said of one contact patch: its numbers, ready for JSON."""

from __future__ import annotations

import math
from typing import Any

from ...core.contact.pipeline import ContactPatch


def patch_record(patch: ContactPatch) -> dict[str, Any]:
    """Return the numbers of a patch, ready for JSON (an empty patch has the centroid None)."""
    return {
        "sequence": int(patch.sequence),
        "points": len(patch.points),
        "area_mm2": finite_or_none(patch.area_mm2),
        "centroid_m": patch.centroid_m,
        "averaged_frames": patch.averaged_frames,
        "stage_ms": {stage: round(ms, 4) for stage, ms in patch.stage_ms.items()},
    }


def finite_or_none(number: float | None) -> float | None:
    """Return a number as JSON can hold it: nan and infinity become None."""
    return None if number is None or not math.isfinite(number) else float(number)
