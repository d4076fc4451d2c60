"""Where contact ends between the nodes of the membrane's mesh."""

from __future__ import annotations

import cv2
import numpy as np

from ...model.arrays import BoolArray, Float64Array
from .membrane import Membrane, MembraneState
from .objects import compiled, distance, normal

#: A node this near the object lies on it, metres.
_ON_SURFACE_M = 1e-9


def contact_share(membrane: Membrane, state: MembraneState, kind: int, pose: Float64Array) -> Float64Array:
    """Return how much of each node's share of the sheet is in contact, 0 to 1, shape (N,).

    A node at the edge of contact carries only part of what it would carry if its neighbours touched as well: in
    one dimension a string that leaves the object a way s beyond its last node, in cells of length h, loads that
    node with the share 1/2 + s / h, whether pressure or tension about a curved object makes the load. So the whole
    load is computed with the first free nodes laid onto the object, and the edge is where the share falls through
    one half. Where nodes simply count as touching or not, the patch is half a cell too wide.

    Parameters
    ----------
    membrane : Membrane
    state : MembraneState
    kind : int
        Of the object.
    pose : float64, shape (3, 4)
        Takes points of the membrane's frame to the object's.
    """
    mesh = membrane.mesh
    touching = state.reaction_n > 0.0
    share = touching.astype(np.float64)
    beside = _beside(touching, membrane.design.cells) & mesh.free
    if not beside.any():
        return share
    laid = state.nodes.copy()
    _lay(kind, pose, laid, mesh.relief_m, beside)
    gradient = membrane.gradient(laid)
    edge = touching & _beside(~touching, membrane.design.cells)
    whole = np.zeros(len(laid))
    _loads(kind, pose, laid, mesh.relief_m, gradient, edge, whole)
    share[edge] = np.where(whole[edge] > state.reaction_n[edge], state.reaction_n[edge] / whole[edge], 1.0)
    return share


def _beside(nodes: BoolArray, cells: tuple[int, int]) -> BoolArray:
    """Return the nodes that are none of these but next to one, diagonals included."""
    grid = nodes.reshape(cells[1] + 1, cells[0] + 1).astype(np.uint8)
    return (cv2.dilate(grid, np.ones((3, 3), np.uint8)).ravel() > 0) & ~nodes


@compiled
def _lay(kind: int, pose: Float64Array, nodes: Float64Array, relief: Float64Array, chosen: BoolArray) -> None:
    """Move the chosen nodes onto the object."""
    for n in range(nodes.shape[0]):
        if not chosen[n]:
            continue
        for _ in range(20):
            gap = distance(kind, pose, nodes[n, 0], nodes[n, 1], nodes[n, 2] + relief[n])
            if abs(gap) < _ON_SURFACE_M:
                break
            nx, ny, nz = normal(kind, pose, nodes[n, 0], nodes[n, 1], nodes[n, 2] + relief[n])
            nodes[n, 0] -= gap * nx
            nodes[n, 1] -= gap * ny
            nodes[n, 2] -= gap * nz


@compiled
def _loads(
    kind: int,
    pose: Float64Array,
    nodes: Float64Array,
    relief: Float64Array,
    gradient: Float64Array,
    chosen: BoolArray,
    load: Float64Array,
) -> None:
    """Fill in the part of the chosen nodes' out-of-balance force that the object takes."""
    for n in range(nodes.shape[0]):
        if chosen[n]:
            nx, ny, nz = normal(kind, pose, nodes[n, 0], nodes[n, 1], nodes[n, 2] + relief[n])
            load[n] = gradient[n, 0] * nx + gradient[n, 1] * ny + gradient[n, 2] * nz
