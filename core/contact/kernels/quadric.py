"""Local quadratic fits: the normal equations of every cell, solved."""

from __future__ import annotations

from typing import Any

import numpy as np

from .compiling import kernel


@kernel
def solve_quadrics(moments: Any, right: Any, usable: Any, work: Any, out: Any, growth: Any) -> None:
    """Solve M c = b at each usable cell by Cholesky's method; write c and the growth of the curvature's variance.

    ``moments`` (6, 6, H, W) are the windows' weighted moments of 1, x, y, xx, xy, yy; ``right`` (6, H, W) those of the
    depth. ``out`` (6, H, W) receives nan elsewhere; ``growth`` (H, W) the sum of the last diagonal elements of the
    inverse that belong to xx and yy; ``work`` is (7, 6).
    """
    for v in range(usable.shape[0]):
        for u in range(usable.shape[1]):
            good = usable[v, u]
            if good:
                for i in range(6):
                    for j in range(i + 1):
                        total = moments[i, j, v, u]
                        for k in range(j):
                            total -= work[i, k] * work[j, k]
                        if i == j:
                            if total <= 1e-9 * moments[i, i, v, u]:
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
