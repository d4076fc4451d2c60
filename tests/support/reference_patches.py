"""Contact patches by the reference implementation, the oracle of the tolerance test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tactune.core.lab.reference import Reference
from tactune.core.model.arrays import AnyArray, IndexArray, Uint8Array
from tactune.core.model.frames import Rig, SensorFrame
from tactune.core.preset import Preset


@dataclass(frozen=True, eq=False)
class ReferencePatch:
    """Points (N, 3) in metres, their flat pixels (N,), and the verdict on each pixel (H, W)."""

    points: AnyArray
    pixels: IndexArray
    provenance: Uint8Array


def reference_patch(preset: Preset, rig: Rig, frame: SensorFrame, dtype: Any = np.float32) -> ReferencePatch:
    """Compute a frame's contact patch with the given floating-point type."""
    provenance = np.empty(frame.proximity_depth.shape, np.uint8)
    points, pixels = Reference(preset, rig, dtype).find(frame, provenance.reshape(-1))
    return ReferencePatch(points, pixels, provenance)


def same_patch(one: Any, other: Any) -> bool:
    """Return whether two patches have the same verdict on each pixel, and points of the same bits."""
    verdicts = np.array_equal(one.provenance, other.provenance)
    return verdicts and np.array_equal(one.points.view(np.uint32), other.points.view(np.uint32))
