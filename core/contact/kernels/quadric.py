"""Local quadratic fits on cells of pixels: means of cells, normal equations, curvature, balance of forces."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import numpy as np

from .compiling import kernel

#: Side of a cell, pixels.
CELL_PX: Final = 8
#: Powers of x and y of the coefficients.
POWERS: Final = np.array(((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)))
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
#: A window determines no fit where a diagonal element keeps less than this share of itself in the elimination.
_SINGULAR: Final = np.float32(1e-6)
# a check for division by zero keeps loops from working on several cells
_fast_kernel = partial(kernel, error_model="numpy")


@_fast_kernel
def average_cells(counts: Any, top: Any, left: Any, step: Any, sums: Any, means: Any, shares: Any) -> None:
    """Write the mean of the valid counts (uint16) of each cell, (H, W), and the share of its pixels that are valid.

    The cells begin at pixel (``top``, ``left``); of their rows every ``step``-th is read. ``sums`` (int32) is a buffer
    of two rows of pixels: whole rows are added up, which vectorises, and only then the pixels of a cell.
    """
    for row in range(means.shape[0]):
        sums[:] = 0
        for v in range(top + row * CELL_PX, top + (row + 1) * CELL_PX, step):
            line = counts[v, left : left + sums.shape[1]]
            for u in range(sums.shape[1]):
                count = np.int32(line[u])
                has_depth = (count > 0) & (count < 65535)
                sums[0, u] += count if has_depth else np.int32(0)
                sums[1, u] += np.int32(has_depth)
        for column in range(means.shape[1]):
            total, known = np.int32(0), np.int32(0)
            for u in range(column * CELL_PX, (column + 1) * CELL_PX):
                total += sums[0, u]
                known += sums[1, u]
            means[row, column] = total / max(known, np.int32(1))
            shares[row, column] = known * step / (CELL_PX * CELL_PX)


@_fast_kernel
def fit_quadrics(
    images: Any, window: Any, least: Any, across: Any, moments: Any, work: Any, out: Any, growth: Any
) -> None:
    """Fit a quadratic about each cell in a window; write coefficients and the growth of the curvature's variance.

    ``images`` (2, (H + 2 R) W) are the weight of each cell, and its depth times that, with a margin of R cells of no
    weight on all sides; ``window`` (5, 2 R + 1) is the window of one direction times powers of the way from its centre.
    ``out`` (6, H W) and ``growth`` (H W), the sum of the diagonal elements of the inverse that belong to xx and yy,
    receive nan where the weight in the window is not above ``least``; what they receive in the margin of the columns
    means nothing. ``across`` (8, (H + 2 R) W), ``moments`` (8, 5, N) and ``work`` (7, 6, N) are buffers: N cells are
    computed side by side. All but the results are float32. The normal equations are solved by Cholesky's method, with
    reciprocals on the diagonal.
    """
    reach, size, block = window.shape[1] // 2, images.shape[1], moments.shape[2]
    count = growth.shape[0]
    width = (size - count) // (2 * reach)
    for part in range(8):  # five powers of x for the weight, three for the depth
        power, image = (part, 0) if part < 5 else (part - 5, 1)
        across[part] = _ZERO
        for t in range(2 * reach + 1):
            source, target, weight = images[image, t:], across[part, reach:], window[power, t]
            for n in range(size - 2 * reach):
                target[n] += weight * source[n]
    for first in range(0, count, block):
        cells = range(min(block, count - first))
        for part in range(8):
            for power in range(5 - part if part < 5 else 8 - part):
                target = moments[part, power]
                target[:] = _ZERO
                for t in range(2 * reach + 1):
                    source, weight = across[part, first + t * width :], window[power, t]
                    for n in cells:
                        target[n] += weight * source[n]
        for n in cells:
            growth[first + n] = 0.0 if moments[0, 0, n] > least else np.nan
        for i in range(6):
            for j in range(i + 1):
                x, y = POWERS[i, 0] + POWERS[j, 0], POWERS[i, 1] + POWERS[j, 1]
                for n in cells:
                    work[i, j, n] = moments[x, y, n]
                for k in range(j):
                    for n in cells:
                        work[i, j, n] -= work[i, k, n] * work[j, k, n]
                if i == j:
                    for n in cells:
                        good = work[i, i, n] > _SINGULAR * moments[x, y, n]
                        growth[first + n] = growth[first + n] if good else np.nan
                        work[i, i, n] = _ONE / np.sqrt(work[i, i, n] if good else _ONE)
                else:
                    for n in cells:
                        work[i, j, n] *= work[j, j, n]
        for n in cells:  # the columns of xx and yy of the inverse of the Cholesky factor
            xx, yy = work[3, 3, n], work[5, 5, n]
            xy = -work[4, 3, n] * xx * work[4, 4, n]
            low = -(work[5, 3, n] * xx + work[5, 4, n] * xy) * yy
            growth[first + n] += xx * xx + xy * xy + low * low + yy * yy
        for i in range(6):
            for n in cells:
                work[6, i, n] = moments[5 + POWERS[i, 0], POWERS[i, 1], n]
            for k in range(i):
                for n in cells:
                    work[6, i, n] -= work[i, k, n] * work[6, k, n]
            for n in cells:
                work[6, i, n] *= work[i, i, n]
        for i in range(5, -1, -1):
            for k in range(i + 1, 6):
                for n in cells:
                    work[6, i, n] -= work[k, i, n] * work[6, k, n]
            for n in cells:
                work[6, i, n] *= work[i, i, n]
            for n in cells:
                out[i, first + n] = np.nan if np.isnan(growth[first + n]) else work[6, i, n]


@_fast_kernel
def bend_quadrics(fits: Any, x: Any, y: Any, du: Any, dv: Any, twice_mean: Any, largest: Any, noise: Any) -> None:
    """Write twice the mean and the larger principal curvature, (H, W), of surfaces of depth z on the rays (x, y, 1).

    ``fits`` (6, H, W) are the coefficients of z for steps of one cell, whose sides are ``du`` and ``dv`` at z = 1.
    ``noise`` (H, W) receives the standard deviation of twice the mean curvature where stereo noise, which grows with
    z^2, passes a Gaussian window, against a surface across the ray.
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
            apart = mean * mean - (low * high - mid * mid) / square
            largest[row, column] = mean + np.sqrt(apart if apart > 0 else 0.0)
            # second derivatives xx, yy, xy of a fit in a Gaussian window have variances of 3, 3, 1; of xx and yy: 1
            spread = 3 * (e * e + g * g) + 2 * e * g + 4 * f * f
            across = (nx * rx + ny * ry + nz) / area
            noise[row, column] = z * z * across * np.sqrt(spread / 8) / square


@_fast_kernel
def add_triangles(points: Any, weight: Any, load: Any, out: Any) -> None:
    """Add to ``out``, (3, 3), what `pressure.surface.balance` returns, over two triangles of each four cells.

    ``points`` (H, W, 3) are nan where unknown; ``weight`` and ``load``, that times the pressure, are (H, W).
    """
    for v in range(weight.shape[0] - 1):
        for u in range(weight.shape[1] - 1):
            for half in range(2):
                bv, bu, cv, cu = v + half, u + 1, v + 1, u + 1 - half
                mean = (weight[v, u] + weight[bv, bu] + weight[cv, cu]) / 3
                if not mean > 0:
                    continue
                ax, ay, az = points[v, u]
                bx, by, bz = points[bv, bu]
                cx, cy, cz = points[cv, cu]
                x1, y1, z1, x2, y2, z2 = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
                nx, ny, nz = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
                length = np.sqrt(nx * nx + ny * ny + nz * nz)
                if not np.isfinite(length):
                    continue
                wb, wc = weight[bv, bu] - weight[v, u], weight[cv, cu] - weight[v, u]
                # sum of each weight times the side opposite to it
                px, py, pz = wc * x1 - wb * x2, wc * y1 - wb * y2, wc * z1 - wb * z2
                loaded = (load[v, u] + load[bv, bu] + load[cv, cu]) / 3
                for row, nth in ((0, mean), (2, loaded)):
                    out[row, 0] += nth * nx / 2
                    out[row, 1] += nth * ny / 2
                    out[row, 2] += nth * nz / 2
                out[1, 0] += (ny * pz - nz * py) / length / 2
                out[1, 1] += (nz * px - nx * pz) / length / 2
                out[1, 2] += (nx * py - ny * px) / length / 2
