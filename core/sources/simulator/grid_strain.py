"""True strain between the dots of the printed grid: over all dots, and over completely visible ones."""

from __future__ import annotations

from typing import Final

import numpy as np

from ...model.arrays import Float64Array, IndexArray
from ...model.clouds import nearest_pixels
from ...model.frames import TrueStrain
from .membrane import Membrane
from .mesh import Mesh
from .render import Camera, rasterise
from .sheet import DOT_RADIUS_M, DOT_SPACING_M, dot_counts, dot_grid

#: Visible share of a dot's disc from which the dot counts as completely visible: its centroid is then exact.
_WHOLE_SHARE: Final = 0.9
#: Sample points across a dot's diameter.
_POINTS_ACROSS: Final = 11
#: A point is hidden where its pixel shows the membrane nearer by more than this, metres.
_BEFORE_M: Final = 4e-3


def true_strain(membrane: Membrane, nodes: Float64Array, camera: Camera) -> TrueStrain:
    """Return the strain for membrane nodes of shape (N, 3), along the grid straight from dot to dot.

    0 where the camera sees no two neighbouring dots whole.
    """
    design = membrane.design
    columns, rows = dot_counts(design.width_m, design.height_m)
    flat = dot_grid(design.width_m, design.height_m)
    dots = _on_triangles(membrane.mesh, design.cells, flat, membrane.surface(nodes)).reshape(rows, columns, 3)
    whole = (_dots_shown(membrane, nodes, camera) >= _WHOLE_SHARE).reshape(rows, columns)
    largest = []
    for axis in (1, 0):
        strain = np.linalg.norm(np.diff(dots, axis=axis), axis=2) / DOT_SPACING_M - 1.0
        both = np.take(whole, range(1, whole.shape[axis]), axis) & np.take(whole, range(whole.shape[axis] - 1), axis)
        largest.append((float(strain.max()), float(strain[both].max(initial=0.0))))
    (length, length_seen), (width, width_seen) = largest
    return TrueStrain(length, width, length_seen, width_seen)


def _dots_shown(membrane: Membrane, nodes: Float64Array, camera: Camera) -> Float64Array:
    """Return the share of each dot's disc that a camera sees, (M,): points of the disc beside the depth image."""
    design, mesh = membrane.design, membrane.mesh
    steps = (np.arange(_POINTS_ACROSS) + 0.5) / _POINTS_ACROSS * 2.0 - 1.0
    disc = np.stack(np.meshgrid(steps, steps), axis=2).reshape(-1, 2)
    disc = DOT_RADIUS_M * disc[np.hypot(*disc.T) <= 1.0]
    grid = dot_grid(design.width_m, design.height_m)
    surface = membrane.surface(nodes)
    depth_m = rasterise(camera, surface, mesh.triangles, np.zeros((len(nodes), 6))).depth
    points = _on_triangles(mesh, design.cells, (grid[:, None] + disc).reshape(-1, 2), surface)
    points = points @ camera.pose[:, :3].T + camera.pose[:, 3]
    row, column, inside = nearest_pixels(points, camera.intrinsics)
    shown = inside & (points[:, 2] < depth_m[row, column] + _BEFORE_M)
    return np.asarray(shown.reshape(len(grid), len(disc)).mean(axis=1))


def _on_triangles(mesh: Mesh, cells: tuple[int, int], flat: Float64Array, nodes: Float64Array) -> Float64Array:
    """Return points of the flat sheet, (M, 2), on the triangles between nodes, (N, 3): (M, 3)."""
    (nx, ny), low, high = cells, mesh.flat[0, :2], mesh.flat[-1, :2]
    i, j = np.clip(((flat - low) / (high - low) * (nx, ny)).astype(np.intp), 0, (nx - 1, ny - 1)).T
    first = 2 * (j * nx + i)  # a cell's two triangles follow each other
    shares = _shares(mesh, first, flat)
    other = shares.min(axis=1) < 0.0
    shares[other] = _shares(mesh, first[other] + 1, flat[other])
    return np.asarray((shares[:, :, None] * nodes[mesh.triangles[first + other]]).sum(axis=1))


def _shares(mesh: Mesh, triangles: IndexArray, flat: Float64Array) -> Float64Array:
    """Return barycentric coordinates, (M, 3), of places of the flat sheet in one triangle each."""
    a, b, c = mesh.flat[mesh.triangles[triangles], :2].transpose(1, 0, 2)
    (ux, uy), (vx, vy), (x, y) = (b - a).T, (c - a).T, (flat - a).T
    doubled = ux * vy - uy * vx
    of_b, of_c = (x * vy - y * vx) / doubled, (ux * y - uy * x) / doubled
    return np.stack([1.0 - of_b - of_c, of_b, of_c], axis=1)
