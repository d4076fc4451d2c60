"""Compiled colour look-up and colour test."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.arrays import Int64Array
from ...model.sections import MaskSection
from .compiling import inline, kernel
from .lenses import project
from .simd import (
    floats,
    floor,
    greater,
    ints,
    lesser,
    shift_right,
    to_floats,
    to_ints,
    where,
)

_HALF = np.float32(0.5)

# OpenCV's 8-bit HSV divides by table, in fixed point with 12 bits. The entries are quotients rounded to the nearest
# integer, which float32 represents exactly for each of the 255 divisors.
_SHIFT = 12
_ONE = np.float32(1.0)
_NOTHING, _FOUR = np.int32(0), np.int32(4)
_FULL, _SIXTH = np.float32(255 << _SHIFT), np.float32((180 << _SHIFT) // 6)
_ROUND, _HUES = np.int32(1 << (_SHIFT - 1)), np.int32(180)


def hsv_limits(section: MaskSection) -> Int64Array:
    """Return the range as kernels take it: low and high hue, saturation and value, int64, shape (6,)."""
    return np.array([*section.hue, *section.saturation, *section.value], np.int64)


@inline
def _divided(dividend: Any, divisor: Any) -> Any:
    """Return the quotient rounded to the nearest integer; a divisor of 0 counts as 1."""
    quotient = floats(dividend) / greater(to_floats(divisor), floats(_ONE))
    return to_ints(floor(quotient + floats(_HALF)))


@inline
def lanes_in_range(r: Any, g: Any, b: Any, limits: Any) -> Any:
    """Return which colours (int32) lie in a range of OpenCV's 8-bit HSV; a low hue above the high one wraps around."""
    value = greater(r, greater(g, b))
    chroma = value - lesser(r, lesser(g, b))
    saturation = shift_right(chroma * _divided(_FULL, value) + ints(_ROUND), _SHIFT)
    hue = where(
        value == r,
        g - b,
        where(value == g, b - r + chroma + chroma, r - g + ints(_FOUR) * chroma),
    )
    hue = shift_right(hue * _divided(_SIXTH, chroma) + ints(_ROUND), _SHIFT)
    hue = where(hue < ints(_NOTHING), hue + ints(_HUES), hue)
    low, high = ints(np.int32(limits[0])), ints(np.int32(limits[1]))
    from_low, to_high = hue >= low, hue <= high
    fits = (from_low & to_high) if limits[0] <= limits[1] else (from_low | to_high)
    fits = fits & (saturation >= ints(np.int32(limits[2]))) & (saturation <= ints(np.int32(limits[3])))
    return fits & (value >= ints(np.int32(limits[4]))) & (value <= ints(np.int32(limits[5])))


@kernel
def color_lookup(
    points: Any, rotation: Any, translation: Any, lens: Any, camera: Any, image: Any, colors: Any, seen: Any
) -> None:
    """Write the colour of each point (N, 3) in the image of a colour camera; ``seen`` is False outside the image."""
    height, width = image.shape[:2]
    u_end = np.float32(width) - _HALF
    v_end = np.float32(height) - _HALF
    bytes_of = image.reshape(-1)
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = rotation[0], rotation[1], rotation[2]
    tx, ty, tz = translation
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = r00 * px + r01 * py + r02 * pz + tx
        y = r10 * px + r11 * py + r12 * pz + ty
        z = r20 * px + r21 * py + r22 * pz + tz
        seen[i] = False
        if not z > 0:
            continue
        u, v = project(x, y, z, lens, camera)
        if u >= -_HALF and u < u_end and v >= -_HALF and v < v_end:
            # unsigned, as negative indices would have to be looked for; neither number is negative
            first = np.uint64(3) * np.uint64(np.int32(v + _HALF) * np.int32(width) + np.int32(u + _HALF))
            for channel in range(3):
                colors[i, channel] = bytes_of[first + np.uint64(channel)]
            seen[i] = True
