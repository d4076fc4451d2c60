"""True strain between the dots of the printed grid: over all dots, and over completely visible ones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ...model.arrays import BoolArray, Float64Array, IndexArray, Int32Array
from .membrane import Membrane
from .mesh import Mesh
from .objects import allocating
from .render import Camera
from .sheet import DOT_RADIUS_M, DOT_SPACING_M, dot_counts, dot_grid

#: Visible share of a dot's disc from which the dot counts as completely visible: its centroid is then exact.
WHOLE_SHARE: Final = 0.9
#: Sample points across a dot's diameter.
_POINTS_ACROSS: Final = 11
#: A surface hides a point if it is nearer on its ray by more than this, metres.
_BEFORE_M: Final = 1e-6


@dataclass(frozen=True)
class GridStrain:
    """Largest strain between neighbouring dots along the membrane's length and width, straight from dot to dot.

    The flat, clamped sheet has 0. ``length_seen`` and ``width_seen`` are over the pairs of which the camera
    sees both dots whole, and 0 where there is none.
    """

    length: float
    width: float
    length_seen: float
    width_seen: float


def grid_strain(membrane: Membrane, nodes: Float64Array, camera: Camera) -> GridStrain:
    """Return the grid's strain for membrane nodes of shape (N, 3), and which dots the camera sees."""
    design = membrane.design
    columns, rows = dot_counts(design.width_m, design.height_m)
    flat = dot_grid(design.width_m, design.height_m)
    dots = _on_triangles(membrane.mesh, design.cells, flat, membrane.surface(nodes)).reshape(rows, columns, 3)
    whole = (dots_shown(membrane, nodes, camera) >= WHOLE_SHARE).reshape(rows, columns)
    largest = []
    for axis in (1, 0):
        strain = np.linalg.norm(np.diff(dots, axis=axis), axis=2) / DOT_SPACING_M - 1.0
        both = np.take(whole, range(1, whole.shape[axis]), axis) & np.take(whole, range(whole.shape[axis] - 1), axis)
        largest.append((float(strain.max()), float(strain[both].max(initial=0.0))))
    (length, length_seen), (width, width_seen) = largest
    return GridStrain(length, width, length_seen, width_seen)


def dots_shown(membrane: Membrane, nodes: Float64Array, camera: Camera) -> Float64Array:
    """Return the share of each dot's disc that a camera sees: 0 to 1, shape (M,).

    Points all over the disc are followed to the pressed membrane; one is seen that lies in the picture and
    before which the ray from the camera meets no other part of the membrane.
    """
    design, mesh = membrane.design, membrane.mesh
    steps = (np.arange(_POINTS_ACROSS) + 0.5) / _POINTS_ACROSS * 2.0 - 1.0
    disc = np.stack(np.meshgrid(steps, steps), axis=2).reshape(-1, 2)
    disc = DOT_RADIUS_M * disc[np.hypot(*disc.T) <= 1.0]
    grid = dot_grid(design.width_m, design.height_m)
    flat = (grid[:, None] + disc).reshape(-1, 2)
    surface = membrane.surface(nodes) @ camera.pose[:, :3].T + camera.pose[:, 3]
    points = _on_triangles(mesh, design.cells, flat, surface)
    seen = np.zeros(len(points), bool)
    pixels = camera.intrinsics.project(points)
    height, width = camera.intrinsics.shape
    column, row = np.floor(pixels).astype(np.intp).T
    inside = np.flatnonzero((column >= 0) & (column < width) & (row >= 0) & (row < height))
    order = inside[np.argsort(row[inside] * width + column[inside], kind="stable")]
    starts = np.searchsorted(row[order] * width + column[order], np.arange(height * width + 1))
    seen[order] = ~_covered(
        surface, mesh.triangles, camera.pinhole, pixels[order], points[order, 2], starts, width, height
    )
    return np.asarray(seen.reshape(len(grid), len(disc)).mean(axis=1))


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


@allocating
def _covered(
    nodes: Float64Array,
    triangles: Int32Array,
    pinhole: Float64Array,
    pixels: Float64Array,
    depth: Float64Array,
    starts: IndexArray,
    width: int,
    height: int,
) -> BoolArray:
    """Return which points, (M, 2) and (M,), sorted by pixel, a triangle hides."""
    covered = np.zeros(len(depth), np.bool_)
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        wa, wb, wc = 1.0 / nodes[a, 2], 1.0 / nodes[b, 2], 1.0 / nodes[c, 2]
        ua, va = nodes[a, 0] * wa * pinhole[0] + pinhole[2], nodes[a, 1] * wa * pinhole[1] + pinhole[3]
        ub, vb = nodes[b, 0] * wb * pinhole[0] + pinhole[2], nodes[b, 1] * wb * pinhole[1] + pinhole[3]
        uc, vc = nodes[c, 0] * wc * pinhole[0] + pinhole[2], nodes[c, 1] * wc * pinhole[1] + pinhole[3]
        doubled = (ub - ua) * (vc - va) - (uc - ua) * (vb - va)
        if doubled == 0.0:
            continue
        left, right = max(math.floor(min(ua, ub, uc)), 0), min(math.floor(max(ua, ub, uc)), width - 1)
        top, bottom = max(math.floor(min(va, vb, vc)), 0), min(math.floor(max(va, vb, vc)), height - 1)
        if right < left:  # beside the picture, where there are no starts to read
            continue
        for row in range(top, bottom + 1):
            for point in range(starts[row * width + left], starts[row * width + right + 1]):
                u, v = pixels[point, 0], pixels[point, 1]
                kb = ((u - ua) * (vc - va) - (uc - ua) * (v - va)) / doubled
                kc = ((ub - ua) * (v - va) - (u - ua) * (vb - va)) / doubled
                ka = 1.0 - kb - kc
                if ka < 0.0 or kb < 0.0 or kc < 0.0:
                    continue
                if 1.0 / (ka * wa + kb * wb + kc * wc) < depth[point] - _BEFORE_M:
                    covered[point] = True
    return covered
