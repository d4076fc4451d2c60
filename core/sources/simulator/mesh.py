"""The membrane before it is inflated: size, material and triangles.

Lengths are metres in the membrane's frame: origin in the middle of the rim's plane, x along the
long side, z outward, away from the cameras.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]


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
    prestretch : float
        How far the sheet was stretched, in both directions, when it was clamped.
    cells : tuple of int
        Quads along width and height; both even keep the mesh mirror-symmetric.
    """

    width_m: float = 0.355
    height_m: float = 0.205
    apex_m: float = 0.060
    dead_volume_m3: float = 0.0090
    stiffness_n_m: float = 220.0
    prestretch: float = 1.04
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
    free : bool, shape (N,)
        False on the rim.
    """

    flat: Float64Array
    triangles: Int32Array
    inverse: Float64Array
    area: Float64Array
    free: npt.NDArray[np.bool_]


def build_mesh(design: MembraneDesign) -> Mesh:
    """Cut the sheet into quads of alternating diagonals and these into triangles."""
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
    return Mesh(flat, triangles, inverse, np.linalg.det(edges) / 2, free)
