"""What the strip says about the pixel under the mouse."""

from __future__ import annotations

import math

from ...core.contact.provenance import Provenance
from ..worker.results import Result


def readout(result: Result, u: int, v: int) -> str:
    """Say both distances at a proximity pixel, their difference, and why it was kept or dropped."""
    patch = result.patch
    height, width = result.frame.proximity_depth.shape
    if patch is None or not (0 <= u < width and 0 <= v < height):
        return ""
    expected, measured = float(patch.aligned.expected_m[v, u]), float(patch.aligned.measured_m[v, u])
    relative = float(patch.relative_difference[v, u])
    parts = [f"({u}, {v})", f"dp {_metres(expected)}", f"dt {_metres(measured)}"]
    if math.isfinite(relative):
        parts.append(f"(dp − dt) / dp = {relative:+.1%} ({1e3 * (expected - measured):+.1f} mm)")
    parts.append(Provenance(int(patch.provenance[v, u])).explanation)
    return "   ".join(parts)


def _metres(value: float) -> str:
    return f"{value:.4f} m" if math.isfinite(value) else "none"
