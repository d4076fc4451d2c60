"""The membrane before it is inflated: size, material and triangles.

Lengths are metres in the membrane's frame: origin in the centre of the rim's plane, x along the
long side, z outward, away from the cameras.
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
    """Size, material and air of the membrane.

    Attributes
    ----------
    width_m, height_m : float
        Free size of the rubber between the clamps.
    apex_m : float
        Height of the inflated, untouched membrane above the rim's plane.
    dead_volume_m3 : float
        Air in the housing below the rim's plane.
    stiffness_n_m : float
        Shear modulus times thickness.
    stiffening : float
        Strain stiffening of the rubber: c in W = mu/2 (I + c I^2), I = tr C - 3.
    fold_m : float
        Height of the folds of a twisted membrane, crest over mean; 0 for a smooth one, see `folds`.
    prestretch : float
        How far the sheet was stretched, in both directions, when it was clamped.
    stiffness_slope : float
        Difference of the stiffness between the right and the left edge, as a share of `stiffness_n_m`.
    centre_stiffness : float
        Factor on the stiffness in the centre, such as below 1 for rubber that was cast thinner there.
    sticks : bool
        Whether the rubber sticks to the object: a node that touches keeps its place on the object until it comes off.
        Otherwise it slides without friction.
    cells : tuple of int
        Quads along width and height; both even keep the mesh mirror-symmetric.
    """

    width_m: float = 0.355
    height_m: float = 0.205
    apex_m: float = 0.060
    dead_volume_m3: float = 0.0090
    stiffness_n_m: float = 220.0
    stiffening: float = 0.05
    fold_m: float = 0.0
    prestretch: float = 1.04
    stiffness_slope: float = 0.0
    centre_stiffness: float = 1.0
    sticks: bool = False
    cells: tuple[int, int] = (118, 68)


@dataclass(frozen=True)
class Mesh:
    """The sheet as triangles.

    Attributes
    ----------
    flat : float64, shape (N, 3)
        Clamped, not inflated: node positions in the rim's plane.
    triangles : int32, shape (T, 3)
        Node numbers; the normals of the inflated sheet point outward.
    inverse : float64, shape (T, 2, 2)
        Inverse of the unstretched edge matrix.
    area : float64, shape (T,)
        Unstretched areas, square metres.
    stiffness : float64, shape (T,)
        Shear modulus times thickness times unstretched area, N m.
    relief_m : float64, shape (N,)
        Height of the outer surface over the mean surface, along z: the folds.
    free : bool, shape (N,)
        False on the rim.
    """

    flat: Float64Array
    triangles: Int32Array
    inverse: Float64Array
    area: Float64Array
    stiffness: Float64Array
    relief_m: Float64Array
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
    return Mesh(flat, triangles, inverse, area, stiffness, folds(flat, design.fold_m) * free, free)


def folds(flat: Float64Array, height_m: float) -> Float64Array:
    """Return the height of the folds of a sheet that is twisted about its centre.

    Shear leaves tension along the diagonals only, so the folds run out from the turned part as
    spirals that cross every circle at 45 degrees. They are widest apart, and highest, a little
    outside of it.

    Parameters
    ----------
    flat : float64, shape (N, 3)
        Places on the flat sheet, metres.
    height_m : float
        Crest over mean at the highest.

    Returns
    -------
    float64, shape (N,)
        Metres.
    """
    radius, angle = np.hypot(flat[:, 0], flat[:, 1]), np.arctan2(flat[:, 1], flat[:, 0])
    near = np.maximum(radius, _FOLD_INNER_M) / _FOLD_INNER_M
    envelope = np.clip((radius - _FOLD_INNER_M / 2) / _FOLD_INNER_M, 0.0, 1.0) * np.exp(
        -(((radius - 2 * _FOLD_INNER_M) / (2 * _FOLD_INNER_M)) ** 2)
    )
    return np.asarray(height_m * envelope * np.cos(_FOLDS * (angle + np.log(near))), dtype=np.float64)
