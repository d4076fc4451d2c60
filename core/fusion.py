"""The tolerance test, pixel by pixel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from . import kernels
from .alignment import AlignedDepth, CountsImage, Region
from .frames import DepthCamera
from .preset import RangeSection, RegionSection, ToleranceSection


def region_bounds(section: RegionSection, shape: tuple[int, int]) -> Region:
    """Return left, top, right, bottom (exclusive) of the region, cut to the image."""
    height, width = shape
    if not section.enabled:
        return np.array([0, 0, width, height])
    left, top, region_width, region_height = section.rectangle
    return np.array([left, top, min(left + region_width, width), min(top + region_height, height)])


def range_limits(section: RangeSection) -> tuple[np.float32, np.float32]:
    """Return the nearest and farthest depth considered, in metres."""
    near, far = section.limits_m if section.enabled else (0.0, np.inf)
    return np.float32(near), np.float32(far)


def tolerance_test(
    counts: CountsImage,
    camera: DepthCamera,
    aligned: AlignedDepth,
    region: Region,
    limits: RangeSection,
    tolerance: ToleranceSection,
) -> npt.NDArray[np.uint8]:
    """Test ``|dp - dt| <= t |dp|`` and return each pixel's provenance; candidates carry CONTACT.

    Parameters
    ----------
    counts : uint16, shape (H, W)
        Raw proximity depth.

    Returns
    -------
    uint8, shape (H, W)
        Values of `Provenance`.
    """
    provenance = np.empty(counts.shape, np.uint8)
    near, far = range_limits(limits)
    kernels.classify(
        counts, np.float32(camera.depth_unit_m), aligned.expected_m, aligned.measured_m,
        np.float32(tolerance.t), near, far, region, provenance,
    )  # fmt: skip
    return provenance
