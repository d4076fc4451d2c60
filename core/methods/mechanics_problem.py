"""The mechanics of the membrane as a sparse convex quadratic program.

The untouched membrane is in balance: by Young and Laplace its tension T0 carries the gauge pressure
p0 with the mean curvature H, ``p0 = 2 H T0``, that is T0 = p0 R / 2 on a sphere of radius R. Moved by
u along its outward normals, with contact pressing inward with the pressure pc, it is in balance again
where, to first order,

    -T0 laplace(u) = dp - pc.

Linear triangles make of it ``T0 K u = A (dp - pc)`` with the cotangent stiffness K and the nodes'
areas A. The air is an ideal gas at constant temperature: with the absolute pressure P in the volume V,
``dp = -(P / V) A' u`` to first order. A ray meets the membrane ``u / c`` farther out, with c the cosine between
ray and normal, so that of the measured way d along the ray

    minimise    1/2 sum w (u / c - d)^2  +  1/2 r sum (a / a_mean) (pc / p0)^2
    subject to  T0 K u - A dp + A pc = 0,   dp + (P / V) A' u = 0,   pc >= 0

is the inverse problem, w being 1 at nodes that are seen. In units of millimetres and p0, in which the
numbers are near one, T0 is R / 2: but for the air's stiffness p0 drops out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..errors import TactuneError
from ..model.arrays import Float64Array, IndexArray
from .mechanics_mesh import MembraneMesh

ATMOSPHERE_PA = 101_325.0
_MM = 1e-3
#: Nodes seen under a smaller cosine tell nothing of their displacement.
_EDGE_ON = 0.3
_LARGEST_RADIUS_M = 10.0


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """Minimise ``x' P x / 2 + q' x`` subject to ``A x = 0`` and ``x[positive] >= 0``.

    ``x`` is the displacements of all nodes that move in millimetres, the rise of the air's pressure and
    the contact pressures of all nodes but the rim's, both in units of the untouched gauge pressure.

    Attributes
    ----------
    P : sparse, shape (n, n)
        Diagonal.
    q : float64, shape (n,)
    A : sparse, shape (m, n)
        One row for each node off the rim, and the gas law.
    positive : slice
        Where the contact pressures stand in x.
    """

    P: sparse.csc_matrix
    q: Float64Array
    A: sparse.csc_matrix
    positive: slice


class MembraneProblem:
    """Sets up the quadratic program of one frame after another.

    Parameters
    ----------
    mesh : MembraneMesh
        The untouched membrane.
    gauge_pressure_pa : float
        Of the untouched membrane over the atmosphere's.
    housing_m3 : float
        Volume of the air beneath the plane of the mesh's rim.
    regularisation : float
        r: what a contact pressure of p0 costs, in squared millimetres of misfit at one node.
    fixed_rim : bool
        Whether the rim stays where it is; it else follows the measurement, as is right where the outer
        rim was cropped.

    Raises
    ------
    TactuneError
        The membrane does not bulge.
    """

    def __init__(
        self,
        mesh: MembraneMesh,
        gauge_pressure_pa: float,
        housing_m3: float,
        regularisation: float,
        fixed_rim: bool,
    ) -> None:
        stiffness, areas = stiffness_and_areas(mesh.positions, mesh.triangles)
        inner = ~mesh.rim
        self.mesh, self.inner, self.areas_m2 = mesh, inner, areas
        self.radius_m = curvature_radius(mesh, stiffness, areas)
        self.moving = inner if fixed_rim else np.ones(len(inner), bool)
        self._regularisation = regularisation
        volume = housing_m3 + enclosed_volume(mesh)
        self.gas_per_m3 = (ATMOSPHERE_PA + gauge_pressure_pa) / gauge_pressure_pa / volume
        self.A = self._constraints(stiffness)
        moved, pressed = int(self.moving.sum()), int(inner.sum())
        self.positive = slice(moved + 1, moved + 1 + pressed)

    def _constraints(self, stiffness: sparse.csr_matrix) -> sparse.csc_matrix:
        """Return the balance of each inner node over the mean area, and the gas law."""
        areas, mean = self.areas_m2, self.areas_m2[self.inner].mean()
        tension_mm = self.radius_m / 2 * _MM
        share = areas[self.inner] / mean
        balance = [
            sparse.csc_matrix(tension_mm / mean * stiffness[self.inner][:, self.moving]),
            sparse.csc_matrix(-share[:, None]),
            _diagonal(share),
        ]
        gas = np.zeros((1, sum(block.shape[1] for block in balance)))
        gas[0, : balance[0].shape[1]] = self.gas_per_m3 * _MM * areas[self.moving]
        gas[0, balance[0].shape[1]] = 1.0
        return sparse.csc_matrix(sparse.vstack([sparse.hstack(balance), sparse.csc_matrix(gas)]))

    def program(self, way_m: Float64Array) -> QuadraticProgram:
        """Return the program of a frame.

        Parameters
        ----------
        way_m : float64, shape (N,)
            How much farther along its ray each node is seen than in the untouched frame, metres; nan where
            it is not seen.
        """
        cosine, way_mm = self.mesh.facing[self.moving], way_m[self.moving] / _MM
        seen = np.isfinite(way_mm) & (cosine > _EDGE_ON)
        areas = self.areas_m2[self.inner]
        diagonal = np.concatenate(
            [
                np.where(seen, 1.0 / np.maximum(cosine, _EDGE_ON) ** 2, 0.0),
                [0.0],
                self._regularisation * areas / areas.mean(),
            ],
        )
        q = np.zeros(len(diagonal))
        q[: len(cosine)] = -np.where(seen, way_mm / np.maximum(cosine, _EDGE_ON), 0.0)
        return QuadraticProgram(_diagonal(diagonal), q, self.A, self.positive)

    def contact_pressure(self, x: Float64Array) -> Float64Array:
        """Return the contact pressure at every node, in units of the gauge pressure, shape (N,)."""
        pressure = np.zeros(len(self.inner))
        pressure[self.inner] = x[self.positive]
        return pressure

    def air_pressure(self, x: Float64Array) -> float:
        """Return the gauge pressure of the air, in units of the untouched one."""
        return 1.0 + float(x[self.positive.start - 1])

    def displacement_m(self, x: Float64Array) -> Float64Array:
        """Return how far every node has moved along its outward normal, metres, shape (N,)."""
        displacement = np.zeros(len(self.inner))
        displacement[self.moving] = x[: self.positive.start - 1] * _MM
        return displacement


def stiffness_and_areas(positions: Float64Array, triangles: IndexArray) -> tuple[sparse.csr_matrix, Float64Array]:
    """Return the stiffness of the surface's Laplace operator (no unit) and the nodes' areas (m^2).

    For linear elements, ``u' K u`` is the integral of the squared gradient of u: the entry of an edge
    is minus half the cotangents of the angles opposite to it.

    Parameters
    ----------
    positions : float64, shape (N, 3)
    triangles : int, shape (T, 3)
    """
    count = len(positions)
    rows, columns, values, areas = [], [], [], np.zeros(count)
    for corner in range(3):
        i, j, k = triangles[:, corner], triangles[:, (corner + 1) % 3], triangles[:, (corner + 2) % 3]
        to_j, to_k = positions[j] - positions[i], positions[k] - positions[i]
        twice_area = np.linalg.norm(np.cross(to_j, to_k), axis=1)
        half_cotangent = np.einsum("ij,ij->i", to_j, to_k) / twice_area / 2
        rows += [j, k, j, k]
        columns += [k, j, j, k]
        values += [-half_cotangent, -half_cotangent, half_cotangent, half_cotangent]
        np.add.at(areas, i, twice_area / 6)
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_matrix(entries, shape=(count, count)), areas


def curvature_radius(mesh: MembraneMesh, stiffness: sparse.csr_matrix, areas: Float64Array) -> float:
    """Return the radius of the sphere whose mean curvature is the mesh's average off the rim, metres.

    ``K X`` is the areas times 2 H along the outward normals, which is 2 / R on a sphere.

    Raises
    ------
    TactuneError
        The mesh is flat or hollow, so that no tension balances a pressure beneath it.
    """
    inner = ~mesh.rim
    bent = np.einsum("ij,ij->i", stiffness @ mesh.positions, mesh.normals)
    twice_curvature = float(bent[inner].sum() / areas[inner].sum())
    if twice_curvature < 2.0 / _LARGEST_RADIUS_M:
        raise TactuneError(
            "mechanics: the membrane of the untouched frame does not bulge away from the camera; "
            "inflate it and take a new untouched frame"
        )
    return 2.0 / twice_curvature


def enclosed_volume(mesh: MembraneMesh) -> float:
    """Return the volume between the mesh and the plane through its rim, m^3."""
    middle = mesh.positions[mesh.rim].mean(axis=0)
    normal = np.linalg.svd(mesh.positions[mesh.rim] - middle)[2][2]
    a, b, c = np.moveaxis(mesh.positions[mesh.triangles] - middle, 1, 0)
    heights = (a + b + c) @ normal / 3
    return abs(float(np.sum(heights * (np.cross(b - a, c - a) @ normal)) / 2))


def _diagonal(values: Float64Array) -> sparse.csc_matrix:
    """Return a diagonal matrix that stores zeros, too, so that its pattern is always the same."""
    count = len(values)
    return sparse.csc_matrix((values, np.arange(count), np.arange(count + 1)), shape=(count, count))
