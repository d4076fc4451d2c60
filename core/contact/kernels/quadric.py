"""Local quadratic fits: the normal equations of every cell, solved."""

from __future__ import annotations

from typing import Any

import numpy as np

from .compiling import kernel


@kernel
def solve_quadrics(moments: Any, places: Any, right: Any, usable: Any, work: Any, out: Any, growth: Any) -> None:
    """Solve M c = b at each usable cell by Cholesky's method; write c and the growth of the curvature's variance.

    ``moments`` (15, H, W) are the windows' weighted moments, and ``places`` (6, 6) tells which of them each product of
    two of 1, x, y, xx, xy and yy has; ``right`` (6, H, W) are those of the depth. ``out`` (6, H, W) receives nan
    elsewhere; ``growth`` (H, W) the sum of the last diagonal elements of the inverse that belong to xx and yy; ``work``
    is (7, 6).
    """
    for v in range(usable.shape[0]):
        for u in range(usable.shape[1]):
            good = usable[v, u]
            if good:
                for i in range(6):
                    for j in range(i + 1):
                        total = moments[places[i, j], v, u]
                        for k in range(j):
                            total -= work[i, k] * work[j, k]
                        if i == j:
                            if total <= 1e-9 * moments[places[i, i], v, u]:
                                good = False
                                total = 1.0
                            work[i, i] = np.sqrt(total)
                        else:
                            work[i, j] = total / work[j, j]
            if not good:
                for i in range(6):
                    out[i, v, u] = np.nan
                growth[v, u] = np.nan
                continue
            variance = 0.0
            for column in range(3):  # the depth, and the unit vectors of xx and yy
                for i in range(6):
                    total = right[i, v, u] if column == 0 else 1.0 if i == 1 + 2 * column else 0.0
                    for k in range(i):
                        total -= work[i, k] * work[6, k]
                    work[6, i] = total / work[i, i]
                for i in range(5, -1, -1):
                    total = work[6, i]
                    for k in range(i + 1, 6):
                        total -= work[k, i] * work[6, k]
                    work[6, i] = total / work[i, i]
                if column == 0:
                    for i in range(6):
                        out[i, v, u] = work[6, i]
                else:
                    variance += work[6, 1 + 2 * column]
            growth[v, u] = variance


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
