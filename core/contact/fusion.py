"""Which pixels and depths the tolerance test looks at."""

from __future__ import annotations

import numpy as np

from ..model.arrays import Float32Array, Int64Array
from ..preset import RangeSection, RegionSection, ToleranceSection


def region_bounds(section: RegionSection, shape: tuple[int, int]) -> Int64Array:
    """Return left, top, right, bottom (exclusive) of the region, cut to the image."""
    height, width = shape
    if not section.enabled:
        return np.array([0, 0, width, height])
    left, top, region_width, region_height = section.rectangle
    return np.array([left, top, min(left + region_width, width), min(top + region_height, height)])


def depth_limits(limits: RangeSection, tolerance: ToleranceSection) -> Float32Array:
    """Return nearest and farthest depth considered, metres, and the tolerance, as the kernels take them."""
    near, far = limits.limits_m if limits.enabled else (0.0, np.inf)
    return np.array([near, far, tolerance.t], np.float32)
