"""Which pixels and depths the tolerance test looks at."""

from __future__ import annotations

import numpy as np

from ..preset import RangeSection, RegionSection, ToleranceSection
from .kernels.chain import DepthLimits, Region


def region_bounds(section: RegionSection, shape: tuple[int, int]) -> Region:
    """Return the region in pixels, clipped to the image."""
    height, width = shape
    if not section.enabled:
        return Region(0, 0, width, height)
    left, top, region_width, region_height = section.rectangle
    return Region(left, top, min(left + region_width, width), min(top + region_height, height))


def depth_limits(limits: RangeSection, tolerance: ToleranceSection) -> DepthLimits:
    """Return the nearest and farthest depth considered (metres), and the tolerance."""
    near, far = limits.limits_m if limits.enabled else (0.0, np.inf)
    return DepthLimits(np.float32(near), np.float32(far), np.float32(tolerance.t))
