"""The compiled loops of the software painter.

Every pixel of the picture is one 64-bit number: the bits of its distance above its colour. Distances
are positive, so their bits sort like numbers, and *the nearest point wins* is a single minimum. A point
is drawn as one such pixel first; a moving minimum over the whole picture then makes squares of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, types

_FAR = np.int64(0x7F800000) << np.int64(32)
_COLOR = np.int64(0xFFFFFFFF)


def _read_only(dtype: types.Type, dimensions: int) -> types.Array:
    return types.Array(dtype, dimensions, "C", readonly=True)


# Compiled when imported, for these signatures only, so that no repaint ever waits for the compiler.
_SCATTER: Any = types.void(
    _read_only(types.uint16, 2),
    _read_only(types.float32, 3),
    _read_only(types.uint8, 2),
    _read_only(types.int64, 1),
    _read_only(types.float32, 2),
    _read_only(types.float32, 1),
    types.float32,
    types.int64,
    types.Array(types.int64, 2, "C"),
)
_CLEAR: Any = types.void(types.Array(types.int64, 2, "C"), types.int64)
_SQUARES: Any = types.void(_read_only(types.int64, 2), types.int64, types.Array(types.uint32, 2, "C"))


@njit(_CLEAR, nogil=True, cache=True)
def clear(pixels: Any, background: Any) -> None:
    """Fill ``pixels``, int64, with an ARGB background at an infinite distance."""
    pixels[:] = _FAR | background


@njit(_SCATTER, nogil=True, cache=True, error_model="numpy")
def scatter(
    depth: Any, rays: Any, index: Any, colors: Any, matrix: Any, depths: Any, near: Any, size: Any, pixels: Any
) -> None:  # fmt: skip
    """Put every point into ``pixels``, at the lower right pixel of its square.

    Parameters
    ----------
    depth, rays, index
        As in `DepthCloud`; an empty ``index`` means that depth chooses the colour.
    colors : int64, shape (256,)
        ARGB; 0 hides.
    matrix : float32, shape (3, 4)
        From the camera to ``(u w, v w, w)``.
    depths : float32, shape (4,)
        Metres per count, offset; slope and intercept of the colour scale.
    near : float32
        Smallest distance drawn, metres.
    size : int
        Edge length of the squares.
    pixels : int64, shape (height + 2 size, width + 2 size)
        Cleared to the background; a margin of ``size`` on every side saves asking for the edges.
    """
    metres_per_count, offset, slope, intercept = depths
    m00, m01, m02, m03 = matrix[0]
    m10, m11, m12, m13 = matrix[1]
    m20, m21, m22, m23 = matrix[2]
    stride = np.int32(pixels.shape[1])
    width, height = np.float32(pixels.shape[1] - 2 * size), np.float32(pixels.shape[0] - 2 * size)
    # A square covers the pixels whose centres lie inside it, as OpenGL's points do.
    last = np.float32(size) + np.float32(0.5) * np.float32(size) - np.float32(0.5)
    flat = pixels.reshape(-1)
    rows, columns = depth.shape
    place = np.empty(columns, np.int32)
    distance = np.empty(columns, np.float32)
    shade = np.empty(columns, np.int32)
    indexed = index.shape[0] > 0
    zero, one = np.float32(0), np.float32(1)
    for row in range(rows):
        # First the arithmetic of a whole row without branches, which the compiler vectorises …
        for column in range(columns):
            counts = np.float32(depth[row, column])
            z = counts * metres_per_count + offset
            x, y = rays[row, column, 0], rays[row, column, 1]
            w = z * (m20 * x + m21 * y + m22) + m23
            inverse = one / w
            u = (z * (m00 * x + m01 * y + m02) + m03) * inverse
            v = (z * (m10 * x + m11 * y + m12) + m13) * inverse
            has_depth = (counts > zero) & (counts < np.float32(65535)) & (z > zero)
            inside = (w >= near) & (u >= zero) & (u < width) & (v >= zero) & (v < height)
            shown = has_depth & inside
            j = np.int32(u + last) if shown else np.int32(0)
            i = np.int32(v + last) if shown else np.int32(0)
            place[column] = i * stride + j if shown else np.int32(-1)
            distance[column] = w
            share = min(max(z * slope + intercept, zero), one)
            shade[column] = np.int32(share * np.float32(255) + np.float32(0.5))
        # … then the writes, which depend on each other.
        for column in range(columns):
            where = place[column]
            if where < 0:
                continue
            color = colors[index[row, column] if indexed else shade[column]]
            if color == 0:
                continue
            bits = np.int64(distance[column : column + 1].view(np.int32)[0])
            flat[where] = min(flat[where], bits << np.int64(32) | color)


@njit(_SQUARES, nogil=True, cache=True)
def squares(pixels: Any, size: Any, image: Any) -> None:
    """Widen the points to squares, write their colours into ``image``.

    Parameters
    ----------
    pixels : int64, shape (height + 2 size, width + 2 size)
    image : uint32, shape (height, width)
        ARGB.
    """
    height, width = image.shape
    nearest = np.empty(pixels.shape[1], np.int64)
    widened = np.empty(width, np.int64)
    for i in range(height):
        nearest[:] = pixels[i + size]
        for below in range(1, size):
            for j in range(nearest.shape[0]):
                nearest[j] = min(nearest[j], pixels[i + size + below, j])
        for j in range(width):
            widened[j] = nearest[j + size]
        for beside in range(1, size):
            for j in range(width):
                widened[j] = min(widened[j], nearest[j + size + beside])
        for j in range(width):
            image[i, j] = np.uint32(widened[j] & _COLOR)
