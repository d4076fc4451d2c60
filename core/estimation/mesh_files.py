"""Triangle meshes from files, read by trimesh."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from ..errors import MissingExtraError, SourceError, TactuneError
from ..model.arrays import AnyArray, Float64Array, Int32Array
from ..model.files import user_path

#: Largest coordinate, in the file's unit.
_FARTHEST: Final = 1e9


def load_meshes(path: Path | str, suffixes: Sequence[str]) -> list[Any]:
    """Return trimesh's meshes of a file, each with at most one texture."""
    path = user_path(path)
    if path.suffix.lower() not in suffixes:
        raise SourceError(f"{path} has the suffix {path.suffix!r}; a mesh is one of {', '.join(suffixes)}")
    if not path.is_file():
        raise SourceError(f"cannot read {path}: there is no such file; check the path")
    try:
        import trimesh
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            'a mesh needs trimesh, which is not installed: pip install "tactune[open3d]"'
        ) from error
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # it logs tracebacks for a missing texture
    try:
        scene = trimesh.load_scene(path, process=False)
        meshes = [mesh for mesh in scene.geometry.values() if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
        for mesh in meshes:
            _check(mesh, path)
    except TactuneError:
        raise
    except Exception as error:  # trimesh does not wrap those of its parsers
        detail = " ".join(str(error).split())[:200] or type(error).__name__
        raise SourceError(f"{path} is no readable {path.suffix} mesh ({detail}); export it again") from error
    if not meshes:
        raise SourceError(f"{path} has no triangles; export it as a mesh, not as points")
    return meshes


def _check(mesh: Any, path: Path) -> None:
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise SourceError(f"{path} has a triangle with an invalid vertex index; export it again")
    if not (np.abs(vertices[np.unique(triangles)]) < _FARTHEST).all():
        raise SourceError(f"{path} has vertices that are nan, infinite or beyond {_FARTHEST:g}; export it again")


def read_triangles(path: Path | str, suffixes: Sequence[str]) -> tuple[Float64Array, Int32Array]:
    """Read the geometry of a mesh.

    Returns
    -------
    vertices : float64, shape (N, 3)
        In the file's unit; coincident ones are merged.
    triangles : int32, shape (M, 3)
        Vertex numbers, counter-clockwise seen from outside if the surface is closed.
    """
    parts = [(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)) for mesh in load_meshes(path, suffixes)]
    vertices, triangles, _ = merge(parts, path)
    a, b, c = (vertices[triangles[:, k]] - vertices.mean(axis=0) for k in range(3))
    inside_out = (a * np.cross(b, c)).sum() < 0
    return vertices, np.ascontiguousarray(triangles[:, ::-1]) if inside_out else triangles


def merge(
    parts: Sequence[tuple[Float64Array, AnyArray]], path: Path | str
) -> tuple[Float64Array, Int32Array, AnyArray]:
    """Join meshes of a file: merge coincident vertices, drop triangles without area and unused vertices.

    Returns
    -------
    vertices : float64, shape (N, 3)
    triangles : int32, shape (M, 3)
    origin : int, shape (N,)
        Number of each vertex among those of all parts.
    """
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    joined = np.concatenate([vertices for vertices, _ in parts])
    vertices, first, number = np.unique(joined, axis=0, return_index=True, return_inverse=True)
    triangles = np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=False)])
    triangles = number.reshape(-1)[triangles]
    triangles = triangles[triangle_areas(vertices, triangles) > 0]
    if len(triangles) == 0:
        raise SourceError(f"{path} has only triangles without area; export it again")
    used, renumbered = np.unique(triangles, return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3).astype(np.int32), first[used]


def triangle_areas(vertices: Float64Array, triangles: AnyArray) -> Float64Array:
    """Return the area of each triangle in the square of the vertices' unit."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)
