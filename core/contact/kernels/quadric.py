"""Local quadratic fits: the normal equations of every cell, solved."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from .compiling import kernel


@partial(kernel, error_model="numpy")  # a check for division by zero keeps loops from working on several cells
def solve_quadrics(moments: Any, places: Any, right: Any, usable: Any, work: Any, out: Any, growth: Any) -> None:
    """Solve M c = b at each usable cell by Cholesky's method; write c and the growth of the curvature's variance.

    ``moments`` (15, H, W) are the windows' weighted moments, and ``places`` (6, 6) tells which of them each product of
    two of 1, x, y, xx, xy and yy has; ``right`` (6, H, W) are those of the depth. ``out`` (6, H, W) receives nan
    elsewhere; ``growth`` (H, W) the sum of the last diagonal elements of the inverse that belong to xx and yy; ``work``
    is (7, 6, W): the cells of a row are computed side by side.
    """
    cells = range(usable.shape[1])
    for v in range(usable.shape[0]):
        for u in cells:
            growth[v, u] = 0.0 if usable[v, u] else np.nan
        for i in range(6):
            for j in range(i + 1):
                for u in cells:
                    work[i, j, u] = moments[places[i, j], v, u]
                for k in range(j):
                    for u in cells:
                        work[i, j, u] -= work[i, k, u] * work[j, k, u]
                if i == j:
                    for u in cells:
                        good = work[i, i, u] > 1e-9 * moments[places[i, i], v, u]
                        growth[v, u] = growth[v, u] if good else np.nan
                        work[i, i, u] = np.sqrt(work[i, i, u] if good else 1.0)
                else:
                    for u in cells:
                        work[i, j, u] /= work[j, j, u]
        for column in range(3):  # the depth, and the unit vectors of xx and yy
            for i in range(6):
                for u in cells:
                    work[6, i, u] = right[i, v, u] if column == 0 else 1.0 if i == 1 + 2 * column else 0.0
                for k in range(i):
                    for u in cells:
                        work[6, i, u] -= work[i, k, u] * work[6, k, u]
                for u in cells:
                    work[6, i, u] /= work[i, i, u]
            for i in range(5, -1, -1):
                for k in range(i + 1, 6):
                    for u in cells:
                        work[6, i, u] -= work[k, i, u] * work[6, k, u]
                for u in cells:
                    work[6, i, u] /= work[i, i, u]
            if column == 0:
                for i in range(6):
                    for u in cells:
                        out[i, v, u] = work[6, i, u] if growth[v, u] == 0.0 else np.nan
            else:
                for u in cells:
                    growth[v, u] += work[6, 1 + 2 * column, u]


@kernel
def bend_quadrics(fits: Any, x: Any, y: Any, du: Any, dv: Any, twice_mean: Any, largest: Any) -> None:
    """Write twice the mean and the larger principal curvature, (H, W), of surfaces of depth z on the rays (x, y, 1).

    ``fits`` (6, H, W) are the coefficients of z for steps of one cell, whose sides are ``du`` and ``dv`` at z = 1.
    """
    for row in range(x.shape[0]):
        for column in range(x.shape[1]):
            rx, ry, z = x[row, column], y[row, column], fits[0, row, column]
            zu, zv = fits[1, row, column] / du, fits[2, row, column] / dv
            zuu, zuv = 2 * fits[3, row, column] / (du * du), fits[4, row, column] / (du * dv)
            zvv = 2 * fits[5, row, column] / (dv * dv)
            ux, uy, vx, vy = z + rx * zu, ry * zu, rx * zv, z + ry * zv  # the tangents' z are zu and zv
            nx, ny, nz = uy * zv - zu * vy, zu * vx - ux * zv, ux * vy - uy * vx
            area = np.sqrt(nx * nx + ny * ny + nz * nz)
            low = (nx * (2 * zu + rx * zuu) + ny * ry * zuu + nz * zuu) / area
            mid = (nx * (zv + rx * zuv) + ny * (zu + ry * zuv) + nz * zuv) / area
            high = (nx * rx * zvv + ny * (2 * zv + ry * zvv) + nz * zvv) / area
            e, f, g = ux * ux + uy * uy + zu * zu, ux * vx + uy * vy + zu * zv, vx * vx + vy * vy + zv * zv
            square = e * g - f * f
            mean = -(e * high - 2 * f * mid + g * low) / square / 2
            twice_mean[row, column] = 2 * mean
            largest[row, column] = mean + np.sqrt(max(mean * mean - (low * high - mid * mid) / square, 0.0))
