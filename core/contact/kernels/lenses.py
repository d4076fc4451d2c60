"""Projection by the lens models, for kernels: float32, with one fixed order of operations."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.arrays import Float32Array
from ...model.intrinsics import Distortion, Intrinsics
from .compiling import inline
from .simd import floats

PINHOLE, BROWN, INVERSE = 0, 1, 2

_ONE = np.float32(1.0)
_TWO = np.float32(2.0)


def lens_parameters(intrinsics: Intrinsics) -> tuple[int, Float32Array]:
    """Return the number of the lens model and ``fx fy cx cy k1 k2 p1 p2 k3`` (float32), as kernels take them."""
    if not intrinsics.has_distortion:
        lens = PINHOLE
    elif intrinsics.distortion is Distortion.BROWN_CONRADY:
        lens = BROWN
    else:
        lens = INVERSE
    values = (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy, *intrinsics.coefficients)
    return lens, np.array(values, dtype=np.float32)


@inline
def project(x: Any, y: Any, z: Any, lens: Any, c: Any) -> Any:
    """Project one point (float32) to pixel coordinates, as `Intrinsics.project` does in float64."""
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


@inline
def project_lanes(x: Any, y: Any, z: Any, lens: Any, c: Any) -> Any:
    """Project vectors of points, with the same operations as `project`."""
    x = x / z
    y = y / z
    if lens != PINHOLE:
        r2 = x * x + y * y
        radial = floats(_ONE) + ((floats(c[8]) * r2 + floats(c[5])) * r2 + floats(c[4])) * r2
        if lens == INVERSE:
            x = x * radial
            y = y * radial
        dx = floats(_TWO * c[6]) * x * y + floats(c[7]) * (r2 + floats(_TWO) * x * x)
        dy = floats(_TWO * c[7]) * x * y + floats(c[6]) * (r2 + floats(_TWO) * y * y)
        if lens == BROWN:
            x = x * radial
            y = y * radial
        x = x + dx
        y = y + dy
    return x * floats(c[0]) + floats(c[2]), y * floats(c[1]) + floats(c[3])
