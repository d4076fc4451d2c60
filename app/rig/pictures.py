"""What the quality tab shows of a frame, made on another thread: both depth images and the measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...core.model.arrays import Uint8Array
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import AlignmentSection
from ...core.rig.depth_quality import DepthQuality, Rectangle, measure_quality
from ..calibration.pictures import picture


@dataclass(frozen=True, eq=False)
class Measurement:
    """One measurement and the images it was made on, as ``QImage.Format_RGB32`` has them in memory."""

    quality: DepthQuality
    proximity: Uint8Array
    tactile: Uint8Array


def measure(
    frames: Sequence[SensorFrame],
    rig: Rig,
    section: AlignmentSection,
    region: Rectangle,
    true_distance_m: float | None,
) -> Measurement:
    """Measure the region and draw the newest frame."""
    quality = measure_quality(frames, rig, section, region, true_distance_m)
    near, far = (picture(frames[-1], rig, side, "depth", stretch=True).pixels for side in ("proximity", "tactile"))
    return Measurement(quality, near, far)
