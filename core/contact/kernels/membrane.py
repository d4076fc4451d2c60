"""The loops over pixels of the membrane contact test, compiled; see `tactune.core.contact.kernels.tolerance`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...model.arrays import Float32Array
from .compiling import inline, kernel
from .simd import LANES, absolute, bits, flags, float_scratch, floats, int_scratch, ints, load, to_floats, where
from .tolerance import (
    TILE_ROWS,
    both_depths,
    is_depth,
    is_masked,
    lane_columns,
    plane_size,
    store_lanes,
    vector_place,
    within,
)

#: States of pixels, as `find_differences` writes them. The colour of masked ones is the mask's; excluded ones lie
#: outside the region, or on the membrane outside the range; unseen ones have no proximity or no tactile depth.
TAKES_NO_PART, USABLE, MASKED, EXCLUDED, UNSEEN = range(5)
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
_MIN_DIVISOR = np.float32(1e-6)
_float_vector, _int_vector = float_scratch(LANES), int_scratch(LANES)


class RayWindow(NamedTuple):
    """Rays of a part of the image."""

    rays: Float32Array  # (H, W, 2): x / z and y / z of each pixel of the whole image
    #: Row and column of the whole image at which the images of the part begin.
    top: int
    left: int


@inline
def _compare(place: Any, depth: Any, valid: Any, state: Any, images: Any, test: Any, color: Any, largest_m: Any) -> Any:
    """Return the differences of the ``valid`` lanes, 0 where too large, and the states with USABLE and MASKED set."""
    dp, _, dt, has_dt = both_depths(place, depth, valid, images.tactile, test.alignment)
    state = where(valid & ~has_dt, ints(np.int32(UNSEEN)), state)
    near = has_dt & (absolute(dp - dt) < floats(largest_m))
    difference = where(near, dp - dt, floats(_ZERO))
    state = where(near, ints(np.int32(USABLE)), state)
    if color.hsv.shape[0] > 0 and bits(near) != 0:
        x = load(test.rays, place) * depth
        y = load(test.rays, plane_size(test.alignment.size) + place) * depth
        state = where(near & is_masked(x, y, depth, place, color), ints(np.int32(MASKED)), state)
    return difference, state


@kernel
def find_differences(
    images: Any, test: Any, color: Any, tiles: Any, rectangle: Any, bias_m: Any, largest_m: Any, differences: Any,
    states: Any, first: Any, last: Any,
) -> None:  # fmt: skip
    """Write the differences between both depths for rows ``first`` to ``last - 1`` of a rectangle.

    ``images``, ``test`` (without its tolerance), ``color`` and ``tiles`` as in `tolerance.find_candidates`. The
    rectangle is left, a multiple of `LANES`, top, and right, exclusive, in proximity pixels. By its pixels, flat:
    proximity depth less ``bias_m`` minus tactile depth, float32 metres, 0 where it is not smaller than ``largest_m``,
    and the states, uint8.
    """
    width, pixels = test.alignment.size.width, plane_size(test.alignment.size)
    left, top, right = rectangle
    float_buffer, int_buffer = _float_vector(), _int_vector()
    for v in range(top + first, top + last):
        row_in_region = v >= test.region.top and v < test.region.bottom
        for u in range(left, right, LANES):
            place, before = vector_place(v, u, width, pixels)
            count = load(images.proximity, place)
            depth = to_floats(count) * floats(test.alignment.proximity_unit_m)
            column = lane_columns(u, before)
            considered = within(column, test.region.left, test.region.right)
            if not row_in_region:
                considered = flags(0)
            in_range = (depth >= floats(test.limits.nearest_m)) & (depth <= floats(test.limits.farthest_m))
            state = where(considered, ints(np.int32(TAKES_NO_PART)), ints(np.int32(EXCLUDED)))
            state = where(considered & ~is_depth(count), ints(np.int32(UNSEEN)), state)
            difference = floats(_ZERO)
            valid = considered & is_depth(count) & (column >= ints(np.int32(u)))
            if tiles[v // TILE_ROWS, u // LANES] and bits(valid) != 0:
                depth = depth - floats(bias_m)
                difference, state = _compare(place, depth, valid, state, images, test, color, largest_m)
                # what is far from the membrane tells that it is free there, in the range or not
                left_out = ~in_range & ((state == ints(np.int32(USABLE))) | (state == ints(np.int32(MASKED))))
                difference = where(left_out, floats(_ZERO), difference)
                state = where(left_out, ints(np.int32(EXCLUDED)), state)
            start = (v - top) * (right - left) + u - left
            store_lanes(differences, start, right - u, difference, before, float_buffer)
            store_lanes(states, start, right - u, state, before, int_buffer)


@inline
def divide_by_shares(points: Any) -> None:
    """Divide points (H, W, 4), which are multiplied by their shares, by these."""
    for v in range(points.shape[0]):
        for u in range(points.shape[1]):
            factor = _ONE / max(points[v, u, 3], _MIN_DIVISOR)
            for axis in range(3):
                points[v, u, axis] *= factor


@inline
def derivatives(points: Any, axis: Any, v: Any, u: Any) -> Any:
    """Return the first differences of a coordinate along u and v, and the second along u, both, and v."""
    centre = np.float64(points[v, u, axis])
    left, right = np.float64(points[v, u - 1, axis]), np.float64(points[v, u + 1, axis])
    above, below = np.float64(points[v - 1, u, axis]), np.float64(points[v + 1, u, axis])
    across = np.float64(points[v + 1, u + 1, axis]) - points[v + 1, u - 1, axis]
    across += points[v - 1, u - 1, axis] - points[v - 1, u + 1, axis]
    return (right - left) / 2, (below - above) / 2, right - 2 * centre + left, across / 4, below - 2 * centre + above


@inline
def bulge_at(points: Any, v: Any, u: Any) -> Any:
    """Return twice the mean curvature of a surface, (E N - 2 F M + G L) / (E G - F^2), 1/m; nan where it has no area.

    ``points`` (H, W, 4) run to the right and down; derivatives are central differences. The curvature is positive where
    the surface bulges away from the camera.
    """
    x_u, x_v, x_uu, x_uv, x_vv = derivatives(points, 0, v, u)
    y_u, y_v, y_uu, y_uv, y_vv = derivatives(points, 1, v, u)
    z_u, z_v, z_uu, z_uv, z_vv = derivatives(points, 2, v, u)
    ee, gg = x_u * x_u + y_u * y_u + z_u * z_u, x_v * x_v + y_v * y_v + z_v * z_v
    ff = x_u * x_v + y_u * y_v + z_u * z_v
    area = ee * gg - ff * ff
    bulge = np.float32(np.nan)
    if area > 0.0:
        nx, ny, nz = y_u * z_v - z_u * y_v, z_u * x_v - x_u * z_v, x_u * y_v - y_u * x_v
        ll = x_uu * nx + y_uu * ny + z_uu * nz
        mm = x_uv * nx + y_uv * ny + z_uv * nz
        nn = x_vv * nx + y_vv * ny + z_vv * nz
        bulge = np.float32(-(ee * nn - 2 * ff * mm + gg * ll) / (area * np.sqrt(area)))
    return bulge


@kernel
def bulges(points: Any, min_share: Any, out: Any) -> None:
    """Write twice the mean curvature of a surface, 1/m; nan at the border and where the share is below ``min_share``.

    ``points`` (H, W, 4) are multiplied by their shares, the last column; they are divided by them in place.
    """
    divide_by_shares(points)
    out[:] = np.float32(np.nan)
    for v in range(1, points.shape[0] - 1):
        for u in range(1, points.shape[1] - 1):
            if points[v, u, 3] >= min_share:
                out[v, u] = bulge_at(points, v, u)


@kernel
def forget_moved(counts: Any, means: Any, frames: Any, side: Any, share: Any, jump: Any) -> Any:
    """Set ``frames`` to 0 in the squares of ``side`` pixels whose depth has changed; return the number of these.

    A square has changed if the mean change of its depths is more than ``share`` of their mean. The change of a pixel is
    limited to ``jump`` of its depth. Squares with depth in few pixels are left as they are.
    """
    height, width = counts.shape
    found = 0
    for top in range(0, height, side):
        for left in range(0, width, side):
            change, depth, known = _ZERO, _ZERO, 0
            for v in range(top, min(top + side, height)):
                for u in range(left, min(left + side, width)):
                    count = counts[v, u]
                    if not 0 < count < 65535 or frames[v, u] == _ZERO:
                        continue
                    mean = means[v, u]
                    change += min(max(np.float32(count) - mean, -jump * mean), jump * mean)
                    depth += mean
                    known += 1
            pixels = (min(top + side, height) - top) * (min(left + side, width) - left)
            if 4 * known <= pixels or abs(change) <= share * depth:
                continue
            found += 1
            frames[top : top + side, left : left + side] = _ZERO
    return found


@kernel
def add_to_means(counts: Any, means: Any, frames: Any, out: Any, max_frames: Any, jump: Any) -> None:
    """Add an image of counts to the means over ``frames`` frames, and write the means as counts; 0 for no depth.

    A pixel that differs from its mean by more than ``jump`` of it restarts; a pixel without depth loses one frame of
    its weight. No mean has the weight of more than ``max_frames`` frames.
    """
    height, width = counts.shape
    for v in range(height):
        for u in range(width):
            count, before, mean = counts[v, u], frames[v, u], means[v, u]
            value = np.float32(count)
            if not 0 < count < 65535:
                before = max(before - _ONE, _ZERO)
            elif before == _ZERO or abs(value - mean) > jump * mean:
                before, mean = _ONE, value
            else:
                before = min(before + _ONE, max_frames)
                mean += (value - mean) / before
            frames[v, u], means[v, u] = before, mean
            out[v, u] = np.uint16(mean + _HALF) if before > _ZERO else np.uint16(0)


@kernel
def collect_points(
    contact: Any, depth: Any, share: Any, min_share: Any, window: Any, pixels_out: Any, points_out: Any
) -> Any:
    """Write the pixels in contact whose share is above ``min_share``, and their points; return their number.

    Images are (H, W); ``window`` is their `RayWindow`. ``pixels_out`` receives flat pixels of the whole image,
    ``points_out`` (N, 3) points in metres.
    """
    rays, top, left = window
    count = 0
    for v in range(contact.shape[0]):
        for u in range(contact.shape[1]):
            if not contact[v, u] or not share[v, u] > min_share:
                continue
            z = depth[v, u]
            pixels_out[count] = (top + v) * rays.shape[1] + left + u
            points_out[count, 0] = rays[top + v, left + u, 0] * z
            points_out[count, 1] = rays[top + v, left + u, 1] * z
            points_out[count, 2] = z
            count += 1
    return count
