"""Which pixels and depths the tolerance test looks at."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .alignment import Region
from .preset import RangeSection, RegionSection, ToleranceSection


def region_bounds(section: RegionSection, shape: tuple[int, int]) -> Region:
    """Return left, top, right, bottom (exclusive) of the region, cut to the image."""
    height, width = shape
    if not section.enabled:
        return np.array([0, 0, width, height])
    left, top, region_width, region_height = section.rectangle
    return np.array([left, top, min(left + region_width, width), min(top + region_height, height)])


def depth_limits(limits: RangeSection, tolerance: ToleranceSection) -> npt.NDArray[np.float32]:
    """Return nearest and farthest depth considered, metres, and the tolerance, as the kernels take them."""
    near, far = limits.limits_m if limits.enabled else (0.0, np.inf)
    return np.array([near, far, tolerance.t], np.float32)
