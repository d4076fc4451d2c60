"""The membrane before it is inflated: size, material and triangles.

Lengths are metres in the membrane's frame: origin in the centre of the rim's plane, x along the long side, z outward,
away from the cameras.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from ...model.arrays import BoolArray, Float64Array, Int32Array

#: Number of folds round the turned part of a twisted membrane, and its radius, metres.
_FOLDS: Final = 18
_FOLD_INNER_M: Final = 0.018


@dataclass(frozen=True)
class MembraneDesign:
    """Size, material and air of the membrane."""

    #: Free size of the rubber between the clamps, and height of the untouched membrane over the rim's plane.
    width_m: float = 0.355
    height_m: float = 0.205
    apex_m: float = 0.060
    #: Air in the housing below the rim's plane.
    dead_volume_m3: float = 0.0090
    #: Shear modulus times thickness, and c in W = mu/2 (I + c I^2), I = tr C - 3.
    stiffness_n_m: float = 220.0
    stiffening: float = 0.05
    #: Height of the folds of a twisted membrane, crest over mean, see `_folds`.
    fold_m: float = 0.0
    #: How far the sheet was stretched, in both directions, when it was clamped.
    prestretch: float = 1.04
    #: Difference of the stiffness between the right and the left edge, relative; factor on it in the centre.
    stiffness_slope: float = 0.0
    centre_stiffness: float = 1.0
    #: A node that touches keeps its place on the object until it comes off, instead of sliding without friction.
    sticks: bool = False
    #: Quads along width and height; both even keep the mesh mirror-symmetric.
    cells: tuple[int, int] = (118, 68)


@dataclass(frozen=True)
class Mesh:
    """The sheet as N nodes and T triangles."""

    #: (N, 3): clamped, not inflated.
    flat: Float64Array
    #: (T, 3): node numbers; the normals of the inflated sheet point outward.
    triangles: Int32Array
    #: (T, 2, 2): inverse of the unstretched edge matrix.
    inverse: Float64Array
    #: (T,): unstretched areas, square metres; shear modulus times thickness times area, N m.
    area: Float64Array
    stiffness: Float64Array
    #: (N,): height of the outer surface over the mean surface along z, the folds.
    relief_m: Float64Array
    #: (N,): False on the rim.
    free: BoolArray


def build_mesh(design: MembraneDesign) -> Mesh:
    """Divide the sheet into quads, and these by alternating diagonals into triangles."""
    nx, ny = design.cells
    xs = np.linspace(-design.width_m / 2, design.width_m / 2, nx + 1)
    ys = np.linspace(-design.height_m / 2, design.height_m / 2, ny + 1)
    grid_x, grid_y = np.meshgrid(xs, ys)
    flat = np.stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)], axis=1)

    j, i = np.mgrid[:ny, :nx]
    a = (j * (nx + 1) + i).ravel()
    b, c, d = a + 1, a + nx + 2, a + nx + 1
    rising = ((i + j) % 2 == 0).ravel()[:, None]
    first = np.where(rising, np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    second = np.where(rising, np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    triangles = np.stack([first, second], 1).reshape(-1, 3).astype(np.int32)

    unstretched = flat[:, :2] / design.prestretch
    corners = unstretched[triangles]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    free = (np.abs(flat[:, 0]) < design.width_m / 2 - 1e-9) & (np.abs(flat[:, 1]) < design.height_m / 2 - 1e-9)
    inverse = np.asarray(np.linalg.inv(edges), dtype=np.float64)
    area = np.asarray(np.linalg.det(edges) / 2, dtype=np.float64)
    stiffness = design.stiffness_n_m * area
    middle = flat[triangles, :2].mean(axis=1)
    if design.stiffness_slope or design.centre_stiffness != 1.0:
        centred = np.exp(-((np.hypot(middle[:, 0], middle[:, 1]) / (design.height_m / 3)) ** 2))
        stiffness *= 1.0 + design.stiffness_slope * middle[:, 0] / design.width_m
        stiffness *= 1.0 + (design.centre_stiffness - 1.0) * centred
    return Mesh(flat, triangles, inverse, area, stiffness, _folds(flat, design.fold_m) * free, free)


def _folds(flat: Float64Array, height_m: float) -> Float64Array:
    """Return the height of the folds at nodes of a sheet that is twisted about its centre, (N,).

    Shear leaves tension along the diagonals only, so the folds run out from the turned part as spirals that cross every
    circle at 45 degrees. They are widest apart, and highest, a little outside of it.
    """
    radius, angle = np.hypot(flat[:, 0], flat[:, 1]), np.arctan2(flat[:, 1], flat[:, 0])
    near = np.maximum(radius, _FOLD_INNER_M) / _FOLD_INNER_M
    envelope = np.clip((radius - _FOLD_INNER_M / 2) / _FOLD_INNER_M, 0.0, 1.0) * np.exp(
        -(((radius - 2 * _FOLD_INNER_M) / (2 * _FOLD_INNER_M)) ** 2)
    )
    return np.asarray(height_m * envelope * np.cos(_FOLDS * (angle + np.log(near))), dtype=np.float64)
