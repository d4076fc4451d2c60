"""Compiled per-pixel kernels, all in float32 with one fixed order of operations.

`tactune.core.reference` repeats that order in NumPy, so both give the same bits on every input:
nothing here uses fast-math, and threads only ever split rows or points.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from .intrinsics import Distortion, Intrinsics
from .provenance import Provenance

PINHOLE, BROWN, INVERSE = 0, 1, 2

_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_HALF = np.float32(0.5)
_NAN = np.float32(np.nan)

_NO_PROXIMITY_DEPTH = np.uint8(Provenance.NO_PROXIMITY_DEPTH)
_OUTSIDE_REGION = np.uint8(Provenance.OUTSIDE_REGION)
_OUTSIDE_RANGE = np.uint8(Provenance.OUTSIDE_RANGE)
_NO_TACTILE_DEPTH = np.uint8(Provenance.NO_TACTILE_DEPTH)
_OUTSIDE_TOLERANCE = np.uint8(Provenance.OUTSIDE_TOLERANCE)
_CANDIDATE = np.uint8(Provenance.CONTACT)


def lens_parameters(intrinsics: Intrinsics) -> tuple[int, npt.NDArray[np.float32]]:
    """Return the lens model's number and ``fx fy cx cy k1 k2 p1 p2 k3`` as the kernels take them."""
    if not intrinsics.has_distortion:
        lens = PINHOLE
    elif intrinsics.distortion is Distortion.BROWN_CONRADY:
        lens = BROWN
    else:
        lens = INVERSE
    values = (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy, *intrinsics.coefficients)
    return lens, np.array(values, dtype=np.float32)


@njit(cache=True, nogil=True, inline="always")
def _project(x: Any, y: Any, z: Any, lens: Any, c: Any) -> Any:
    """Project a point to pixel coordinates (float32), as `Intrinsics.project` does in float64."""
    x = x / z
    y = y / z
    if lens != PINHOLE:
        r2 = x * x + y * y
        radial = _ONE + ((c[8] * r2 + c[5]) * r2 + c[4]) * r2
        if lens == INVERSE:
            x = x * radial
            y = y * radial
        dx = _TWO * c[6] * x * y + c[7] * (r2 + _TWO * x * x)
        dy = _TWO * c[7] * x * y + c[6] * (r2 + _TWO * y * y)
        if lens == BROWN:
            x = x * radial
            y = y * radial
        x = x + dx
        y = y + dy
    return x * c[0] + c[2], y * c[1] + c[3]


@njit(cache=True, nogil=True, parallel=True)
def align_rigid(
    counts: Any, unit: Any, directions: Any, translation: Any, tactile: Any, factor: Any, offset: Any, lens: Any,
    camera: Any, region: Any, expected: Any, measured: Any
) -> None:  # fmt: skip
    """Project every proximity point of a region into the tactile image and look its depth up.

    Parameters
    ----------
    counts, tactile : uint16, (H, W) and (Ht, Wt)
    unit : float32
        Metres a proximity count.
    directions : float32, (H, W, 3)
        Each proximity ray rotated into the tactile frame.
    translation : float32, (3,)
        Origin of the proximity frame in the tactile frame, metres.
    factor, offset : float32
        Corrected tactile depth in metres = counts * factor + offset.
    lens, camera
        From `lens_parameters` of the tactile camera.
    region : int64, (4,)
        Left, top, right, bottom; right and bottom exclusive.
    expected, measured : float32, (H, W), written
        Depth in the tactile frame where the point should be seen and where it is; nan for none.
    """
    height, width = counts.shape
    tactile_height, tactile_width = tactile.shape
    u_end = np.float32(tactile_width) - _HALF
    v_end = np.float32(tactile_height) - _HALF
    for v in prange(height):
        for u in range(width):
            expected[v, u] = _NAN
            measured[v, u] = _NAN
            if v < region[1] or v >= region[3] or u < region[0] or u >= region[2]:
                continue
            count = counts[v, u]
            if count == 0 or count == 65535:
                continue
            depth = np.float32(count) * unit
            z = directions[v, u, 2] * depth + translation[2]
            if not z > 0:
                continue
            expected[v, u] = z
            x = directions[v, u, 0] * depth + translation[0]
            y = directions[v, u, 1] * depth + translation[1]
            tu, tv = _project(x, y, z, lens, camera)
            if not (tu >= -_HALF and tu < u_end and tv >= -_HALF and tv < v_end):
                continue
            seen = tactile[math.floor(tv + _HALF), math.floor(tu + _HALF)]
            if seen != 0 and seen != 65535:
                measured[v, u] = np.float32(seen) * factor + offset


@njit(cache=True, nogil=True, parallel=True)
def align_table(
    counts: Any, unit: Any, table: Any, tactile: Any, factor: Any, offset: Any, region: Any,
    expected: Any, measured: Any
) -> None:  # fmt: skip
    """Look the tactile depth up through a fixed table of flat tactile pixel numbers (-1: none)."""
    height, width = counts.shape
    flat = tactile.ravel()
    for v in prange(height):
        for u in range(width):
            expected[v, u] = _NAN
            measured[v, u] = _NAN
            if v < region[1] or v >= region[3] or u < region[0] or u >= region[2]:
                continue
            count = counts[v, u]
            if count == 0 or count == 65535:
                continue
            expected[v, u] = np.float32(count) * unit
            if table[v, u] < 0:
                continue
            seen = flat[table[v, u]]
            if seen != 0 and seen != 65535:
                measured[v, u] = np.float32(seen) * factor + offset


@njit(cache=True, nogil=True, parallel=True)
def classify(
    counts: Any, unit: Any, expected: Any, measured: Any, tolerance: Any, near: Any, far: Any, region: Any,
    provenance: Any
) -> None:  # fmt: skip
    """Write the verdict of depth, region, range and tolerance on every pixel; candidates get CONTACT."""
    height, width = counts.shape
    for v in prange(height):
        for u in range(width):
            count = counts[v, u]
            depth = np.float32(count) * unit
            dp = expected[v, u]
            dt = measured[v, u]
            if count == 0 or count == 65535:
                provenance[v, u] = _NO_PROXIMITY_DEPTH
            elif v < region[1] or v >= region[3] or u < region[0] or u >= region[2]:
                provenance[v, u] = _OUTSIDE_REGION
            elif depth < near or depth > far:
                provenance[v, u] = _OUTSIDE_RANGE
            elif not (dt == dt and dp == dp):
                provenance[v, u] = _NO_TACTILE_DEPTH
            elif abs(dp - dt) <= tolerance * abs(dp):
                provenance[v, u] = _CANDIDATE
            else:
                provenance[v, u] = _OUTSIDE_TOLERANCE


@njit(cache=True, nogil=True)
def color_lookup(
    points: Any, rotation: Any, translation: Any, lens: Any, camera: Any, image: Any, colors: Any, seen: Any
) -> None:
    """Write the colour at which a colour camera sees each point; ``seen`` is False outside its image."""
    height, width = image.shape[:2]
    u_end = np.float32(width) - _HALF
    v_end = np.float32(height) - _HALF
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz + translation[0]
        y = rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz + translation[1]
        z = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz + translation[2]
        seen[i] = False
        if not z > 0:
            continue
        u, v = _project(x, y, z, lens, camera)
        if u >= -_HALF and u < u_end and v >= -_HALF and v < v_end:
            row, column = math.floor(v + _HALF), math.floor(u + _HALF)
            colors[i, 0] = image[row, column, 0]
            colors[i, 1] = image[row, column, 1]
            colors[i, 2] = image[row, column, 2]
            seen[i] = True
