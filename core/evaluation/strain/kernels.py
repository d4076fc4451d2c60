"""Compiled kernels: fits of inverse depth around dots, and the search for depth steps between two pixels."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from ...contact.kernels.compiling import inline, kernel
from ...model.arrays import Float32Array, Float64Array, Int64Array

#: Terms of a quadratic, and shape of the normal equations. Both right-hand sides: the values, and the unit vector e0.
_TERMS: Final = 6
SCRATCH_SHAPE: Final = (_TERMS, _TERMS + 2)
#: The median of this many nearest depths decides on which side of an edge a dot lies.
NEAREST: Final = 9
#: From this radius on only every other row and column is used: the noise of neighbouring pixels is correlated.
_SPARSE_FROM_PX: Final = 8
#: A dot is in a hole without depth, and has no place, if no disc up to this radius has enough depths, pixels.
_MAX_HOLE_PX: Final = 18
#: Pixels whose inverse depth differs from the central median by more than this share belong to another surface.
_SAME_SURFACE: Final = 0.04
#: A wider fit is accepted if it agrees with the narrower ones within this many standard deviations.
_AGREES_WITHIN: Final = 1.5
_MIN_SHARE: Final = 0.35
_MIN_COUNT: Final = _TERMS + 3
#: A smaller pivot means collinear pixels. The first entry of the equations is the number of pixels.
_MIN_PIVOT: Final = 1e-9


@inline
def _nearest_first(distances: Any, values: Any, count: int, distance: float, value: float) -> None:
    """Insert a value into the list of nearest values, sorted by distance."""
    place = count
    if count == len(values):
        if distance >= distances[count - 1]:
            return
        place -= 1
    while place > 0 and distances[place - 1] > distance:
        distances[place], values[place] = distances[place - 1], values[place - 1]
        place -= 1
    distances[place], values[place] = distance, value


@inline
def _solve(equations: Any) -> bool:
    """Solve symmetric equations with two right-hand sides in place; False if they are singular."""
    for column in range(_TERMS):
        pivot = equations[column, column]
        if not pivot > _MIN_PIVOT:
            return False
        for row in range(column + 1, _TERMS):
            share = equations[row, column] / pivot
            for k in range(column, _TERMS + 2):
                equations[row, k] -= share * equations[column, k]
    for row in range(_TERMS - 1, -1, -1):
        for side in (_TERMS, _TERMS + 1):
            for k in range(row + 1, _TERMS):
                equations[row, side] -= equations[row, k] * equations[k, side]
            equations[row, side] /= equations[row, row]
    return True


@inline
def _stride(radius: int) -> int:
    return 2 if radius >= _SPARSE_FROM_PX else 1


@inline
def _find_nearest(inverse: Any, u: float, v: float, radius: int, nearest: Any) -> int:
    """Write distances and values of the nearest pixels with depth; return how many pixels of the disc have depth."""
    middle_u, middle_v = int(np.rint(u)), int(np.rint(v))
    known = 0
    for row in range(max(middle_v - radius, 0), min(middle_v + radius + 1, inverse.shape[0]), _stride(radius)):
        for column in range(max(middle_u - radius, 0), min(middle_u + radius + 1, inverse.shape[1]), _stride(radius)):
            distance = (row - v) ** 2 + (column - u) ** 2
            if distance <= (radius + 0.5) ** 2 and not math.isnan(inverse[row, column]):
                _nearest_first(nearest[0], nearest[1], min(known, NEAREST), distance, inverse[row, column])
                known += 1
    return known


@inline
def _gather(inverse: Any, u: float, v: float, radius: int, middle: float, equations: Any) -> int:
    """Write the normal equations of a fit to the pixels of a disc on one surface; return their number."""
    middle_u, middle_v = int(np.rint(u)), int(np.rint(v))
    equations[:] = 0.0
    equations[0, _TERMS + 1] = 1.0
    same = 0
    for row in range(max(middle_v - radius, 0), min(middle_v + radius + 1, inverse.shape[0]), _stride(radius)):
        for column in range(max(middle_u - radius, 0), min(middle_u + radius + 1, inverse.shape[1]), _stride(radius)):
            x, y, value = (column - u) / radius, (row - v) / radius, inverse[row, column]
            outside = (row - v) ** 2 + (column - u) ** 2 > (radius + 0.5) ** 2
            if outside or not abs(value - middle) <= _SAME_SURFACE * middle:
                continue
            same += 1
            powers = (1.0, x, y, x * x, x * y, y * y)
            for i in range(_TERMS):
                for j in range(_TERMS):
                    equations[i, j] += powers[i] * powers[j]
                equations[i, _TERMS] += powers[i] * value
    return same


@inline
def _median(values: Any, count: int) -> float:
    """Sort the first ``count`` values in place and return their upper median."""
    for i in range(1, count):
        value, j = values[i], i
        while j > 0 and values[j - 1] > value:
            values[j] = values[j - 1]
            j -= 1
        values[j] = value
    return float(values[count // 2])


@inline
def _fit_disc(inverse: Any, u: float, v: float, radius: int, equations: Any, nearest: Any) -> float:
    """Solve the equations of a disc; return the inverse depth that tells its surface, nan if it has too few depths."""
    known = _find_nearest(inverse, u, v, radius, nearest)
    if known * _stride(radius) ** 2 < _MIN_SHARE * math.pi * radius**2 or known < _MIN_COUNT:
        return math.nan
    middle = _median(nearest[1], min(known, NEAREST))
    same = _gather(inverse, u, v, radius, middle, equations)
    if same < max(_MIN_SHARE * known, _MIN_COUNT) or not _solve(equations):
        return math.nan
    return float(middle)


@kernel
def fit_inverse_depths(
    inverse: Float64Array,
    pixels: Float64Array,
    noise: float,
    pixels_a_sample: float,
    radii: Int64Array,
    scratch: Float64Array,
    nearest: Float64Array,
    out: Float64Array,
) -> None:
    """Fit quadratics to inverse depth in growing discs around dots, while the fits agree (Lepski 1991).

    A larger disc averages more noise, until the surface in it is no quadratic any more. So the largest disc is taken up
    to which the intervals ``fit +- _AGREES_WITHIN * sigma`` of all discs have a point in common. Discs with too few
    depths are skipped.

    Parameters
    ----------
    inverse : float64, shape (H, W)
        1/m; nan where there is no depth.
    pixels : float64, shape (N, 2)
        ``(u, v)``.
    noise : float
        Standard deviation of inverse depth, 1/m.
    pixels_a_sample : float
        Neighbouring pixels share noise; this many count as one measurement.
    radii : int64, shape (K,)
        Radii of the discs, pixels, ascending.
    scratch, nearest : float64, shapes `SCRATCH_SHAPE` and (2, NEAREST)
        Work arrays, overwritten.
    out : float64, shape (N, 4)
        Output for each dot: inverse depth and its standard deviation, 1/m; radius of the disc, pixels; inverse depth
        that tells the pixels of the dot's surface, 1/m. nan without depth.
    """
    for dot in range(len(pixels)):
        u, v = pixels[dot, 0], pixels[dot, 1]
        out[dot] = math.nan
        low, high = -math.inf, math.inf  # what the intervals have in common
        for radius in radii:
            found = not math.isnan(out[dot, 0])
            if radius > _MAX_HOLE_PX and not found:
                break
            middle = _fit_disc(inverse, u, v, radius, scratch, nearest)
            if math.isnan(middle):
                if found:
                    break
                continue
            fit, variance_share = scratch[0, _TERMS], scratch[0, _TERMS + 1]
            if variance_share > 1.0:  # noisier than one pixel: the dot lies in a hole and the fit extrapolates
                continue
            shared_by = max(pixels_a_sample / _stride(radius) ** 2, 1.0)
            sigma = noise * min(math.sqrt(variance_share * shared_by), 1.0)
            low, high = max(low, fit - _AGREES_WITHIN * sigma), min(high, fit + _AGREES_WITHIN * sigma)
            if low > high:
                break
            out[dot, 0], out[dot, 1], out[dot, 2], out[dot, 3] = fit, sigma, radius, middle


@kernel
def fit_to_noise(
    inverse: Float64Array,
    pixels: Float64Array,
    fits: Float64Array,
    field: Float32Array,
    shifts: Int64Array,
    scratch: Float64Array,
    out: Float64Array,
) -> None:
    """Apply the fits of `fit_inverse_depths` to noise: the errors that they would make.

    Parameters
    ----------
    inverse : float64, shape (H, W)
    pixels : float64, shape (N, 2)
    fits : float64, shape (N, 4)
        Output of `fit_inverse_depths`.
    field : float32, shape (F, F)
        Noise, which wraps around; F is a power of 2.
    shifts : int64, shape (B, 2)
        Row and column of the field at the image's corner, for each sample.
    scratch : float64, shape `SCRATCH_SHAPE`
    out : float64, shape (N, B)
        Output: error of each fit in each sample, in the field's unit; nan without depth.
    """
    wrap = field.shape[0] - 1
    for dot in range(len(pixels)):
        u, v, middle = pixels[dot, 0], pixels[dot, 1], fits[dot, 3]
        out[dot] = math.nan
        if math.isnan(middle):
            continue
        out[dot] = 0.0
        radius = int(fits[dot, 2])
        _gather(inverse, u, v, radius, middle, scratch)
        _solve(scratch)
        share = scratch[:, _TERMS + 1]
        middle_u, middle_v = int(np.rint(u)), int(np.rint(v))
        for row in range(max(middle_v - radius, 0), min(middle_v + radius + 1, inverse.shape[0]), _stride(radius)):
            for column in range(
                max(middle_u - radius, 0), min(middle_u + radius + 1, inverse.shape[1]), _stride(radius)
            ):
                outside = (row - v) ** 2 + (column - u) ** 2 > (radius + 0.5) ** 2
                if outside or not abs(inverse[row, column] - middle) <= _SAME_SURFACE * middle:
                    continue
                x, y = (column - u) / radius, (row - v) / radius
                weight = share[0] + x * (share[1] + share[3] * x + share[4] * y) + y * (share[2] + share[5] * y)
                for sample in range(len(shifts)):
                    place = (row + shifts[sample, 0]) & wrap, (column + shifts[sample, 1]) & wrap
                    out[dot, sample] += weight * field[place]


@kernel
def is_smooth_between(
    depth_m: Float64Array, focal_px: float, start: Float64Array, end: Float64Array, steepest: float, apart: int
) -> bool:
    """Tell whether at least half of the line between two pixels has depth, and no slope on it is too steep.

    Parameters
    ----------
    depth_m : float64, shape (H, W)
        nan where there is none.
    focal_px : float
    start, end : float64, shape (2,)
        ``(u, v)``.
    steepest : float
        Largest slope against the image plane, metres per metre.
    apart : int
        Slopes are taken over this many pixels with depth.
    """
    height, width = depth_m.shape
    count = max(int(math.hypot(end[0] - start[0], end[1] - start[1])), 1) + 1
    seen = 0
    for place in range(count):
        seen += not math.isnan(_depth_on_way(depth_m, start, end, place, count, height, width))
    if 2 * seen < count:
        return False
    apart = min(apart, seen - 1)
    behind_at, lag = -1, 0
    for place in range(count):
        ahead = _depth_on_way(depth_m, start, end, place, count, height, width)
        if math.isnan(ahead):
            continue
        lag += 1
        if lag <= apart:
            continue
        behind = math.nan
        while math.isnan(behind):
            behind_at += 1
            behind = _depth_on_way(depth_m, start, end, behind_at, count, height, width)
        if abs(ahead - behind) > steepest * (place - behind_at) * ahead / focal_px:
            return False
    return True


@inline
def _depth_on_way(depth_m: Any, start: Any, end: Any, place: int, count: int, height: int, width: int) -> float:
    share = place / (count - 1)
    u, v = np.rint(start[0] + share * (end[0] - start[0])), np.rint(start[1] + share * (end[1] - start[1]))
    if not (0 <= u < width and 0 <= v < height):
        return math.nan
    return float(depth_m[int(v), int(u)])
