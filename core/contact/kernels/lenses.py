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


def _projection(value: Any) -> Any:
    """Return the projection (x, y, z, lens, parameters) to pixels; ``value`` makes its operands of float32 numbers."""

    @inline
    def projected(x: Any, y: Any, z: Any, lens: Any, c: Any) -> Any:
        x = x / z
        y = y / z
        if lens != PINHOLE:
            r2 = x * x + y * y
            radial = value(_ONE) + ((value(c[8]) * r2 + value(c[5])) * r2 + value(c[4])) * r2
            if lens == INVERSE:
                x = x * radial
                y = y * radial
            dx = value(_TWO * c[6]) * x * y + value(c[7]) * (r2 + value(_TWO) * x * x)
            dy = value(_TWO * c[7]) * x * y + value(c[6]) * (r2 + value(_TWO) * y * y)
            if lens == BROWN:
                x = x * radial
                y = y * radial
            x = x + dx
            y = y + dy
        return x * value(c[0]) + value(c[2]), y * value(c[1]) + value(c[3])

    return projected


@inline
def _number(number: Any) -> Any:
    return number


#: Of one point (float32), as `Intrinsics.project` does in float64; and of vectors of points, with the same operations.
project, project_lanes = _projection(_number), _projection(floats)
