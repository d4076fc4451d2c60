"""Strain between the dots of the printed grid, as the solver knows it: over all dots, and over those a camera sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from .membrane import Membrane
from .render import Camera, rasterise
from .sheet import DOT_RADIUS_M, DOT_SPACING_M, dot_counts, dot_grid

Float64Array = npt.NDArray[np.float64]

#: A dot is looked for so far around the pixel that its middle falls on.
_AROUND: Final = range(-1, 2)


@dataclass(frozen=True)
class GridStrain:
    """Largest strain between neighbouring dots along the membrane's length and width, straight from dot to dot.

    The flat, clamped sheet has 0. ``length_seen`` and ``width_seen`` are over the pairs of which the camera
    sees both dots.
    """

    length: float
    width: float
    length_seen: float
    width_seen: float


def grid_strain(membrane: Membrane, nodes: Float64Array, camera: Camera) -> GridStrain:
    """Measure the grid of a membrane whose nodes, shape (N, 3), are given; the camera looks at it."""
    design = membrane.design
    columns, rows = dot_counts(design.width_m, design.height_m)
    dots = membrane.at(dot_grid(design.width_m, design.height_m), nodes).reshape(rows, columns, 3)
    seen = dots_seen(membrane, nodes, camera).reshape(rows, columns)
    largest = []
    for axis in (1, 0):
        strain = np.linalg.norm(np.diff(dots, axis=axis), axis=2) / DOT_SPACING_M - 1.0
        both = np.take(seen, range(1, seen.shape[axis]), axis) & np.take(seen, range(seen.shape[axis] - 1), axis)
        largest.append((float(strain.max()), float(strain[both].max(initial=0.0))))
    (length, length_seen), (width, width_seen) = largest
    return GridStrain(length, width, length_seen, width_seen)


def dots_seen(membrane: Membrane, nodes: Float64Array, camera: Camera) -> npt.NDArray[np.bool_]:
    """Tell which dots a camera sees: bool, shape (M,).

    A dot is seen where the picture shows a place of the sheet within the dot's radius of its middle.
    """
    design, surface = membrane.design, membrane.surface(nodes)
    grid = dot_grid(design.width_m, design.height_m)
    flat = np.zeros((len(surface), 6))
    flat[:, :2] = membrane.mesh.flat[:, :2]
    sheet = rasterise(camera, surface, membrane.mesh.triangles, flat)
    places = np.where((sheet.depth > 0)[..., None], sheet.attributes[..., :2], np.inf)
    in_camera = membrane.at(grid, surface) @ camera.pose[:, :3].T + camera.pose[:, 3]
    u, v = np.rint(camera.intrinsics.project(in_camera)).astype(np.intp).T
    height, width = sheet.depth.shape
    seen = np.zeros(len(grid), bool)
    for dv in _AROUND:
        for du in _AROUND:
            inside = (u + du >= 0) & (u + du < width) & (v + dv >= 0) & (v + dv < height)
            shown = places[np.where(inside, v + dv, 0), np.where(inside, u + du, 0)]
            seen |= inside & (np.hypot(*(shown - grid).T) <= DOT_RADIUS_M)
    return seen
