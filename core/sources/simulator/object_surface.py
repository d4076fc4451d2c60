"""The surface of a simulated object as a mesh."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from .objects import compiled, distance, normal

#: Half side of a cube around the origin that contains every object, metres.
_HALF_M: Final = 0.084
_IDENTITY: Final = np.eye(4)[:3].copy()


def object_surface(kind: int, spacing_m: float) -> tuple[Float64Array, Int64Array]:
    """Return the surface of an object, in its own frame, as quads of about equal size.

    Surface nets (Gibson 1998): each voxel that the surface crosses gets a vertex at the mean of the crossed edges, and
    each crossed edge gets a quad. The vertices are then moved onto the surface.
    """
    count = 2 * math.ceil(_HALF_M / spacing_m) + 2
    axis = np.asarray((np.arange(count) - (count - 1) / 2) * spacing_m, np.float64)
    values = np.empty((count, count, count), np.float32)
    _fill(kind, _IDENTITY, axis, values)
    number = _voxel_numbers(values < 0)
    sums, crossings, quads = np.zeros((number.max() + 1, 3)), np.zeros(number.max() + 1), []
    for along in range(3):
        step, beside, before = np.roll(np.eye(3, dtype=np.int64), -along, axis=0)
        start = _crossed_edges(values, along)
        near, far = values[tuple(start.T)], values[tuple((start + step).T)]
        places = axis[start] + (near / (near - far))[:, None] * step * spacing_m
        around = np.stack([number[tuple((start - back).T)] for back in (beside + before, before, 0 * step, beside)], 1)
        np.add.at(sums, around, places[:, None])
        np.add.at(crossings, around, 1)
        quads.append(np.where((near < 0)[:, None], around, around[:, ::-1]))
    vertices = sums / crossings[:, None]
    to_surface(kind, vertices)
    return vertices, np.concatenate(quads)


def _voxel_numbers(inside: BoolArray) -> Int64Array:
    """Number the voxels with corners on both sides of the surface; -1 for all others."""
    side = len(inside) - 1
    within = np.zeros((side, side, side), np.int8)
    for i, j, k in np.ndindex(2, 2, 2):
        within += inside[i : i + side, j : j + side, k : k + side]
    passed = (within > 0) & (within < 8)
    number = np.full(passed.shape, -1, np.int64)
    number[passed] = np.arange(np.count_nonzero(passed))
    return number


def _crossed_edges(values: Float32Array, along: int) -> Int64Array:
    """Return the start indices, (N, 3), of the grid edges along one axis that the surface crosses."""
    ahead = np.moveaxis(values < 0, along, 0)
    crossed = np.moveaxis(ahead[:-1] != ahead[1:], 0, along)
    return np.argwhere(crossed)


def to_surface(kind: int, points: Float64Array) -> Float64Array:
    """Move points near an object's surface onto it, in place; return the outward unit normals there, (N, 3)."""
    normals = np.empty_like(points)
    _settle(kind, _IDENTITY, points, normals)
    return normals


@compiled
def _fill(kind: int, pose: Float64Array, axis: Float64Array, values: Float32Array) -> None:
    for i in range(len(axis)):
        for j in range(len(axis)):
            for k in range(len(axis)):
                values[i, j, k] = distance(kind, pose, axis[i], axis[j], axis[k])


@compiled
def _settle(kind: int, pose: Float64Array, points: Float64Array, normals: Float64Array) -> None:
    for n in range(len(points)):
        for _ in range(12):
            x, y, z = points[n, 0], points[n, 1], points[n, 2]
            gap = distance(kind, pose, x, y, z)
            nx, ny, nz = normal(kind, pose, x, y, z)
            normals[n, 0], normals[n, 1], normals[n, 2] = nx, ny, nz
            if abs(gap) < 1e-9:
                break
            points[n, 0], points[n, 1], points[n, 2] = x - gap * nx, y - gap * ny, z - gap * nz
