"""True contact from a painted 3D scan of the object: thermochromic paint shows where the membrane touched it.

A texture usually has more detail than the vertices, so a textured mesh is subdivided when it is read; afterwards only
vertex colours are used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import numpy.typing as npt
from pydantic import Field
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..calibration.geometry import moved
from ..contact.masking import in_hsv_range
from ..errors import SourceError, TactuneError, foreign
from ..estimation.object_mesh import load_meshes, merge, triangle_areas
from ..model.arrays import AnyArray, BoolArray, Float64Array, Int32Array, Uint8Array
from ..model.files import user_path
from ..model.frames import Matrix4, rigid_transform
from ..model.loading import read_file
from ..model.metrics import symmetric_rmse_m
from ..preset import MaskSection
from ..sources.ros_image import damage_told

SUFFIXES: Final = (".ply", ".obj")
#: Largest file of a pose.
_FILE_BYTES: Final = 10_000_000
#: Plausible sizes of an object that a hand-sized sensor can touch.
_MIN_SIZE_M, _MAX_SIZE_M = 0.002, 1.0
#: Textured triangles are subdivided to this edge length, metres, or a longer one within this number of triangles.
_TEXTURE_EDGE_M: Final = 0.0008
_MAX_TRIANGLES: Final = 1_000_000
_MAX_CUTS: Final = 24

#: Each point on the surface represents a square of this side length, metres.
SPACING_M: Final = 0.0005
_MAX_POINTS: Final = 5_000_000
#: Steps of the R2 low-discrepancy sequence (Roberts 2018): powers of 1 / x, where x^3 = x + 1.
_PLASTIC: Final = 1.3247179572447460
_STEPS: Final = (1 / _PLASTIC, 1 / _PLASTIC**2)


@dataclass(frozen=True, eq=False)
class Scan:
    """A coloured mesh in its own frame: vertices (N, 3) in metres, triangles (M, 3), and RGB of the vertices (N, 3)."""

    vertices_m: Float64Array
    triangles: Int32Array
    colors: Uint8Array

    @cached_property
    def areas_m2(self) -> Float64Array:
        return triangle_areas(self.vertices_m, self.triangles)


def load_scan(path: Path | str, unit_m: float = 1.0) -> Scan:
    """Read a ``.ply`` or ``.obj`` with colours of the vertices, or with a texture beside it."""
    parts, colors = [], []
    for mesh in load_meshes(path, SUFFIXES):
        mesh.apply_scale(unit_m)
        size_m = float(np.ptp(np.asarray(mesh.vertices)[np.unique(mesh.faces)], axis=0).max())
        if size_m > _MAX_SIZE_M:
            raise SourceError(f"{path} is {size_m:.3g} m across; give the unit of its numbers: m, mm or in")
        if mesh.visual.kind is None:
            raise SourceError(f"{path} has no colours; export it with vertex colours, or with its texture beside it")
        finer = _subdivided(mesh, path) if mesh.visual.kind == "texture" else mesh
        parts.append((np.asarray(finer.vertices), np.asarray(finer.faces)))
        colors.append(np.asarray(finer.visual.vertex_colors, np.uint8)[:, :3])
    vertices, triangles, origin = merge(parts, path)
    if np.ptp(vertices, axis=0).max() < _MIN_SIZE_M:
        raise SourceError(f"{path} is less than {1e3 * _MIN_SIZE_M:g} mm across; give the unit of its numbers")
    return Scan(vertices, triangles, np.ascontiguousarray(np.concatenate(colors)[origin]))


def _subdivided(mesh: Any, path: Path | str) -> Any:
    """Subdivide a mesh to the detail of its texture, and colour its vertices."""
    material = mesh.visual.material
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    if image is None or image.format is None or mesh.visual.uv is None:  # trimesh's placeholder has no format
        raise SourceError(f"the texture of {path} is missing or damaged; put its image and .mtl beside it")
    with damage_told(Path(path), "its texture is damaged"):
        image.load()  # until now Pillow has read the image's header only
    corners = np.asarray(mesh.vertices)[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    edge = _TEXTURE_EDGE_M
    # each subdivision halves the edges of a triangle and makes at most four of it
    while (4.0 ** np.ceil(np.log2(np.maximum(longest / edge, 1)))).sum() > max(_MAX_TRIANGLES, len(longest)):
        edge *= 1.2
    finer = mesh.subdivide_to_size(edge, max_iter=_MAX_CUTS)
    finer.visual = finer.visual.to_color()
    return finer


# Paint


class PaintSettings(MaskSection):
    """Colour of the touched paint, and least area of spots and holes."""

    least_area_mm2: Annotated[float, Field(ge=0.0)] = 20.0


PAINT: Final = PaintSettings(hue=(150, 179), saturation=(40, 255), value=(60, 255))


def painted_contact(scan: Scan, paint: PaintSettings = PAINT) -> BoolArray:
    """Tell which vertices are touched paint, (N,): small holes are filled, small spots removed."""
    contact = in_hsv_range(scan.colors[None], paint)[0]
    least_m2 = 1e-6 * paint.least_area_mm2
    thirds = np.repeat(scan.areas_m2 / 3, 3)
    shares: Float64Array = np.bincount(scan.triangles.ravel(), thirds, minlength=len(scan.vertices_m)).astype(
        np.float64
    )
    holes, areas = _spots(scan, ~contact, shares)
    contact = contact | (~contact & (areas[holes] < least_m2))
    spots, areas = _spots(scan, contact, shares)
    return np.asarray(contact & (areas[spots] >= least_m2))


def _spots(scan: Scan, marked: BoolArray, shares: Float64Array) -> tuple[AnyArray, Float64Array]:
    """Return the connected group of each vertex, and the marked area of each group, m^2."""
    t = scan.triangles
    edges = np.concatenate([t[:, (0, 1)], t[:, (1, 2)], t[:, (2, 0)]])
    edges = edges[marked[edges].all(axis=1)]
    graph = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), (len(marked), len(marked)))
    count, labels = connected_components(graph, directed=False)
    return labels, np.bincount(labels, shares * marked, minlength=count).astype(np.float64)


def surface_points(scan: Scan, contact: BoolArray, spacing_m: float = SPACING_M) -> tuple[Float64Array, Float64Array]:
    """Return evenly spread points on the surface in contact, and the unit normals of their triangles, each (K, 3)."""
    touching = np.flatnonzero(contact[scan.triangles].any(axis=1))
    areas = scan.areas_m2[touching]
    if areas.sum() / spacing_m**2 > _MAX_POINTS:
        found = f"the painted contact is too large, {1e4 * areas.sum():.3g} cm2"
        raise TactuneError(f"{found}; check the scan's unit and the paint's colour")
    if len(touching) == 0:
        return np.empty((0, 3)), np.empty((0, 3))
    count = max(round(areas.sum() / spacing_m**2), 1)
    ends = np.cumsum(areas)
    places = (np.arange(count) + 0.5) / count * ends[-1]
    chosen = np.minimum(np.searchsorted(ends, places, side="right"), len(touching) - 1)
    corners = scan.triangles[touching[chosen]]
    s, t = ((0.5 + step * np.arange(1, count + 1)) % 1.0 for step in _STEPS)
    s, t = np.where(s + t > 1.0, 1 - s, s), np.where(s + t > 1.0, 1 - t, t)
    weights = np.column_stack([1 - s - t, s, t])
    inside = (weights * contact[corners]).sum(axis=1) >= 0.5
    a, b, c = (scan.vertices_m[corners[inside, k]] for k in range(3))
    w = weights[inside]
    across = np.cross(b - a, c - a)
    points = w[:, :1] * a + w[:, 1:2] * b + w[:, 2:] * c
    return points, across / np.linalg.norm(across, axis=1, keepdims=True)


# Pose and scores


def load_transform(path: Path | str) -> Matrix4:
    """Read a rigid transform in metres, ``T_proximity_scan``: four lines of four numbers."""
    try:
        text = read_file(user_path(path), _FILE_BYTES).decode("utf-8-sig")
        lines = [line.replace(",", " ").split() for line in text.splitlines() if line.strip()]
        return rigid_transform([[float(word) for word in line] for line in lines])
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    except ValueError as error:
        raise SourceError(f"{path} holds no pose ({foreign(error, 120)}); it is four lines of four numbers") from error


@dataclass(frozen=True, eq=False)
class ScanTruth:
    """True contact: points (K, 3) in the proximity depth frame, metres, and the area as projected for patches."""

    points: Float64Array
    area_mm2: float


def scan_truth(scan: Scan, contact: BoolArray, pose: Matrix4) -> ScanTruth:
    """Transform a scan's contact to the proximity frame by ``T_proximity_scan``."""
    found, normals = surface_points(scan, contact)
    points = moved(pose, found)
    if len(points) and points[:, 2].min() <= 0:
        raise TactuneError("the transform puts the contact behind the proximity camera; is it T_proximity_scan in m?")
    # projected area of a surface element with normal n seen along ray p: |n . p| / p_z
    projected = np.abs((normals @ np.asarray(pose)[:3, :3].T * points).sum(axis=1)) / points[:, 2]
    return ScanTruth(points, float(projected.sum()) * 1e6 * SPACING_M**2)


def score_against_scan(patch: npt.ArrayLike, area_mm2: float, truth: ScanTruth) -> dict[str, float]:
    """Score a patch, (N, 3) in metres, and its area against the true contact; the RMSE is nan if one is empty."""
    rmse_mm = 1e3 * symmetric_rmse_m(patch, truth.points)
    return {"rmse_mm": rmse_mm, "area_error_mm2": area_mm2 - truth.area_mm2}
